"""`touchnet explore TOUCHES`: where to touch next."""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from touchnet import cli, outputs

PROG = "touchnet explore"
COLUMNS = ("x", "y", "z", "dx", "dy", "dz", "gain", "expected_error", "clearance")


@dataclass(frozen=True)
class Options:
    """The places on an object whose touches would tell most about its shape, given the contacts so far.

    Prints for each place its position, the direction along which the finger should come (from outside, against the
    outward normal), the share of what is not known of the whole surface that the touch is expected to tell, how far the
    surface may lie from the position, and how far back the path is free of the object as far as known; all in the frame
    and unit of the input. The places are meant to be touched in this order, or all before asking again.
    """

    touches: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TOUCHES")]
    """File of contacts (any format of `touchnet reconstruct`); - reads standard input."""
    k: Annotated[int, tyro.conf.arg(aliases=["-k"])] = 8
    """How many places."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None
    """Write them to this CSV file (or .json with --json)."""
    json: bool = False
    """As JSON."""
    missed: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File of places where a finger came and met nothing: they are not suggested again."""
    up: Literal["x", "y", "z"] | None = None
    """Which axis points up; unset assumes nothing."""
    floor: float | None = None
    """Height of a table along --up: nothing below it, or too near for the approach, is suggested."""
    approach: tuple[float, float, float] | None = None
    """Direction the tool comes from, such as 0 0 1 from above with z up; see --cone."""
    cone: float = 90.0
    """Largest angle in degrees between --approach and the outward normal at a place."""
    standoff: float | None = None
    """Length of free straight path that a contact needs before it; by default 5 % of the longest side."""
    weights: str = "default"
    """Name of weights in the package, or a .safetensors file."""
    resolution: int = 128
    """Cells along the longest side of the surface that the places lie on."""
    ignore_normals: bool = False
    """Do not use the normals in the file."""
    strict: bool = False
    """Refuse files with rows that would be dropped or columns that would be guessed."""
    force: Annotated[bool, tyro.conf.arg(aliases=["-f"])] = False
    """Overwrite a file that exists."""
    device: str = "auto"
    """auto, cpu or cuda."""


@cli.command(PROG)
def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    options = cli.parse(Options, argv, prog=PROG, config=(tyro.conf.FlagCreatePairsOff,))
    if options.k < 1:
        raise ValueError(f"-k should be at least 1, got {options.k}")
    if not 8 <= options.resolution <= 8192:
        raise ValueError(f"--resolution should lie between 8 and 8192, got {options.resolution}")
    if options.output is not None:
        outputs.check_output(options.output, force=options.force)
    for path in (options.touches, options.missed):
        if path is not None and str(path) != "-":
            path.stat()  # a mistyped name is told before torch is loaded

    from touchnet.data.files import read_points
    from touchnet.explorer import Explorer

    contacts = read_points(options.touches, strict=options.strict)
    explorer = Explorer(
        contacts.points,
        None if options.ignore_normals else contacts.normals,
        up=options.up,
        weights=options.weights,
        resolution=options.resolution,
        device=options.device,
        floor=options.floor,
        approach=options.approach,
        cone=options.cone,
        standoff=options.standoff,
    )
    if options.missed is not None:
        explorer.add_misses(read_points(options.missed, strict=options.strict).points)
    try:
        suggestions = explorer.next(options.k)
    except ValueError as error:
        raise ValueError(f"{options.touches}: {error}") from None
    rows = np.column_stack(suggestions)
    mesh = explorer.mesh()
    report = {
        "touches": str(options.touches),
        "contacts": len(explorer),
        "normals": explorer.normals is not None,
        "expected_error": float(mesh.vertex_attributes["expected_error"].mean()),
        "confidence": float(mesh.vertex_attributes["confidence"].mean()),
        "tolerance": mesh.metadata["tolerance"],
        "suggestions": [
            {
                "position": position.tolist(),
                "direction": direction.tolist(),
                "gain": float(gain),
                "expected_error": float(error),
                "clearance": float(clearance),
            }
            for position, direction, gain, error, clearance in zip(*suggestions, strict=True)
        ],
    }
    text = json.dumps(report, indent=2) + "\n" if options.json else _csv(rows)
    if options.output is not None:
        with outputs.atomic_output(options.output, force=options.force) as path:
            path.write_text(text, encoding="utf-8")
    elif options.json:
        sys.stdout.write(text)
    if not options.json:
        print(_table(report, rows))
    return 0


def _csv(rows: np.ndarray) -> str:
    return ",".join(COLUMNS) + "\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows.tolist())


def _table(report: dict[str, Any], rows: np.ndarray) -> str:
    lines = [
        f"{report['touches']}: {report['contacts']} contacts{' with normals' if report['normals'] else ''}; the "
        f"surface is expected {report['expected_error']:.3g} off on average, {report['confidence']:.0%} of it within "
        f"{report['tolerance']:.3g}",
        f"{'position':^36}{'direction':^24}{'gain':>7}{'may be off':>12}{'free path':>12}",
    ]
    lines += [
        "".join(f"{x:>12.6g}" for x in row[:3])
        + "".join(f"{x:>8.3f}" for x in row[3:6])
        + f"{row[6]:>7.1%}{row[7]:>12.3g}{row[8]:>12.3g}"
        for row in rows
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
