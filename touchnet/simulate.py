"""`touchnet simulate`: a data set directory from meshes (or from procedural shapes)."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from touchnet import cli
from touchnet.data.dataset import SPLITS, TouchDataset, verify
from touchnet.data.factory import Parameters, build
from touchnet.data.importers import find_meshes
from touchnet.data.shapes import procedural_sources

PROG = "touchnet simulate"


@dataclass
class Options:
    """Makes a data set directory: closes meshes, simulates touching trajectories on them, labels points in and out.

    A run that was stopped goes on where it was when it is started again.
    """

    meshes: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """Mesh files and folders (with an INDEX.csv, or in the layout of ShapeNetCore, ModelNet or ShapeNetTouch)."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="DIR")] = None
    """The data set directory to make or to complete."""
    procedural: int = 0
    """Add this many procedural shapes: airplanes, bottles, cars, simple solids, cups, mugs, vases, machine parts,
    tools, furniture and figures in turn."""
    verify: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Only check the data set DIR against its checksums."""
    layout: Literal["auto", "index", "files", "shapenet", "modelnet", "shapenet_touch"] = "auto"
    """How the folders are laid out."""
    shares: tuple[float, float] = (0.1, 0.1)
    """Shares of the val and test splits where the meshes bring no split."""
    jobs: Annotated[int, tyro.conf.arg(aliases=["-j"])] = 1
    """Worker processes; -1: one a core."""
    seed: int = 0
    """Of every random choice."""
    overwrite: bool = False
    """Replace a data set made with another seed or other parameters."""
    parameters: Annotated[Parameters, tyro.conf.arg(name="")] = field(default_factory=Parameters)


def summary(data: TouchDataset) -> str:
    """A table of the counts and a line for the failures."""
    lines = [f"{'category':<14}" + "".join(f"{split:>7}" for split in SPLITS)]
    for category in data.categories:
        counts = [sum(r.category == category and r.split == split for r in data.records) for split in SPLITS]
        lines.append(f"{category:<14}" + "".join(f"{count:>7}" for count in counts))
    lines.append(
        f"{len(data)} shapes in {data.directory}" + (f", {len(data.failures)} skipped" if data.failures else "")
    )
    return "\n".join(lines)


@cli.command(PROG)
def main(argv: Sequence[str] | None = None) -> int:
    options = cli.parse(Options, argv, prog=PROG)
    if options.verify is not None:
        wrong = verify(options.verify)
        for line in wrong:
            print(line)
        print(f"{options.verify}: " + (f"{len(wrong)} things wrong" if wrong else "all shapes match their checksums"))
        return 1 if wrong else 0
    if options.output is None:
        raise ValueError("the data set directory is missing: -o DIR")
    if options.procedural < 0:
        raise ValueError(f"--procedural should be ≥ 0, got {options.procedural}")
    if options.jobs == 0 or options.jobs < -1:
        raise ValueError(f"--jobs should be ≥ 1, or -1 for one a core, got {options.jobs}")
    sources = find_meshes(options.meshes, layout=options.layout, shares=options.shares)
    sources += procedural_sources(options.procedural, seed=options.seed)
    if not sources:
        raise ValueError("no meshes: name files or folders, or ask for --procedural N")
    data = build(
        sources, options.output, options.parameters, seed=options.seed, jobs=options.jobs, overwrite=options.overwrite
    )
    print(summary(data))
    if not len(data):
        raise ValueError("no mesh could be used")
    return 0


if __name__ == "__main__":
    sys.exit(main())
