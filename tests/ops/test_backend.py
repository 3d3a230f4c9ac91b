"""Which code computes the operators, what they document, and that no name hides another."""

import doctest
import importlib
import inspect
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

import touchnet.ops
import touchnet.reference

NAMES = [name for name in touchnet.ops.__all__ if name != "BACKEND"]


def run_python(code: str, **environment: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
        timeout=120,
    )


def test_reference_has_the_same_names_and_parameters():
    assert set(NAMES) <= set(touchnet.reference.__all__)
    for name in NAMES:
        ours, twin = (inspect.signature(getattr(m, name)) for m in (touchnet.ops, touchnet.reference))
        assert ours == twin, name


def test_reference_backend_needs_no_extension():
    code = (
        "import sys; sys.modules['touchnet._C'] = None\n"
        "import touchnet.ops, touchnet.reference\n"
        "for name in touchnet.ops.__all__:\n"
        "    if name != 'BACKEND': assert getattr(touchnet.ops, name) is getattr(touchnet.reference, name), name\n"
        "print(touchnet.ops.BACKEND)"
    )
    result = run_python(code, TOUCHNET_BACKEND="reference")
    assert result.stdout == "reference\n", result.stderr


def test_missing_extension_says_what_to_run():
    result = run_python("import sys; sys.modules['touchnet._C'] = None\nimport touchnet.ops", TOUCHNET_BACKEND="")
    assert result.returncode == 1
    assert "pip install ." in result.stderr and "TOUCHNET_BACKEND=reference" in result.stderr


def test_unknown_backend():
    result = run_python("import touchnet.ops", TOUCHNET_BACKEND="fast")
    assert 'expected "compiled" or "reference", got \'fast\'' in result.stderr


@pytest.mark.parametrize("name", NAMES)
def test_the_example_runs(name):
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    names = {"torch": torch, "touchnet": touchnet}
    (example,) = doctest.DocTestFinder(exclude_empty=False).find(getattr(touchnet.ops, name), name, globs=names)
    assert example.examples, f"{name} has no example"
    assert runner.run(example).failed == 0


def test_public_names_stay_callable_after_importing_every_submodule():
    for package in (touchnet.ops, touchnet.reference):
        for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
            importlib.import_module(module.name)
        for name in package.__all__:
            assert name == "BACKEND" or callable(getattr(package, name)), name


def test_reference_imports_nothing_compiled():
    root = Path(touchnet.reference.__file__).parent
    for source in root.glob("*.py"):
        imports = [line for line in source.read_text().splitlines() if line.lstrip().startswith(("import ", "from "))]
        assert not any("touchnet.ops" in line or "_C" in line for line in imports), source.name


@pytest.mark.parametrize("name", NAMES)
def test_docstrings_name_every_parameter(name):
    function = getattr(touchnet.ops, name)
    text = inspect.getdoc(function)
    for parameter in inspect.signature(function).parameters:
        assert parameter in text
