"""`touchnet view TOUCHES [MESH]`: contacts, mesh and suggestions on a page in the browser, or in a file of its own."""

from __future__ import annotations

import os
import sys
import warnings
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from touchnet import cli, outputs

if TYPE_CHECKING:
    import trimesh

    from touchnet.data.files import Points
    from touchnet.viewer.scene import Scene, Step

PROG = "touchnet view"
STDIN = Path("-")


@dataclass(frozen=True)
class Options:
    """Look at contacts, the mesh made from them and where to touch next, in a browser.

    Opens a page that this command serves to this machine only, until Ctrl-C; --save writes a page that needs neither
    the command nor a network. A slider runs over the contacts in their order; the mesh follows.
    """

    touches: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TOUCHES")]
    """File of contacts, as for touchnet reconstruct; - reads standard input."""
    mesh: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="[MESH]")] = None
    """Show this mesh; without it meshes are reconstructed from the contacts."""
    save: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="PAGE.html")] = None
    """Write the page to this file and end."""
    force: Annotated[bool, tyro.conf.arg(aliases=["-f"])] = False
    """Overwrite a page that exists."""
    steps: int = 6
    """Meshes to make ahead: from all contacts, half of them, a quarter, ..."""
    suggestions: int | None = None
    """Places to touch next that are shown; unset: 5, or none beside a mesh that is given."""
    weights: str = "default"
    """Name of weights in the package, or a .safetensors file."""
    resolution: int = 128
    """Cells along the longest side of reconstructed meshes."""
    up: Literal["x", "y", "z"] | None = None
    """Which axis points up; unset assumes nothing, and the page starts with y up."""
    ignore_normals: bool = False
    """Do not use the normals in the file."""
    strict: bool = False
    """Refuse files with rows that would be dropped or columns that would be guessed."""
    host: str = "localhost"
    """Serve at this name or address; any but localhost lets other machines see the page."""
    port: int = 0
    """Serve at this port; 0 takes a free one."""
    no_open: bool = False
    """Do not open a browser, only say the address."""
    device: str = "auto"
    """auto, cpu or cuda."""
    seed: int = 0
    """For models that draw random numbers; those of this package draw none."""


@cli.command(PROG)
def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    options = cli.parse(Options, argv, prog=PROG, config=(tyro.conf.FlagCreatePairsOff,))
    _check(options)

    from tqdm import tqdm

    from touchnet.data.files import read_points
    from touchnet.viewer.scene import Scene, Step, pick_counts

    contacts = read_points(options.touches, strict=options.strict)
    if options.ignore_normals:
        contacts = contacts._replace(normals=None)
    total = len(contacts.points)
    title = "standard input" if options.touches == STDIN else options.touches.name
    scene = Scene(contacts, title, up=options.up or "y")
    make_step = None
    if options.mesh is not None:
        scene.mesh_name = options.mesh.name
        mesh = _given_mesh(options.mesh, contacts)
        suggestions, notes = [], []
        if options.suggestions:
            step = _step_maker(contacts, options.suggestions, options)(total)
            suggestions, notes = step.suggestions, step.notes
        scene.steps = [Step(total, mesh, suggestions, notes)]
    else:
        make_step = _step_maker(contacts, 5 if options.suggestions is None else options.suggestions, options)
        counts = pick_counts(total, options.steps)
        if options.save is None:
            scene.live, scene.ahead = True, counts[-2::-1]
            counts = counts[-1:]
        scene.steps = [make_step(count) for count in tqdm(counts, unit="mesh", leave=False, disable=None)]
        if scene.steps[-1].mesh is None:
            raise ValueError(f"{options.touches}: {scene.steps[-1].notes[-1]}")
    for note in scene.steps[-1].notes:
        print(f"{PROG}: warning: {options.touches}: {note}", file=sys.stderr)
    if options.save is not None:
        _save(scene, options.save, force=options.force)
    else:
        _serve(scene, make_step, options)
    return 0


