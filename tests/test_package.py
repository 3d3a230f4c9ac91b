import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import touchnet

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = ["train", "simulate", "evaluate", "reconstruct", "view"]


def submodules():
    names = [module.name for module in pkgutil.walk_packages(touchnet.__path__, "touchnet.")]
    return [name for name in names if not name.endswith(("__main__", "._C"))]


def test_public_names_survive_importing_every_submodule():
    for name in submodules():
        importlib.import_module(name)
    for name in ("build_info", "reconstruct_mesh", "load_model", "save_weights", "tune_allocator"):
        assert callable(getattr(touchnet, name)), name
    for package in (touchnet.ops, touchnet.reference, touchnet.data):
        for name in package.__all__:
            value = getattr(package, name)
            assert callable(value) or isinstance(value, str), f"{package.__name__}.{name}"


def test_every_public_callable_says_what_it_does():
    for package in (touchnet.ops, touchnet.reference, touchnet.data, touchnet.metrics):
        names = getattr(package, "__all__", [name for name in vars(package) if not name.startswith("_")])
        for name in names:
            value = getattr(package, name)
            if callable(value) and getattr(value, "__module__", "").startswith("touchnet"):
                assert value.__doc__, f"{package.__name__}.{name}"


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="no attribute 'reconstruct_everything'"):
        touchnet.reconstruct_everything  # noqa: B018


def test_build_info_says_what_was_built():
    info = touchnet.build_info()
    assert {"version", "compiler", "threading", "openmp", "cuda_architectures"} <= set(info)
    version = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert info["version"] == version.group(1)


def test_only_one_module_imports_the_extension():
    importers = [
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "touchnet").rglob("*.py")
        if re.search(r"^\s*(from touchnet import .*\b_C\b|import touchnet\._C)", path.read_text(), re.MULTILINE)
    ]
    assert importers == ["touchnet/ops/_ext.py"]


def test_no_torch_header_in_csrc():
    for path in (ROOT / "csrc").rglob("*.*"):
        assert not re.search(r"#include\s*[<\"](torch|ATen|c10)/", path.read_text()), path


def test_imports_run_one_way():
    """commands -> reconstruction, models, data, metrics, losses, figures, weights -> ops -> reference; models and data
    do not import each other, and nothing imports a command."""

    def imported(path):
        return set(re.findall(r"^\s*(?:from|import)\s+(touchnet(?:\.\w+)*)", path.read_text(), re.MULTILINE))

    package = ROOT / "touchnet"
    for path in package.rglob("*.py"):
        names = imported(path)
        inside = path.relative_to(package).as_posix()
        assert not {f"touchnet.{command}" for command in COMMANDS} & names, inside
        forbidden = {
            "reference": ("touchnet.ops", "touchnet.models", "touchnet.data", "touchnet.reconstruction"),
            "ops": ("touchnet.models", "touchnet.data", "touchnet.reconstruction", "touchnet.metrics"),
            "models": ("touchnet.data", "touchnet.reconstruction", "touchnet.metrics"),
            "data": ("touchnet.models", "touchnet.reconstruction", "touchnet.weights"),
        }.get(inside.split("/")[0], ())
        assert not [name for name in names if name.startswith(forbidden)] if forbidden else True, inside


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_clean_with_warnings_as_errors(command):
    # torch's own imports warn with newer Python and NumPy releases; only what touchnet does is held to this.
    run = subprocess.run(
        [sys.executable, "-W", "error:::touchnet", "-m", f"touchnet.{command}", "--help"],
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0 and run.stderr == "", run.stderr
    assert "--seed" in run.stdout or command in ("evaluate",)


def test_help_of_the_package_is_quick_to_import():
    code = "import sys, touchnet; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
