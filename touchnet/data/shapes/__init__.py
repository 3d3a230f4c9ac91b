"""Procedural shapes of eleven categories, from airplanes to hand tools: closed meshes out of seeded numbers, y up.

A shape is the union of simple parts, each a field that is positive inside and about the distance to its surface there,
evaluated on a grid around the part only; marching cubes makes one closed mesh of the whole.
"""

import functools
import math
from pathlib import Path

import numpy as np
import trimesh

from touchnet.data.dataset import TouchDataset
from touchnet.data.factory import MeshSource, Parameters, build
from touchnet.data.shapes.airplanes import airplane
from touchnet.data.shapes.bottles import bottle
from touchnet.data.shapes.cars import car
from touchnet.data.shapes.figures import figure
from touchnet.data.shapes.furniture import furniture
from touchnet.data.shapes.parts import part
from touchnet.data.shapes.solids import simple_solid
from touchnet.data.shapes.tools import tool
from touchnet.data.shapes.vessels import cup, mug, vase

__all__ = ["CATEGORIES", "build_procedural", "procedural_mesh", "procedural_sources"]

_MAKERS = {
    "airplane": airplane,
    "bottle": bottle,
    "car": car,
    "solid": simple_solid,
    "cup": cup,
    "mug": mug,
    "vase": vase,
    "part": part,
    "tool": tool,
    "furniture": furniture,
    "figure": figure,
}
# The order is part of what a seed means: new ones come last.
CATEGORIES = tuple(_MAKERS)

# Raised when the same seed comes to mean another shape.
EDITION = 1


def procedural_mesh(category: str, seed: int, *, resolution: int = 128) -> trimesh.Trimesh:
    """A closed shape of a category (y up, longest side 1, centred) that depends on the seed alone.

    Args:
        category: "airplane", "bottle", "car", "solid" (up to four balls, boxes, cylinders, cones and rings in one),
            "cup", "mug", "vase", "part" (of a machine), "tool", "furniture" or "figure" (animals, people, lumps).
        seed: ≥ 0; every seed gives another shape.
        resolution: grid cells along the longest side; the thinnest parts are 2 % of it thick.

    Raises:
        ValueError: an unknown category or a resolution under 48.
    """
    if category not in CATEGORIES:
        raise ValueError(f"category should be one of {', '.join(CATEGORIES)}, got {category!r}")
    if resolution < 48:
        raise ValueError(f"resolution should be ≥ 48 to keep thin parts, got {resolution}")
    rng = np.random.default_rng([EDITION, CATEGORIES.index(category), seed])
    solid = _MAKERS[category](rng, resolution)
    return solid.mesh()


def procedural_sources(shapes: int, *, seed: int = 0, shares: tuple[float, float] = (0.1, 0.1)) -> list[MeshSource]:
    """Sources of `shapes` procedural shapes, the categories in turn; shares[0] of each go to val, shares[1] to test."""
    if shapes < 0:
        raise ValueError(f"shapes should be ≥ 0, got {shapes}")
    sources = []
    for i in range(shapes):
        kinds = len(CATEGORIES)
        category, number = CATEGORIES[i % kinds], i // kinds
        of_category = (shapes - i % kinds + kinds - 1) // kinds
        val, test = (math.ceil(share * of_category) if of_category > 4 else 0 for share in shares)
        split = "test" if number >= of_category - test else "val" if number >= of_category - test - val else "train"
        load = functools.partial(procedural_mesh, category, seed * 1_000_003 + number)
        sources.append(
            MeshSource(
                f"{category}/{seed}-{number:04d}", split, load, f"procedural edition {EDITION}", "procedural", "MIT"
            )
        )
    return sources


def build_procedural(
    directory: str | Path,
    *,
    shapes: int = 300,
    seed: int = 0,
    parameters: Parameters | None = None,
    jobs: int = 1,
    progress: bool = True,
) -> TouchDataset:
    """The embedded data set: `shapes` procedural shapes of all categories, made in `directory` or completed there.

    A directory that holds them already is read and left as it is. See `touchnet.data.factory.build`.
    """
    if shapes < 1:
        raise ValueError(f"shapes should be ≥ 1, got {shapes}")
    sources = procedural_sources(shapes, seed=seed)
    return build(sources, directory, parameters, seed=seed, jobs=jobs, progress=progress)
