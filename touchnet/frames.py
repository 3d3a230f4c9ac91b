"""The map between an object's own coordinates and the cube [-1,1]^3 that the model works in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

__all__ = ["Frame", "find_outliers"]

# The longest side of the box of the touches becomes 1.8 of the cube's 2, which leaves room for what was not touched.
FILL = 1.8

# A group of contacts is an outlier where its distance from all others exceeds this share of their longest side: longer
# than an untouched stretch of a wing or an antenna is, with so many contacts. N contacts spread over a surface leave
# gaps in proportion to 1 / sqrt(N), so few of them need more.
GAP, GAP_OF_FEW = 0.5, 8.0
# Fewer contacts than this say too little about what is usual.
MIN_COUNT = 100
# The largest share of contacts that can be outliers, in one group and in all.
GROUP_SHARE, TOTAL_SHARE = 0.05, 0.1


class Frame(NamedTuple):
    """A translation and one scale: cube = (object - centre) / scale, computed in float64.

    Attributes:
        centre: (3,) float64, what becomes the origin, in the object's units.
        scale: the length of the object that becomes 1 in the cube (half of the cube's side).
    """

    centre: np.ndarray
    scale: float

    @classmethod
    def fit(cls, points: np.ndarray, *, reject_outliers: bool = True) -> Frame:
        """The frame that puts the box of `points` into the cube's middle, its longest side 1.8 long.

        It does not depend on the order of the points. A box without extent counts as one of side 1.

        Args:
            points: (N,3) contacts, N ≥ 1; rows that are not finite are passed over.
            reject_outliers: leave out what `find_outliers` finds.

        Raises:
            ValueError: another shape, or no finite row.
        """
        points = _checked(points)
        points = points[np.isfinite(points).all(axis=1)]
        if not len(points):
            raise ValueError("points should hold at least one finite row, got none")
        if reject_outliers:
            points = points[~find_outliers(points)]
        low, high = points.min(axis=0), points.max(axis=0)
        # Halved first, so that coordinates near the end of float64 do not overflow.
        side = 2 * float((high / 2 - low / 2).max())
        if not np.isfinite(side):
            raise ValueError(
                f"points should fit into float64, got coordinates between {low.min():g} and {high.max():g}"
            )
        # Below the smallest normal number a division by the scale would overflow.
        return cls(low / 2 + high / 2, (side if side > 1e-300 else 1.0) / FILL)

    def to_cube(self, points: np.ndarray) -> np.ndarray:
        """Object coordinates (...,3) to cube coordinates, float64."""
        return (np.asarray(points, dtype=np.float64) - self.centre) / self.scale

    def from_cube(self, points: np.ndarray) -> np.ndarray:
        """Cube coordinates (...,3) to object coordinates, float64."""
        return np.asarray(points, dtype=np.float64) * self.scale + self.centre

    def enlarged(self, factor: float) -> Frame:
        """The frame whose cube is `factor` times as large about the same centre."""
        return Frame(self.centre, self.scale * factor)


def find_outliers(points: np.ndarray) -> np.ndarray:
    """Which contacts lie apart from the object: a tracker that lost sight, a contact far from the part.

    Contacts form groups; starting from the largest, groups nearer than half of the current longest side (8 / sqrt(N) of
    it for fewer than 256 contacts) join. What cannot join is an outlier if no such group has more than 5 % of the
    contacts and all of them together have at most 10 %; otherwise nothing is. So a sparsely touched wing or antenna
    stays, and so does a continuous trail of contacts that leaves the surface: nothing tells it from an antenna. With
    fewer than 100 contacts nothing is an outlier.

    Args:
        points: (N,3) finite.

    Returns:
        (N,) bool, the same for any order of the points.
    """
    points = _checked(points)
    count = len(points)
    outliers = np.zeros(count, dtype=bool)
    if count < MIN_COUNT:
        return outliers
    low, high = np.quantile(points, [TOTAL_SHARE, 1 - TOTAL_SHARE], axis=0, method="nearest")
    typical = float((high - low).max())
    extent = float((points.max(axis=0) - points.min(axis=0)).max())
    gap = max(GAP, GAP_OF_FEW / np.sqrt(count))
    # A fast way out: nothing lies far apart if the whole box is hardly larger than the box of the middle.
    if not 0 < typical < np.inf or not (1 + gap / 2) * typical < extent < np.inf:
        return outliers

    groups = _groups(points, typical * gap / 4)
    sizes = np.bincount(groups)
    joined = np.isin(groups, np.flatnonzero(sizes == sizes.max()))
    while not joined.all():
        box = points[joined]
        side = float(np.ptp(box, axis=0).max())
        rest = np.flatnonzero(~joined)
        distance = cKDTree(box).query(points[rest])[0]
        near = np.isin(groups, groups[rest[distance <= gap * side]])
        if not near.any():
            break
        joined |= near
    apart = sizes * ~np.isin(np.arange(len(sizes)), groups[joined])
    if apart.max() > GROUP_SHARE * count or apart.sum() > TOTAL_SHARE * count:
        return outliers
    return ~joined


def _groups(points: np.ndarray, cell: float) -> np.ndarray:
    """Numbers (N,) the groups of points whose cells are connected, at most three cells apart along any axis."""
    # Far away, cells no longer matter: clipping keeps the whole numbers in range.
    index = np.clip((points - np.median(points, axis=0)) / cell, -1e6, 1e6).round().astype(np.int64)
    cells, of_point = np.unique(index, axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(3.5, p=np.inf, output_type="ndarray")
    links = coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    return connected_components(links, directed=False)[1][of_point.reshape(-1)]


def _checked(points: np.ndarray) -> np.ndarray:
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points should have shape (N, 3), got {points.shape}")
    return points
