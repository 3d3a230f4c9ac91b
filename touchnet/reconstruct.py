"""`touchnet reconstruct TOUCHES... -o MESH|DIR`: closed meshes from files of contacts."""

from __future__ import annotations

import io
import json
import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from touchnet import cli, outputs

if TYPE_CHECKING:
    import torch
    from torch import nn

PROG = "touchnet reconstruct"
STDIO = Path("-")


@dataclass(frozen=True)
class Options:
    """Reconstruct closed meshes from files of contacts.

    Reads xyz, txt, csv, pts, ply, pcd, obj, off, stl, glb, npy and npz in any unit and offset (the format is recognised
    by content); writes ply, obj, stl or glb in the frame and unit of the input. Exit status 0, or 2 if a file could not
    be reconstructed.
    """

    touches: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="TOUCHES...")]
    """Files of contacts; - reads standard input."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """The mesh to write; a folder for several (created where missing); - writes to standard output."""
    weights: str = "default"
    """Name of weights in the package, or a .safetensors file."""
    resolution: int = 256
    """Cells along the longest side. Time and memory grow with its square."""
    up: Literal["x", "y", "z"] | None = None
    """Which axis points up; unset assumes nothing."""
    level: float = 0.5
    """Occupancy at the surface, between 0 and 1; higher gives a thinner object."""
    keep_cavities: bool = False
    """Keep enclosed cavities; otherwise those that no contact lies on are filled."""
    max_touches: int = 8192
    """More contacts than this are thinned evenly."""
    tolerance: float | None = None
    """Error that the confidence of a vertex is about, in the unit of the input; by default 1 % of the longest side."""
    ignore_normals: bool = False
    """Do not use the normals in the file."""
    format: Literal["ply", "obj", "stl", "glb"] | None = None
    """Format of the mesh; by default the suffix of the output, ply for standard output and folders."""
    strict: bool = False
    """Refuse files with rows that would be dropped or columns that would be guessed."""
    force: Annotated[bool, tyro.conf.arg(aliases=["-f"])] = False
    """Overwrite meshes that exist."""
    json: bool = False
    """Print the results as JSON."""
    device: str = "auto"
    """auto, cpu or cuda."""
    seed: int = 0
    """For models that draw random numbers; those of this package draw none."""


@dataclass
class Result:
    """What became of one file; the fields are those of --json."""

    touches: str
    mesh: str | None = None
    error: str | None = None
    warnings: list[str] = field(default_factory=list)
    contacts: int = 0
    dropped: int = 0
    outliers: int = 0
    normals: bool = False
    vertices: int = 0
    faces: int = 0
    bounds: list[list[float]] | None = None
    volume: float | None = None
    distance: float | None = None
    expected_error: float | None = None
    confidence: float | None = None
    tolerance: float | None = None
    refitted: bool = False
    seconds: float = 0.0

    def line(self) -> str:
        """The report for people."""
        if self.error is not None:
            return f"{self.touches}: failed"
        left = [f"{self.dropped} rows dropped"] * bool(self.dropped) + [f"{self.outliers} outliers"] * bool(
            self.outliers
        )
        counted = f"{self.contacts} contacts" + (f" ({', '.join(left)})" if left else "")
        return (
            f"{self.touches} -> {self.mesh}: {counted}{' with normals' if self.normals else ''}, closed mesh of "
            f"{self.faces} faces, contacts {self.distance:.3g} from it (median), expected to be "
            f"{self.expected_error:.3g} off (mean), {self.seconds:.1f} s"
        )


@cli.command(PROG)
def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    options = cli.parse(Options, argv, prog=PROG, config=(tyro.conf.FlagCreatePairsOff,))
    start = time.perf_counter()
    jobs = _plan(options)
    report = sys.stderr if options.output == STDIO else sys.stdout

    import torch

    from touchnet.device import pick_device
    from touchnet.weights import load_model

    torch.manual_seed(options.seed)
    device = pick_device(options.device)
    model = load_model(options.weights, device=device)
    results = []
    for touches, output, kind in jobs:
        result = Result(str(touches))
        results.append(result)
        began = time.perf_counter()
        try:
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always", UserWarning)
                try:
                    _reconstruct(touches, output, kind, model, device, options, result)
                finally:
                    result.warnings = [cli.one_line(w.message) for w in said if issubclass(w.category, UserWarning)]
                    for text in result.warnings:
                        named = text if text.startswith(str(touches)) else f"{touches}: {text}"
                        print(f"{PROG}: warning: {named}", file=sys.stderr)
        except (ValueError, OSError) as error:
            if isinstance(error, BrokenPipeError):
                raise
            named = cli.one_line(error)
            named = named if str(touches) in named else f"{touches}: {named}"
            result.error = named
            print(f"{PROG}: error: {named}", file=sys.stderr)
        result.seconds = time.perf_counter() - began
        if not options.json and (result.error is None or len(jobs) > 1):
            print(result.line(), file=report, flush=True)
    failed = sum(result.error is not None for result in results)
    _summarise(results, failed, time.perf_counter() - start, options, report)
    return cli.BAD_INPUT if failed else 0


def _plan(options: Options) -> list[tuple[Path, Path, str]]:
    """What to read, where to write and in which format; everything that can be refused early is."""
    if not options.touches:
        raise ValueError("expected at least one file of touches")
    if options.touches.count(STDIO) > 1:
        raise ValueError("standard input (-) can be read once only")
    if not 0 < options.level < 1:
        raise ValueError(f"--level should lie between 0 and 1, got {options.level}")
    if not 8 <= options.resolution <= 8192:
        raise ValueError(f"--resolution should lie between 8 and 8192, got {options.resolution}")
    if options.tolerance is not None and not options.tolerance > 0:
        raise ValueError(f"--tolerance should be above 0, got {options.tolerance}")
    if options.max_touches < 4:
        raise ValueError(f"--max-touches should be at least 4, got {options.max_touches}")
    if options.output == STDIO:
        if len(options.touches) > 1:
            raise ValueError(f"standard output takes one mesh, got {len(options.touches)} files of touches")
        if sys.stdout.isatty():
            raise ValueError("a mesh does not go to a terminal: redirect standard output or name a file")
        return [(options.touches[0], STDIO, options.format or "ply")]
    if len(options.touches) == 1 and not options.output.is_dir():
        kind = options.format or options.output.suffix[1:].lower()
        if kind not in ("ply", "obj", "stl", "glb"):
            raise ValueError(f"{options.output}: expected a name that ends in .ply, .obj, .stl or .glb, or --format")
        output = outputs.check_output(options.output, force=options.force)
        if options.touches[0] != STDIO:
            options.touches[0].stat()  # a mistyped name is told before torch is loaded
        return [(options.touches[0], output, kind)]

    kind = options.format or "ply"
    options.output.mkdir(parents=True, exist_ok=True)
    jobs = []
    for touches in options.touches:
        stem = "stdin" if touches == STDIO else touches.stem
        jobs.append((touches, options.output / f"{stem}.{kind}", kind))
    names = [output for _, output, _ in jobs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"{twice}: two files of touches would become this mesh")
    for name in names:
        outputs.check_output(name, force=options.force)
    return jobs


def _reconstruct(
    touches: Path,
    output: Path,
    kind: str,
    model: nn.Module,
    device: torch.device,
    options: Options,
    result: Result,
) -> None:
    """One file of touches to one mesh; fills in `result` as it goes."""
    from touchnet.data.files import check_float32, read_points, write_mesh
    from touchnet.frames import Frame
    from touchnet.meshes import check_closed
    from touchnet.reconstruction import reconstruct_mesh

    contacts = read_points(touches, strict=options.strict)
    result.contacts, result.dropped = len(contacts.points), contacts.dropped
    normals = None if options.ignore_normals else contacts.normals
    result.normals = normals is not None
    if kind in ("stl", "glb"):
        check_float32(contacts.points, kind=kind, cell=2 * Frame.fit(contacts.points).scale / options.resolution)
    mesh = reconstruct_mesh(
        contacts.points,
        normals=normals,
        up=options.up,
        weights=model,
        resolution=options.resolution,
        device=device,
        level=options.level,
        keep_cavities=options.keep_cavities,
        max_touches=options.max_touches,
        tolerance=options.tolerance,
    )
    result.contacts = mesh.metadata["contacts"]
    result.outliers, result.refitted = mesh.metadata["outliers"], mesh.metadata["refitted"]
    result.distance = mesh.metadata["distance"]
    result.vertices, result.faces = len(mesh.vertices), len(mesh.faces)
    result.bounds, result.volume = mesh.bounds.tolist(), float(mesh.volume)
    check_closed(mesh)
    result.expected_error = float(mesh.vertex_attributes["expected_error"].mean())
    result.confidence = float(mesh.vertex_attributes["confidence"].mean())
    result.tolerance = mesh.metadata["tolerance"]
    if output == STDIO:
        buffer = io.BytesIO()
        write_mesh(buffer, mesh, kind=kind)
        sys.stdout.buffer.write(buffer.getvalue())
        sys.stdout.buffer.flush()
    else:
        with outputs.atomic_output(output, force=options.force) as path:
            write_mesh(path, mesh, kind=kind)
    result.mesh = str(output)


def _summarise(results: list[Result], failed: int, seconds: float, options: Options, report: Any) -> None:
    memory = _peak_memory()
    if options.json:
        summary = {
            "results": [vars(result) for result in results],
            "written": len(results) - failed,
            "failed": failed,
            "seconds": round(seconds, 3),
            "peak_memory_bytes": memory,
        }
        print(json.dumps(summary, indent=2), file=report)
    elif len(results) > failed or len(results) > 1:
        peak = "" if memory is None else f", {memory / 2**20:.0f} MiB at most"
        several = f"{len(results) - failed} of {len(results)} meshes written, " if len(results) > 1 else "in all "
        print(f"{several}{seconds:.1f} s{peak}", file=report)


def _peak_memory() -> int | None:
    """The most memory this process has held, in bytes; unknown on Windows."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


if __name__ == "__main__":
    sys.exit(main())
