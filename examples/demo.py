"""The whole trip on the embedded shapes: make them, train briefly, measure, reconstruct a shape nobody has seen.

    python examples/demo.py --output runs/demo

Everything goes to the output folder: the data set, the weights, the tables, the touches, the mesh and the pictures.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

from touchnet import evaluate, reconstruct, train
from touchnet.data import read_points, simulate_touches
from touchnet.data.files import read_mesh
from touchnet.data.shapes import procedural_sources
from touchnet.figures import save_gallery


def run(command, *arguments: object) -> None:
    words = [str(argument) for argument in arguments]
    print(f"\n$ python -m {command.__name__} {' '.join(words)}", flush=True)
    status = command.main(words)
    if status:
        sys.exit(status)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("runs/demo"))
    parser.add_argument("--shapes", type=int, default=77, help="procedural shapes to train on")
    parser.add_argument("--steps", type=int, default=350, help="training steps")
    parser.add_argument("--model", default="base", choices=["base", "tiny"])
    parser.add_argument("--resolution", type=int, default=256, help="cells of the meshes along the longest side")
    options = parser.parse_args()
    output: Path = options.output
    output.mkdir(parents=True, exist_ok=True)

    run(
        train, "--shapes", options.shapes, "--cache", output, "--steps", options.steps, "--model", options.model,
        "--schedule", "constant", "--samples.min-contacts", 256,  # what a short training learns most from
        "--validate-every", options.steps, "--output", output / "model", "--force",
    )  # fmt: skip
    data, weights = output / f"procedural-{options.shapes}", output / "model" / "weights.safetensors"
    run(
        evaluate, data, "--weights", weights, "--split", "test", "--contacts", "512", "2048", "--normals", "with",
        "--resolution", min(options.resolution, 128), "--output", output / "evaluation", "--force",
    )  # fmt: skip

    shape = procedural_sources(3, seed=2026)[0].load()
    touches = simulate_touches(shape, 1024, seed=0)
    # In millimetres, far from the origin, as a robot might report it: the mesh comes back in the same frame.
    rows = np.hstack([touches.points * 180 + [400, -250, 90], touches.normals])
    np.savetxt(output / "touches.csv", rows, delimiter=",", header="x,y,z,nx,ny,nz", comments="", fmt="%.6f")
    run(
        reconstruct, output / "touches.csv", "--weights", weights, "--resolution", options.resolution,
        "-o", output / "mesh.ply", "--force",
    )  # fmt: skip
    shape.apply_scale(180)
    shape.apply_translation([400, -250, 90])
    picture = [
        (
            "a shape that training has not seen",
            read_points(output / "touches.csv").points,
            read_mesh(output / "mesh.ply"),
            shape,
        )
    ]
    save_gallery(output / "demo.png", picture, size=384)
    print(f"\nmesh {output / 'mesh.ply'}, picture {output / 'demo.png'}")
    print(f"shapes held out from training: {output / 'evaluation' / 'gallery.png'}")


if __name__ == "__main__":
    main()
