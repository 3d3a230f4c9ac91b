"""A closed loop: touch where it tells most, reconstruct, ask again.

    python examples/stream_touches.py --budget 96 --batch 8

`touchnet.Explorer` is the session: contacts are added as they come, `mesh` is what they suggest so far, `next` says
where to go. The robot here is simulated: `touch` below follows the suggested direction onto a hidden mesh. Put the call
that moves your own robot in its place.
"""

import argparse
from pathlib import Path

import numpy as np
import trimesh

import touchnet
from touchnet.data import ClosestPoints, make_watertight, procedural_mesh, read_mesh, simulate_touches, write_mesh
from touchnet.metrics import volumetric_iou
from touchnet.outputs import atomic_output


def touch(hidden: trimesh.Trimesh, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a finger sent to `position` (3,) meets the object, and the outward normal there."""
    points, faces, _ = ClosestPoints(hidden.vertices, hidden.faces)(position[None])
    return points[0], hidden.face_normals[faces[0]]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", type=Path, help="the hidden object; by default a procedural car")
    parser.add_argument("--first", type=int, default=32, help="contacts of the first stroke, before advice is asked")
    parser.add_argument("--budget", type=int, default=96, help="contacts in all")
    parser.add_argument("--batch", type=int, default=16, help="contacts between two looks at the mesh")
    parser.add_argument("--resolution", type=int, default=64)
    parser.add_argument("--weights", default="default", help="a name or a .safetensors file")
    parser.add_argument("--seed", type=int, default=0, help="of the first stroke")
    parser.add_argument("--output", type=Path, help="write the last mesh here")
    options = parser.parse_args()

    if options.mesh is None:
        hidden = procedural_mesh("car", seed=901, resolution=64)
    else:
        hidden = make_watertight(read_mesh(options.mesh))
    first = simulate_touches(hidden, options.first, seed=options.seed)
    explorer = touchnet.Explorer(first.points, first.normals, weights=options.weights, resolution=options.resolution)
    while True:
        mesh = explorer.mesh()
        print(f"{len(explorer)} contacts: intersection over union {volumetric_iou(mesh, hidden):.3f}", flush=True)
        left = options.budget - len(explorer)
        if left <= 0:
            break
        places = explorer.next(min(options.batch, left))
        print(f"  first to {places.positions[0].round(3)} along {places.directions[0].round(2)}")
        for position in places.positions:
            explorer.add(*touch(hidden, position))
    if options.output is not None:
        with atomic_output(options.output, force=True) as path:
            write_mesh(path, mesh)
        print(options.output)


if __name__ == "__main__":
    main()
