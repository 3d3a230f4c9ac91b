"""Every command and every Python snippet in the README and in docs/ is run, on small stand-ins for the files it names.

A command that this file does not know how to run is a failure, so is a snippet of unknown language. What cannot be run
here is listed in NOT_RUN, with the reason.
"""

import dataclasses
import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh
from accelerate.state import AcceleratorState

import touchnet
from touchnet.__main__ import COMMANDS, main
from touchnet.data.factory import MeshSource, Parameters, build
from touchnet.data.files import write_mesh
from touchnet.models import TouchNet
from touchnet.weights import save_weights

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "touchnet" / "pretrained" / "default.md"]

NOT_RUN = {
    "make demo": "ten minutes; tests/test_examples.py runs its script on smaller shapes",
    "make test": "is what runs this test",
    "make lint": "is run by CI beside the tests",
    "pip install .": "builds for a minute and downloads; CI installs the package before it runs the tests",
    "torchrun": "several processes; tests/test_train.py trains with them",
    "sbatch": "a cluster's command; tests/test_train.py runs the script with stand-ins for SLURM's",
    "accelerate launch": "several processes; tests/test_train.py trains with them",
    "python -m benchmarks": "measures for minutes; it needs a quiet machine or real data",
    "python docs/pictures.py": "half a minute; tests/test_examples.py runs the simulation and reconstruction it draws",
}

# Fenced blocks without a language that are no commands, by their first line.
NO_COMMANDS = ("DIR/dataset.json",)

# Added to a command to make it quick; an option that the command has already stays as it is there.
QUICK = {
    "reconstruct": "--resolution 24 --force --device cpu",
    "explore": "--resolution 24 --device cpu",
    "view": "--save page.html --resolution 24 --steps 1 --suggestions 1 --force --device cpu",
    "simulate": "--touches 64 --trajectories 1 --near 512 --box 256 --surface 512",
    "train": "--steps 2 --model tiny --samples.queries 64 --samples.min-contacts 32 --samples.max-contacts 256 "
    "--workers 0 --device cpu --force",
    "evaluate": "--resolution 16 --samples 500 --contacts 64 --curve-contacts 64 --gallery 0 --limit 1 "
    "--normals with --device cpu --force",
}
SMALLER = {  # values that make a command slow, and what stands in for them
    "--resolution": "24",
    "--steps": "2",
    "--procedural": "1",
    "--jobs": "1",
    "--contacts": "64",
    "--epochs": "1",
    "--shapes": "3",
    "--groups": None,
    "--recipe": None,
    "--minutes": None,
    "--model": "tiny",
}


@dataclasses.dataclass(frozen=True)
class Block:
    """A fenced or indented block of a page."""

    page: str
    line: int
    language: str
    text: str

    @property
    def commands(self) -> list[str]:
        """The lines of a block of shell, continuations joined, without comments."""
        found: list[str] = []
        for line in re.sub(r"\\\n\s*", "", self.text).splitlines():
            line = re.sub(r"(^|\s)#\s.*", "", line).removeprefix("$ ").rstrip()
            if found and found[-1].count('"') % 2:
                found[-1] += "\n" + line
            elif line.strip():
                found.append(line.strip())
        return found


def blocks_of(page: Path) -> list[Block]:
    """Fenced blocks, and those indented by four spaces after an empty line."""
    found: list[Block] = []
    lines = page.read_text().splitlines()
    at = 0
    while at < len(lines):
        start = at
        if fence := re.fullmatch(r"```(\w*)", lines[at]):
            at = lines.index("```", at + 1)
            language, text = fence.group(1), lines[start + 1 : at]
            at += 1
        elif lines[at].startswith("    ") and (at == 0 or not lines[at - 1].strip()):
            while at < len(lines) and (lines[at].startswith("    ") or not lines[at].strip()):
                at += 1
            language, text = "", lines[start:at]
        else:
            at += 1
            continue
        name = page.relative_to(ROOT).as_posix()
        found.append(Block(name, start + 1, language, textwrap.dedent("\n".join(text)).strip("\n")))
    return found


def code_spans(page: Path) -> list[str]:
    """What stands between backticks in the running text of a page."""
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    return [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", text)]


BLOCKS = [block for page in PAGES for block in blocks_of(page)]


def is_shell(block: Block) -> bool:
    return block.language in ("", "sh", "bash") and not block.text.startswith(NO_COMMANDS)


def reason_not_to_run(command: str) -> str | None:
    return next(
        (reason for start, reason in NOT_RUN.items() if re.match(rf"{re.escape(start)}(?![\w-])", command)), None
    )


# stand-ins.


def ball(width: float) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=2).apply_scale([width, 1, 1])


