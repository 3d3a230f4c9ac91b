"""The pictures of a report: rows of truth, touches and results (the paper's figure 5); an exploration (figure 4)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin

from touchnet import outputs
from touchnet.data.dataset import TouchDataset
from touchnet.data.exploration import Touches
from touchnet.figures import Picture, draw_row, save_exploration, save_gallery
from touchnet.metrics import inside_mesh

TILE = 224  # pixels


class Row(NamedTuple):
    """A shape's pictures and what they show; None: no surface came out."""

    shape: str
    titles: list[str]
    tiles: list[Picture | None]


def draw_strip(
    path: Path,
    touches: NDArray[np.float64],
    results: Mapping[str, trimesh.Trimesh | NDArray[np.float64] | None],
    truth: trimesh.Trimesh,
    samples: NDArray[np.floating] | None,
) -> None:
    """One shape's tiles side by side, with their titles in the file: truth, touches, each method's result.

    Args:
        results: a mesh, points (K, 3) or None, by title.
        samples: (M, 3) common samples; those inside the first mesh are shown before it, as in figure 5.
    """
    tiles: dict[str, Any] = {"truth": truth, f"{len(touches)} touches": touches}
    for title, result in results.items():
        if samples is not None and isinstance(result, trimesh.Trimesh):
            tiles[f'labelled "in": {title}'] = np.asarray(samples, dtype=np.float64)[inside_mesh(samples, result)]
            samples = None
        tiles[title] = result
    # The last mesh of a row sets its view: the truth, whatever a method made of it.
    *pictures, _ = draw_row([*tiles.values(), truth], size=TILE)
    said = PngImagePlugin.PngInfo()
    said.add_text("titles", json.dumps(list(tiles)))
    blank = np.full((TILE, TILE, 3), 255, dtype=np.uint8)
    strip = Image.fromarray(np.concatenate([blank if tile is None else tile for tile in pictures], axis=1))
    with outputs.atomic_output(path, force=True) as temporary:
        strip.save(temporary, format="PNG", pnginfo=said)


def strip_path(folder: Path, shape: str) -> Path:
    """Where a shape's strip lies in the folder of results."""
    return folder / "gallery" / f"{shape.replace('/', '_')}.png"


def read_strips(folder: Path, shapes: Iterable[str]) -> list[Row]:
    """The rows that were drawn, in the order of the shapes."""
    rows = []
    for shape in shapes:
        file = strip_path(folder, shape)
        if file.is_file():
            with Image.open(file) as strip:
                titles = json.loads(strip.text["titles"])
                pixels = np.asarray(strip.convert("RGB"))
            tiles = np.split(pixels, len(titles), axis=1)
            rows.append(Row(shape, titles, [None if (tile == 255).all() else tile for tile in tiles]))
    return rows


def save_rows(folder: Path, rows: list[Row]) -> None:
    """gallery.png: the rows under one another."""
    if rows:
        titles = max((row.titles for row in rows), key=len)
        save_gallery(folder / "gallery.png", [(row.shape, *row.tiles) for row in rows], titles=titles, size=TILE)


def save_trajectory(folder: Path, data: TouchDataset, index: int) -> None:
    """exploration.png: how the first trajectory of a shape goes on, and what is unknown still."""
    shape = data.shape(index)
    parts = [shape.array(name)[0] for name in ("touches", "touch_normals", "strokes", "variance")]
    save_exploration(folder / "exploration.png", shape.mesh(), Touches(*parts), size=TILE)