def _check(options: Options) -> None:
    """Refuses early what can be refused early."""
    if not 8 <= options.resolution <= 1024:
        raise ValueError(f"--resolution should lie between 8 and 1024, got {options.resolution}")
    if options.steps < 1:
        raise ValueError(f"--steps should be at least 1, got {options.steps}")
    if options.suggestions is not None and not 0 <= options.suggestions <= 100:
        raise ValueError(f"--suggestions should lie between 0 and 100, got {options.suggestions}")
    if not 0 <= options.port <= 65535:
        raise ValueError(f"--port should lie between 0 and 65535, got {options.port}")
    if options.save is not None:
        if options.save.suffix.lower() not in (".html", ".htm"):
            raise ValueError(f"{options.save}: expected a name that ends in .html")
        outputs.check_output(options.save, force=options.force)
    if options.touches != STDIN:
        options.touches.stat()  # a mistyped name is told before torch is loaded
    if options.mesh is not None:
        options.mesh.stat()


def _given_mesh(path: Path, contacts: Points) -> trimesh.Trimesh:
    """The mesh of a file; warns where it cannot belong to the contacts."""
    from touchnet.data.files import read_mesh

    mesh = read_mesh(path)
    low, high = contacts.points.min(axis=0), contacts.points.max(axis=0)
    if (mesh.bounds[1] < low).any() or (mesh.bounds[0] > high).any():
        warnings.warn(f"{path}: the mesh lies beside the contacts: is it in another frame?", stacklevel=2)
    else:
        larger = float(mesh.extents.max() / max((high - low).max(), 1e-300))
        if not 0.1 < larger < 10:
            warnings.warn(
                f"{path}: the mesh is {larger:.3g} times as large as the contacts: another unit?", stacklevel=2
            )
    return mesh


def _step_maker(contacts: Points, suggestions: int, options: Options) -> Callable[[int], Step]:
    """What makes the step after so many contacts; what goes wrong becomes a note of the step."""
    import torch

    from touchnet.device import pick_device
    from touchnet.explorer import Explorer
    from touchnet.viewer.scene import Step, Suggestion
    from touchnet.weights import load_model

    torch.manual_seed(options.seed)
    device = pick_device(options.device)
    model = load_model(options.weights, device=device)

    def make_step(count: int) -> Step:
        mesh, places, notes = None, [], []
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always", UserWarning)
            try:
                explorer = Explorer(
                    contacts.points[:count],
                    None if contacts.normals is None else contacts.normals[:count],
                    up=options.up,
                    weights=model,
                    resolution=options.resolution,
                    device=device,
                )
                mesh = explorer.mesh()
                if suggestions:
                    places = [Suggestion(*row) for row in zip(*explorer.next(suggestions), strict=True)]
            except ValueError as error:
                notes.append(cli.one_line(error))
        notes = [cli.one_line(w.message) for w in said if issubclass(w.category, UserWarning)] + notes
        return Step(count, mesh, places, notes)

    return make_step


def _save(scene: Scene, path: Path, *, force: bool) -> None:
    from touchnet.viewer.page import render_page

    page = render_page(scene).encode()
    with outputs.atomic_output(path, force=force) as temporary:
        temporary.write_bytes(page)
    meshes = sum(step.mesh is not None for step in scene.steps)
    print(
        f"{path}: {len(scene.contacts.points)} contacts in {len(set(scene.strokes.tolist()))} strokes, "
        f"{meshes} mesh{'es' * (meshes != 1)}, {len(page) / 1e6:.1f} MB"
    )


def _serve(scene: Scene, make_step: Callable[[int], Step] | None, options: Options) -> None:
    """Shows the page until Ctrl-C."""
    from touchnet.viewer.server import LOCAL, Server

    try:
        server = Server(scene, make_step, host=options.host, port=options.port)
    except OSError as error:
        raise OSError(f"cannot serve at {options.host}, port {options.port}: {error.strerror or error}") from None
    with server:
        if options.host not in LOCAL:
            warnings.warn(f"other machines can see the page at port {server.server_port}", stacklevel=2)
        print(f"{server.address} (Ctrl-C ends)", flush=True)
        if not options.no_open and _has_screen():
            webbrowser.open(server.address)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            pass  # the usual end


def _has_screen() -> bool:
    """Whether a browser can open a window: elsewhere the one that starts may take over the terminal."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


if __name__ == "__main__":
    sys.exit(main())
