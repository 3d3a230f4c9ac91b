"""Makes the pictures of docs/concepts.md, and the contacts in examples/touches.csv that they show.

    python docs/pictures.py

Everything comes from one procedural bottle and the weights in the package. A run on 2 cores takes half a minute.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from matplotlib import colormaps

import touchnet
from touchnet import ops
from touchnet.data import Touches, procedural_mesh, read_points, simulate_touches
from touchnet.figures import Picture, View, draw_mesh, draw_touches, save_gallery
from touchnet.frames import Frame
from touchnet.outputs import atomic_output
from touchnet.reconstruction import reconstruct_field

ROOT = Path(__file__).resolve().parents[1]
SIZE = 240
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # rows: a robot's axes in those of the y-up shape
SIDE, PLACE = 180.0, np.array([400.0, -250.0, 90.0])  # millimetres


def bottle_touches() -> Touches:
    """512 contacts of a simulated finger on a bottle that the weights have not been trained on."""
    return simulate_touches(procedural_mesh("bottle", seed=901), 512, seed=0)


def write_csv(touches: Touches, path: Path) -> None:
    """As a robot might report them: z up, in millimetres, somewhere on its table."""
    rows = np.hstack([touches.points @ Z_UP.T * SIDE + PLACE, touches.normals @ Z_UP.T, touches.strokes[:, None]])
    with atomic_output(path, force=True) as temporary:
        np.savetxt(
            temporary, rows, delimiter=",", header="x,y,z,nx,ny,nz,stroke", comments="", fmt=["%.3f"] * 6 + ["%d"]
        )


def slice_picture(values: np.ndarray, scale: str, size: int = SIZE) -> Picture:
    """Values (X, Y) of a slice, x to the right and y up, as coloured squares."""
    shown = values.T[::-1] / max(float(values.max()), 1e-9)
    rows, columns = ((np.arange(size) * n // size) for n in shown.shape)
    return np.round(255 * colormaps[scale](shown[rows][:, columns])[..., :3]).astype(np.uint8)


def trip(path: Path) -> None:
    """The stations of one reconstruction: contacts, gridded volume, occupancy, where it was evaluated, mesh."""
    contacts = read_points(ROOT / "examples" / "touches.csv")
    points, normals = contacts.points @ Z_UP, contacts.normals @ Z_UP  # back to y-up, for the pictures
    frame = Frame.fit(points)
    touches = frame.to_cube(points)
    model = touchnet.load_model()
    row = torch.from_numpy(touches).float()[None]
    density = ops.gridding(row, 64)[0, 0].numpy()
    with torch.inference_mode():
        features = model.encode(row, torch.from_numpy(normals).float()[None])
        axis = torch.linspace(-1, 1, 120)
        x, y = torch.meshgrid(axis, axis, indexing="ij")
        plane = torch.stack([x, y, torch.zeros_like(x)], dim=2).reshape(1, -1, 3)
        occupancy = model.decode(features, plane)[0].reshape(120, 120).numpy()

    asked = []

    def field(queries: torch.Tensor) -> torch.Tensor:
        asked.append(queries)
        with torch.inference_mode():
            return model.decode(features, queries[None])[0].float()

    mesh = reconstruct_field(field, frame, resolution=256, seeds=points, dtype=torch.float32)
    queries = torch.cat(asked).numpy()
    counts, *_ = np.histogram2d(*queries[np.abs(queries[:, 2]) < 0.02][:, :2].T, bins=129, range=[[-1, 1], [-1, 1]])
    view = View.of(points)
    tiles = [
        draw_touches(points, values=contacts.strokes % 8, size=SIZE, view=view),
        slice_picture(np.sqrt(density[:, :, 30:34].sum(axis=2)), "magma"),
        slice_picture(occupancy, "viridis"),
        slice_picture(np.minimum(counts, 4), "gray_r"),
        draw_mesh(mesh, size=SIZE, view=view),
    ]
    titles = ("touches", "volume", "occupancy", "where asked", "mesh")
    save_gallery(path, [tiles], titles=titles, size=SIZE)


def exploration(path: Path) -> None:
    """How a simulated finger comes to know a car: contacts, and what is made of them."""
    truth = procedural_mesh("car", seed=901)
    touches = simulate_touches(truth, 512, seed=0)
    view = View.of(truth.vertices)
    rows = [[], []]
    counts = (32, 128, 512)
    for count in counts:
        points, normals = touches.points[:count], touches.normals[:count]
        mesh = touchnet.reconstruct_mesh(points, normals=normals, up="y", resolution=128)
        rows[0].append(draw_touches(points, values=np.arange(count), size=SIZE, view=view, mesh=truth))
        rows[1].append(draw_mesh(mesh, size=SIZE, view=view))
    save_gallery(path, rows, titles=[f"{count} contacts" for count in counts], size=SIZE)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=ROOT / "docs" / "images", help="folder of the pictures")
    parser.add_argument("--touches", type=Path, help="also write the contacts here")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    if options.touches is not None:
        write_csv(bottle_touches(), options.touches)
    trip(options.output / "trip.png")
    exploration(options.output / "exploration.png")


if __name__ == "__main__":
    main()
