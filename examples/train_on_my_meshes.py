"""Train a network on a folder of your own meshes: close and touch them, train, measure on shapes held out.

    python examples/train_on_my_meshes.py my_meshes --output runs/mine --model base --steps 3000

Sub-folders are categories. The defaults are for a first look: a tiny network, few steps, and without a folder a few
procedural bottles in its place. The three steps are the commands `touchnet simulate`, `train` and `evaluate`;
simulation goes on where it was if it is started again, training with --resume. The weights can be used everywhere:
`touchnet reconstruct touches.csv -o object.ply --weights runs/mine/model/weights.safetensors`.
"""

import argparse
import sys
from pathlib import Path

from touchnet import evaluate, simulate, train
from touchnet.data import procedural_mesh


def run(command, *arguments: object) -> None:
    words = [str(argument) for argument in arguments]
    print(f"\n$ python -m {command.__name__} {' '.join(words)}", flush=True)
    status = command.main(words)
    if status:
        sys.exit(status)


def stand_ins(folder: Path, count: int) -> Path:
    """Writes `count` procedural bottles as OBJ files, in place of meshes of your own."""
    (folder / "bottle").mkdir(parents=True, exist_ok=True)
    for seed in range(count):
        procedural_mesh("bottle", seed, resolution=48).export(folder / "bottle" / f"{seed:03}.obj")
    return folder


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="?", type=Path, help="a folder of meshes; sub-folders are categories")
    parser.add_argument("--output", type=Path, default=Path("runs/mine"))
    parser.add_argument("--model", default="tiny", choices=["tiny", "base", "paper"])
    parser.add_argument("--steps", type=int, default=60, help="training steps")
    parser.add_argument("--contacts", type=int, default=512, help="contacts of a simulated trajectory")
    parser.add_argument("--trajectories", type=int, default=2, help="simulated trajectories of each mesh")
    parser.add_argument("--resolution", type=int, default=128, help="of the meshes that are measured")
    parser.add_argument("--jobs", type=int, default=1, help="processes that simulate and measure")
    parser.add_argument("--resume", action="store_true", help="go on with a training that was stopped")
    options = parser.parse_args()

    meshes = options.meshes or stand_ins(options.output / "meshes", 8)
    data, model, report = (options.output / name for name in ("data", "model", "report"))
    run(
        simulate, meshes, "--output", data, "--touches", options.contacts, "--trajectories", options.trajectories,
        "--shares", 0.2, 0.2, "--jobs", options.jobs,
    )  # fmt: skip
    run(
        train, "--data", data, "--output", model, "--model", options.model, "--steps", options.steps,
        "--samples.max-contacts", options.contacts, "--validate-every", options.steps,
        "--resume" if options.resume else "--force",
    )  # fmt: skip
    run(
        evaluate, data, "--weights", model / "weights.safetensors", "--output", report, "--split", "test",
        "--contacts", options.contacts, "--protocols", "surface", "--samples", 20_000, "--jobs", options.jobs,
        "--resolution", options.resolution, "--force",
    )  # fmt: skip
    print(f"\nweights {model / 'weights.safetensors'}, pictures {report / 'gallery.png'}")


if __name__ == "__main__":
    main()
