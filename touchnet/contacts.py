"""Contacts before anything is made of them: what they have to be, and which to keep of very many."""

import warnings

import numpy as np

MIN_DISTINCT = 4  # fewer points bound no solid
FLAT = 1e-3  # extent across, as a share of the extent along, below which contacts are a line or a plane
INWARD = 0.2  # how far into the object normals point on the whole, of 1 for those of a ball, that earns a warning


def check_contacts(points: np.ndarray, normals: np.ndarray | None) -> tuple[np.ndarray, np.ndarray | None]:
    """Contacts as float64 arrays (N,3), normals of length 1 or zero; ValueError where they are none."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points should have shape (N, 3), got {points.shape}")
    broken = int((~np.isfinite(points)).any(axis=1).sum())
    if broken:
        raise ValueError(f"points should be finite, got {broken} of {len(points)} rows that are not")
    if normals is None:
        return points, None
    normals = np.asarray(normals, dtype=np.float64)
    if normals.shape != points.shape:
        raise ValueError(f"normals should have the shape of points, {points.shape}, got {normals.shape}")
    if not np.isfinite(normals).all():
        raise ValueError("normals should be finite, with a row of zeros where one is not known")
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return points, normals / np.where(lengths > 0, lengths, 1.0)


def check_spread(points: np.ndarray) -> None:
    """Refuses contacts that span no solid, warns of those that lie in a plane."""
    distinct = np.unique(points, axis=0)
    if len(distinct) < MIN_DISTINCT:
        raise ValueError(f"expected at least {MIN_DISTINCT} distinct contacts, got {len(distinct)}")
    centred = distinct - distinct.mean(axis=0)
    centred /= np.abs(centred).max()
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(centred.T @ centred), 0.0))[::-1]
    if spread[1] < FLAT * spread[0]:
        raise ValueError(f"expected contacts around a solid, got {len(distinct)} distinct contacts on one line")
    if spread[2] < FLAT * spread[0]:
        warnings.warn("all contacts lie in one plane: the depth of the object is a guess", stacklevel=4)


def check_outward(points: np.ndarray, directions: np.ndarray) -> None:
    """Warns of normals that point inwards: around a solid they mostly point away from the middle."""
    from_middle = points - points.mean(axis=0)
    outward = (from_middle * directions).sum()
    if outward < -INWARD * np.linalg.norm(from_middle[directions.any(axis=1)], axis=1).sum():
        warnings.warn(
            "the contact normals seem to point into the object; they should point outwards, so turn them around "
            "unless only the inside of a hollow was touched",
            stacklevel=4,
        )


def thin(points: np.ndarray, count: int) -> np.ndarray:
    """Chooses at most `count` points, evenly over the surface: one for each cell of the finest grid that has so few.

    No random numbers; the order of the points does not matter (of those nearest to the middle of a cell the first by
    coordinates is taken). Dense places lose most, a place touched once stays.

    Args:
        points: (N,3) finite.
        count: the most points to keep, at least 1.

    Returns:
        (K,) int64 indices, growing; all of them where N ≤ count.
    """
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points should have shape (N, 3), got {points.shape}")
    if count < 1:
        raise ValueError(f"count should be at least 1, got {count}")
    if len(points) <= count:
        return np.arange(len(points))
    low = points.min(axis=0)
    unit = points - low
    unit = unit / (unit.max() or 1.0)

    def cells(divisions: float) -> np.ndarray:
        index = np.minimum(unit * divisions, divisions - 1).astype(np.int64)
        return (index[:, 0] * 2**21 + index[:, 1]) * 2**21 + index[:, 2]

    # The number of cells in use grows with that of divisions, nearly always; bisection finds the finest that fits.
    few, many = 1, 2**20
    while few + 1 < many:
        middle = (few + many) // 2
        if len(np.unique(cells(middle))) <= count:
            few = middle
        else:
            many = middle
    place = np.minimum(unit * few, few - 1).astype(np.int64)
    off_middle = ((unit * few - place - 0.5) ** 2).sum(axis=1)
    order = np.lexsort((points[:, 2], points[:, 1], points[:, 0], off_middle, cells(few)))
    first = np.concatenate([[True], np.diff(cells(few)[order]) != 0])
    return np.sort(order[first])