def rows(count: int) -> np.ndarray:
    """Contacts on a sphere, their normals, strokes of 16."""
    points = np.random.default_rng(0).normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return np.hstack([40 * points + 100, points, np.arange(count)[:, None] // 16])


@pytest.fixture(scope="module")
def stand_ins(tmp_path_factory) -> Path:
    """A folder with whatever the pages name: contacts, meshes, a data set, weights."""
    here = tmp_path_factory.mktemp("pages")
    contacts = rows(128)
    for name in ("touches.csv", "scan.csv", "missed.csv"):
        np.savetxt(here / name, contacts, delimiter=",", header="x,y,z,nx,ny,nz,stroke", comments="")
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 128\nHEIGHT 1\nPOINTS 128\nDATA "
    (here / "touches.pcd").write_bytes(f"{header}binary\n".encode() + contacts[:, :3].astype("<f8").tobytes())
    for folder in ("MESHES", "MESHES_OR_FOLDERS", "my_meshes"):
        (here / folder / "ball").mkdir(parents=True)
        for number in range(3):  # these names fall into the splits train, val and test
            ball(1 - 0.2 * number).export(here / folder / "ball" / f"{number}.obj")
    for name in ("object.ply", "mesh.ply"):
        write_mesh(here / name, ball(1.0).apply_scale(40).apply_translation([100, 100, 100]))
    sources = [
        MeshSource(f"bottle/{split}", split, lambda: ball(0.8), split, licence="CC0-1.0")
        for split in ("train", "val", "test")
    ]
    sources.append(MeshSource("mug/a", "train", lambda: ball(0.7), "mug", licence="CC0-1.0"))
    parameters = Parameters(trajectories=1, touches=64, near=4096, box=512, surface=512)
    for folder in ("DIR", "data", "data/real", "DATA"):
        build(sources, here / folder, parameters, progress=False)
    torch.manual_seed(0)
    for run in ("mine", "mine/model", "first", "second", "third", "mean", "fourth"):
        folder = f"runs/{run}"
        (here / folder).mkdir(parents=True, exist_ok=True)
        save_weights(TouchNet("tiny"), here / folder / "weights.safetensors")
    (here / "examples").symlink_to(ROOT / "examples")
    (here / "docs").symlink_to(ROOT / "docs")
    return here


@pytest.fixture
def place(stand_ins, tmp_path, monkeypatch):
    """A fresh copy of the stand-ins, as the current folder."""
    subprocess.run(["cp", "-r", f"{stand_ins}/.", tmp_path], check=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr("touchnet.train.embedded_data", lambda config: tmp_path / "data", raising=False)
    yield tmp_path
    AcceleratorState._reset_state(reset_partial_state=True)


class Robot:
    """Touches the sphere of `rows`, misses every fourth time, and has time for one round."""

    def __init__(self) -> None:
        self.rounds = self.touches = 0

    def has_time(self) -> bool:
        self.rounds += 1
        return self.rounds == 1

    def poke(self, start: np.ndarray, direction: np.ndarray) -> SimpleNamespace | None:
        self.touches += 1
        normal = (start - 100) / np.linalg.norm(start - 100)
        return None if self.touches % 4 == 0 else SimpleNamespace(point=100 + 40 * normal, normal=normal)


def names_of_snippets() -> dict[str, object]:
    """What snippets use without saying where it comes from."""
    generator = torch.Generator().manual_seed(0)
    a, b = (torch.rand(64, 3, generator=generator) for _ in range(2))
    contacts = rows(128)
    return {
        "touchnet": touchnet, "robot": Robot(), "a": a, "b": b,
        "labels_a": np.array([True, False, True]), "labels_b": np.array([True, True, True]),
        "mesh": ball(1.0), "mesh_a": ball(1.0), "mesh_b": ball(0.9), "prediction": ball(0.9),
        "points": contacts[:, :3], "normals": contacts[:, 3:6], "contacts_made_there": contacts[:4, :3],
    }  # fmt: skip


# the tests.


def test_every_block_is_known():
    for block in BLOCKS:
        where = f"{block.page}, line {block.line}"
        assert block.language in ("", "sh", "bash", "python"), f"{where}: no test runs a block of {block.language}"
        if not is_shell(block) or block.language == "python":
            continue
        for command in block.commands:
            assert runnable(command) or reason_not_to_run(command), f"{where}: no test runs {command!r}"


def runnable(command: str) -> bool:
    words = command.split()
    if words[0] == "touchnet" and len(words) > 1:
        name = words[1].rstrip(":")
        return name in COMMANDS or words[1].startswith("--")
    return words[:2] == ["python", "-c"] or bool(re.match(r"python \S", command))


def test_what_is_not_run_is_named_on_a_page():
    shell = "\n".join(
        [command for block in BLOCKS if is_shell(block) for command in block.commands]
        + [span for page in PAGES for span in code_spans(page)]
    )
    assert [start for start in NOT_RUN if start not in shell and start != "accelerate launch"] == []


def python_pages() -> list[str]:
    return sorted({block.page for block in BLOCKS if block.language == "python"})


@pytest.mark.parametrize("page", python_pages())
def test_the_snippets_of_a_page_run_one_after_the_other(page, place):
    names = names_of_snippets()
    for block in BLOCKS:
        if block.page == page and block.language == "python":
            code = "\n" * block.line + block.text  # so that a traceback names the line of the page
            exec(compile(code, ROOT / page, "exec"), names)


SHELL = [block for block in BLOCKS if is_shell(block) and any(not reason_not_to_run(c) for c in block.commands)]


@pytest.mark.slow
@pytest.mark.parametrize("block", SHELL, ids=lambda block: f"{block.page}:{block.line}")
def test_the_commands_of_a_block_run(block, place, capfd):
    for command in block.commands:
        if reason_not_to_run(command):
            continue
        if command.startswith("touchnet simulate") and "--verify" not in command:
            shutil.rmtree(re.search(r"-o (\S+)", command).group(1), ignore_errors=True)  # the page makes it anew
        if ": error: " in command:
            assert command in error_message(command, capfd)
        elif "<(" in command:
            piped(command)
        elif command.startswith("touchnet"):
            AcceleratorState._reset_state(reset_partial_state=True)  # each command is a process of its own
            status = main(quick(shlex.split(command)[1:]))
            assert status == 0, f"{command}: {capfd.readouterr().err}"
        else:
            script = f'python() {{ "$PYTHON" "$@"; }}\n{command}'
            bash(script)


def bash(script: str) -> None:
    subprocess.run(["bash", "-ec", script], check=True, timeout=300, env={**os.environ, "PYTHON": sys.executable})


def quick(words: list[str]) -> list[str]:
    """The words of a command with small values and with the options that make it quick."""
    name, *rest = words
    if name.startswith("--"):
        return words
    for option, small in SMALLER.items():
        if option in rest:
            at = rest.index(option)
            stop = next((i for i in range(at + 1, len(rest)) if rest[i].startswith("-")), len(rest))
            rest[at:stop] = [option, small] if small is not None else []
    if name == "simulate" and "--verify" in rest:
        return words
    if importlib.util.find_spec("pymeshlab") is None:  # without the extra [baselines]
        rest = [word for word in rest if word not in ("alpha_wrap", "ball_pivoting", "poisson")]
        at = rest.index("all") if "all" in rest else len(rest)
        rest[at : at + 1] = ["model", "convex_hull", "alpha_shape", "gpis"] if "all" in rest else []
    options = iter(re.findall(r"(--\S+)((?: (?!--)\S+)*)", QUICK[name]))
    taken = {"--save": "-o", "--force": "-f"}
    for option, values in options:
        if option not in rest and taken.get(option, option) not in rest:
            if (option, "--resume" in rest) == ("--force", True) or (option, "--init" in rest) == ("--model", True):
                continue
            rest += [option, *values.split()]
    return [name, *rest]


def error_message(command: str, capfd) -> str:
    """What the command says about a file with the mistake that its message names."""
    file, line, column, found = re.search(r"error: (\S+), line (\d+): .*column (\d+), found '(.*)'", command).groups()
    text = [["1", "2", "3"] for _ in range(9)]
    text[int(line) - 1][int(column) - 1] = found
    Path(file).write_text("".join(f"{','.join(words)}\n" for words in text))
    assert main([command.split()[1].rstrip(":"), file, "-o", "part.ply"]) == 2
    return capfd.readouterr().err


def piped(command: str) -> None:
    """A command of bash, with stand-ins for the program that feeds it."""
    arguments = " ".join(quick(["reconstruct"])[1:])
    script = (
        'my-driver() { cat touches.csv; }\ntouchnet() { "$PYTHON" -m touchnet "$@" ' + arguments + "; }\n" + command
    )
    bash(script)


def spans() -> list[tuple[str, str]]:
    """Commands of ours in the running text."""
    return [
        (page.relative_to(ROOT).as_posix(), span)
        for page in PAGES
        for span in code_spans(page)
        if re.match(r"touchnet [a-z]+( |$)|touchnet --", span)
    ]


@pytest.mark.parametrize(("page", "span"), spans())
def test_commands_in_the_text_have_options_that_exist(page, span, capsys):
    name, *rest = span.split()[1:]
    if name == "COMMAND":
        return
    if name.startswith("--"):
        assert main([name]) == 0
        return
    assert name in COMMANDS, f"{page}: {span}"
    assert main([name, "--help"]) == 0
    text = capsys.readouterr().out
    for word in rest:
        if re.match(r"--?[a-z]", word):
            assert re.search(rf"(^|[\s,│]){re.escape(word)}\b", text), f"{page}: {span}"


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:)([^)#]+)[^)]*\)", page.read_text()):
        assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_citation_is_complete():
    text = (ROOT / "CITATION.cff").read_text()
    version = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE).group(1)
    assert f"version: {version}\n" in text
    assert "End-to-end Surface Reconstruction For Touching Trajectories" in text
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text()


def test_json_of_the_readme_is_json(capsys):
    assert main(["--build-info"]) == 0
    json.loads(capsys.readouterr().out)
