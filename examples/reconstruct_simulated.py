"""Touch a mesh in simulation, reconstruct it from the contacts alone, and measure the result against the truth.

    python examples/reconstruct_simulated.py my_object.obj --contacts 512 --up z

Without a mesh a procedural car is touched. Use it to see what a number of contacts, their noise or the size of your
finger would do to your objects before you build anything.
"""

import argparse
from pathlib import Path

import touchnet
from touchnet.data import make_watertight, procedural_mesh, read_mesh, simulate_touches, write_mesh
from touchnet.metrics import SurfaceTruth
from touchnet.outputs import atomic_output


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="?", type=Path, help="what to touch: ply, obj, stl, off or glb")
    parser.add_argument("--contacts", type=int, default=512)
    parser.add_argument("--noise", type=float, default=0.0, help="of the positions, in longest sides (0.005: 0.5 %%)")
    parser.add_argument("--finger-radius", type=float, default=0.0, help="in longest sides")
    parser.add_argument("--ignore-normals", action="store_true", help="reconstruct from positions alone")
    parser.add_argument("--up", choices=["x", "y", "z"], help="the axis that points up, if you know it")
    parser.add_argument("--resolution", type=int, default=128)
    parser.add_argument("--weights", default="default", help="a name or a .safetensors file")
    parser.add_argument("--seed", type=int, default=0, help="of the simulated finger")
    parser.add_argument("--output", type=Path, help="write the reconstruction here")
    options = parser.parse_args()

    if options.mesh is None:
        truth = procedural_mesh("car", seed=901, resolution=64)
    else:
        truth = make_watertight(read_mesh(options.mesh))  # a closed mesh is left as it is
    touches = simulate_touches(
        truth,
        options.contacts,
        seed=options.seed,
        position_noise=options.noise,
        finger_radius=options.finger_radius,
    )
    print(f"{len(touches.points)} contacts in {touches.strokes[-1] + 1} strokes")

    mesh = touchnet.reconstruct_mesh(
        touches.points,
        normals=None if options.ignore_normals else touches.normals,
        up=options.up,
        weights=options.weights,
        resolution=options.resolution,
    )
    scores = SurfaceTruth(truth, samples=20_000).scores(mesh)
    print(f"intersection over union {scores['iou']:.3f}")
    print(f"mean distance {scores['chamfer_l1'] / truth.extents.max():.2%} of the longest side")
    if options.output is not None:
        with atomic_output(options.output, force=True) as path:
            write_mesh(path, mesh)
        print(options.output)


if __name__ == "__main__":
    main()
