"""Which points of a square lattice lie under which triangles: shared by the volume metrics and the pictures."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

PAIRS_AT_ONCE = 1 << 21  # bounds the temporary arrays to some 200 MB


class Coverage(NamedTuple):
    """Pairs of a triangle and a lattice point inside its projection."""

    face: NDArray[np.int64]  # (P,)
    i: NDArray[np.int64]  # (P,) lattice point along the first coordinate
    j: NDArray[np.int64]  # (P,)
    weights: NDArray[np.float64]  # (P, 3) barycentric coordinates of the point, summing to 1
    left: NDArray[np.bool_]  # (P,) whether the triangle runs counter-clockwise around the point


def cover(
    uv: NDArray[np.float64],
    faces: NDArray[np.integer],
    low: tuple[int, int] | None = None,
    high: tuple[int, int] | None = None,
) -> Iterator[Coverage]:
    """Triangles over the integer points of the plane, in portions.

    On which side of an edge a point lies is computed from the edge's ends in the order of their numbers, so two faces
    that share an edge agree on it to the last bit: a point is covered by exactly one of two neighbours, never by both
    or neither.

    Args:
        uv: (V, 2) vertices, in units of the lattice.
        faces: (F, 3) indices of vertices.
        low, high: if given, only points low[k] <= point[k] < high[k].

    Yields:
        portions that together hold every pair of a triangle and a lattice point inside it, in the order of the faces.
    """
    faces = np.asarray(faces, dtype=np.int64)
    if len(faces) == 0:
        return
    corners = uv[faces]  # (F, 3, 2)
    first = np.ceil(corners.min(axis=1)).astype(np.int64)
    last = np.floor(corners.max(axis=1)).astype(np.int64)
    if low is not None:
        first = np.maximum(first, low)
    if high is not None:
        last = np.minimum(last, np.asarray(high) - 1)
    extent = np.maximum(last - first + 1, 0)
    pairs = extent.prod(axis=1)
    used = np.flatnonzero(pairs)
    ends = np.cumsum(pairs[used])
    # Portions end at faces; a face with more pairs than a portion holds gets one of its own.
    cuts = np.flatnonzero(np.diff(ends // PAIRS_AT_ONCE, prepend=0)) if len(ends) else []
    for start, stop in zip([0, *cuts], [*cuts, len(used)], strict=True):
        if start < stop:
            yield _cover(uv, faces, used[start:stop], pairs, extent, first)


def _cover(
    uv: NDArray[np.float64],
    faces: NDArray[np.int64],
    some: NDArray[np.int64],
    pairs: NDArray[np.int64],
    extent: NDArray[np.int64],
    first: NDArray[np.int64],
) -> Coverage:
    count = pairs[some]
    face = np.repeat(some, count)
    within = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(within, np.repeat(extent[some, 1], count))
    i = row + np.repeat(first[some, 0], count)
    j = column + np.repeat(first[some, 1], count)

    edge = []  # twice the area of the point with the edge opposite to corner 0, 1, 2: positive on its left
    left = []
    for a, b in ((1, 2), (2, 0), (0, 1)):
        start, end = faces[some, a], faces[some, b]
        flipped = start > end
        start, end = np.where(flipped, end, start), np.where(flipped, start, end)
        origin, step = uv[start], uv[end] - uv[start]
        area = np.repeat(step[:, 0], count) * (j - np.repeat(origin[:, 1], count))
        area -= np.repeat(step[:, 1], count) * (i - np.repeat(origin[:, 0], count))
        flipped = np.repeat(flipped, count)
        left.append((area > 0) != flipped)
        edge.append(np.where(flipped, -area, area))
    all_left = left[0] & left[1] & left[2]
    inside = np.flatnonzero(all_left | ~(left[0] | left[1] | left[2]))
    weights = np.stack([area[inside] for area in edge], axis=1)
    total = weights.sum(axis=1, keepdims=True)
    flat = total == 0  # a triangle seen from its edge
    weights = np.where(flat, 1 / 3, weights / np.where(flat, 1, total))
    return Coverage(face[inside], i[inside], j[inside], weights, all_left[inside])
