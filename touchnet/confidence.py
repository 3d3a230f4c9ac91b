"""How far a reconstructed surface may lie from the true one, vertex by vertex.

The network's occupancy changes from 1 to 0 within a band around the surface: narrow where it is sure, wide where it
guesses. The width of that band, the distance to the nearest contact, and how far the surface passes by that contact
give an expected error by a formula of a few constants, fitted to shapes that neither training nor the reported figures
have seen (`python -m benchmarks.confidence`; docs/where_to_touch.md shows how well it holds).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from touchnet.frames import FILL

__all__ = ["Calibration", "expected_error", "features", "vertex_normals", "within"]

TOLERANCE = 0.01  # share of the longest side of the contacts that "confidence" is about, unless told otherwise
INNER, OUTER = 0.01, 0.04  # how deep below and how high above the surface, in the cube, the occupancy is asked for
STEEP = 0.5  # least slope of the logit, per unit of the cube, that is told from none
NEAR, OFF = 0.005, 0.002  # shares of the longest side below which distance from and offset to a contact say no more
SURE = 1e-6  # an occupancy nearer to 0 or 1 than this says no more
CELLS = 96  # along the cube; the vertices in a cell share what is found at one of them
CHUNK = 1 << 17  # vertices at a time


class Calibration(NamedTuple):
    """error / longest side = exp(coefficients · features); error / expectation follows a Weibull law of this shape."""

    coefficients: tuple[float, ...]
    shape: float


DEFAULT = Calibration((-0.872, 0.255, 0.209, 0.258, 0.306), 1.21)


def expected_error(
    field: Callable[[Tensor], Tensor],
    vertices: ArrayLike,
    normals: ArrayLike,
    contacts: ArrayLike,
    *,
    level: float = 0.5,
    device: str | torch.device = "cpu",
    calibration: Calibration = DEFAULT,
) -> NDArray[np.float64]:
    """The mean distance at which to expect the true surface from each vertex.

    Args:
        field: points of the cube (M,3) float32 to occupancy (M,), a sigmoid's output.
        vertices: (V,3) in the cube, on the surface where the field is at the level.
        normals: (V,3) outward unit normals there.
        contacts: (N,3) in the cube, N ≥ 1.
        level: the occupancy at the surface.
        device: of the points handed to the field.

    Returns:
        (V,) float64, in the cube's unit, above 0.
    """
    vertices, normals = (np.asarray(rows, dtype=np.float64) for rows in (vertices, normals))
    # The network's features are no finer than its grid: on fine meshes most vertices would ask the same again.
    i, j, k = np.floor((vertices.T + 2) * (CELLS / 2)).astype(np.int64)
    _, first, cell = np.unique((i * 4 * CELLS + j) * 4 * CELLS + k, return_index=True, return_inverse=True)
    rows = features(field, vertices[first], normals[first], contacts, level=level, device=device)
    return FILL * np.exp(rows @ np.array(calibration.coefficients))[cell.reshape(-1)]


def features(
    field: Callable[[Tensor], Tensor],
    vertices: ArrayLike,
    normals: ArrayLike,
    contacts: ArrayLike,
    *,
    level: float = 0.5,
    device: str | torch.device = "cpu",
) -> NDArray[np.float64]:
    """What the expectation is made of, (V,5): 1, and logarithms of lengths with which the error grows.

    The widths of the band in which the occupancy falls, inside and outside of the vertex; the distance to the nearest
    contact; and how far the surface, taken as flat there, passes by that contact.
    """
    vertices, normals, contacts = (np.asarray(rows, dtype=np.float64) for rows in (vertices, normals, contacts))
    shift = math.log(level / (1 - level))
    inner = (_logits(field, vertices - INNER * normals, device) - shift) / INNER
    outer = (shift - _logits(field, vertices + OUTER * normals, device)) / OUTER
    distance, nearest = cKDTree(contacts).query(vertices, workers=-1)
    offset = np.abs(((contacts[nearest] - vertices) * normals).sum(axis=1))
    return np.stack(
        [
            np.ones(len(vertices)),
            -np.log(np.maximum(inner, STEEP)),
            -np.log(np.maximum(outer, STEEP)),
            np.log(distance / FILL + NEAR),
            np.log(offset / FILL + OFF),
        ],
        axis=1,
    )


def within(expected: ArrayLike, tolerance: float, *, calibration: Calibration = DEFAULT) -> NDArray[np.float64]:
    """The probability in 0..1 that an error is no larger than a tolerance, where this error is expected on average.

    Args:
        expected: mean errors, any shape, in the unit of the tolerance.
        tolerance: above 0.
    """
    ratio = math.gamma(1 + 1 / calibration.shape) * tolerance / np.asarray(expected, dtype=np.float64)
    return -np.expm1(-(ratio**calibration.shape))


def vertex_normals(vertices: ArrayLike, faces: ArrayLike) -> NDArray[np.float64]:
    """Outward unit normals (V,3) of a mesh wound outwards: the mean of the faces around a vertex, weighted by area."""
    vertices, faces = np.asarray(vertices, dtype=np.float64), np.asarray(faces)
    (ax, ay, az), (bx, by, bz) = (vertices[faces[:, k]].T - vertices[faces[:, 0]].T for k in (1, 2))
    cross = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    flat = faces.reshape(-1)
    sums = np.stack([np.bincount(flat, np.repeat(part, 3), minlength=len(vertices)) for part in cross], axis=1)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return sums / np.where(lengths > 0, lengths, 1.0)


def _logits(field: Callable[[Tensor], Tensor], points: NDArray[np.float64], device: str | torch.device) -> NDArray:
    values = []
    for begin in range(0, len(points), CHUNK):
        part = torch.from_numpy(points[begin : begin + CHUNK]).to(device=device, dtype=torch.float32)
        values.append(field(part).detach().double().clamp(SURE, 1 - SURE).logit().cpu().numpy())
    return np.concatenate(values)
