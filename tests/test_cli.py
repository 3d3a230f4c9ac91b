import dataclasses
import os
import re
import signal
import subprocess
import sys
import textwrap
import warnings
from pathlib import Path
from typing import Annotated

import pytest
import tyro

from touchnet import cli
from touchnet.__main__ import COMMANDS
from touchnet.__main__ import main as touchnet_main


@dataclasses.dataclass
class Options:
    """Words for --help."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    resolution: int = 256


def run_with(body, capsys):
    status = cli.command("touchnet try")(body)([])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def raiser(error):
    def body(argv):
        raise error

    return body


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (ValueError("bad\n  rows"), 2, "touchnet try: error: bad rows\n"),
        (FileNotFoundError(2, "No such file or directory", "x.ply"), 2, "x.ply: No such file or directory\n"),
        (OSError("disk on fire"), 2, "error: disk on fire\n"),
        (ImportError("pip install touchnet[data]"), 2, "error: pip install touchnet[data]\n"),
        (MemoryError(), 2, "not enough memory (MemoryError)\n"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: 9 bytes"), 2, "not enough memory"),
        (KeyboardInterrupt(), 130, "error: interrupted\n"),
        (SystemExit(7), 7, ""),
        (SystemExit("in words"), 2, "error: in words\n"),
    ],
)
def test_bad_input_is_one_line_and_a_status(error, status, said, capsys):
    got, out, err = run_with(raiser(error), capsys)
    assert got == status
    assert out == ""
    assert said in err
    assert err.count("\n") <= 1


@pytest.mark.parametrize("error", [TypeError("a defect"), RuntimeError("a defect"), ZeroDivisionError()])
def test_a_defect_keeps_its_traceback(error):
    with pytest.raises(type(error)):
        cli.command("touchnet try")(raiser(error))([])


def test_debug_keeps_every_traceback(monkeypatch):
    monkeypatch.setenv("TOUCHNET_DEBUG", "1")
    with pytest.raises(ValueError, match="bad"):
        cli.command("touchnet try")(raiser(ValueError("bad")))([])


def test_warnings_are_one_line(capsys):
    def body(argv):
        warnings.warn("the surface\nmeets the cube", stacklevel=1)

    status, _, err = run_with(body, capsys)
    assert status == 0
    assert err == "touchnet try: warning: the surface meets the cube\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "Missing from touchnet try: -o PATH"),
        (["-o", "x", "--resolution", "fine"], "--resolution"),
        (["-o", "x", "--colour"], "--colour"),
    ],
)
def test_arguments_that_do_not_fit_are_one_line(arguments, said, capsys):
    status = cli.command("touchnet try")(lambda argv: cli.parse(Options, argv, prog="touchnet try"))(arguments)
    err = capsys.readouterr().err
    assert status == 2
    assert said in err
    assert err.startswith("touchnet try: error: ")
    assert err.count("\n") == 1
    assert "─" not in err
    assert "full helptext" not in err


def test_arguments_that_fit():
    options = cli.parse(Options, ["a", "b", "-o", "c"], prog="touchnet try")
    assert options == Options(files=(Path("a"), Path("b")), output=Path("c"))


def test_none_is_not_a_value_to_type(capsys):
    assert touchnet_main(["explore", "x.xyz", "--up", "None"]) == 2
    assert "invalid choice 'None'" in capsys.readouterr().err


def test_help_is_status_0(capsys):
    status = cli.command("touchnet try")(lambda argv: cli.parse(Options, argv, prog="touchnet try"))(["--help"])
    assert status == 0
    assert "Words for --help." in capsys.readouterr().out


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_every_command_is_complete(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    assert touchnet_main([name, "--help"]) == 0
    out = capsys.readouterr().out
    assert f"usage: touchnet {name}" in out
    pairs = re.findall(r"(--[a-z-]+), --no-", out)
    assert pairs == [], "a flag has one name"
    assert "None" not in out, "nobody types None"
    # Each option stands beside words on what it does, before its default.
    for line in out.splitlines():
        if line.startswith("│ -") and "(default:" in line:
            assert re.search(r"[a-z]{3,}.*\. ?\(default:", line), line


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_leaves_no_half_file(number, status, tmp_path):
    script = textwrap.dedent(
        """
        import sys, time
        from touchnet import cli, outputs

        @cli.command("touchnet try")
        def main(argv):
            with outputs.atomic_output("out.txt") as path:
                path.write_text("half")
                print("writing", flush=True)
                time.sleep(60)

        sys.exit(main())
        """
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell that runs the tests in the background lets its children ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout.readline() == "writing\n"
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == status
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []


def test_help_lists_the_commands(capsys):
    assert touchnet_main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(f"  {name} " in out for name in COMMANDS)


def test_version(capsys):
    assert touchnet_main(["--version"]) == 0
    assert capsys.readouterr().out.split()[0] == "touchnet"


@pytest.mark.parametrize(("arguments", "came"), [(["paint"], "got 'paint'"), ([], "got none")])
def test_unknown_command(arguments, came, capsys):
    assert touchnet_main(arguments) == 2
    assert f"expected a command out of {', '.join(COMMANDS)}, {came}" in capsys.readouterr().err
