"""Contacts that do not depend on those before them: random points, and lines in parallel planes."""

import numpy as np
from numpy.typing import NDArray

from touchnet.data.exploration.finger import Finger
from touchnet.data.exploration.record import Record


def touch_uniform(finger: Finger, record: Record, n: int, rng: np.random.Generator) -> None:
    stroke = 0
    while record.count < n:
        for point, normal in zip(*finger.starts(n, rng), strict=True):
            if record.count == n:
                return
            record.touch((tuple(point.tolist()), tuple(normal.tolist())), stroke)
            stroke += 1


def scan_lines(finger: Finger, record: Record, n: int, step: float, max_strokes: int | None) -> None:
    surface = finger.surface
    extent = surface.corners.max((0, 1)) - surface.corners.min((0, 1))
    axis = int(extent.argmax())

    def lines(planes: int) -> list[NDArray[np.float64]]:
        # half a spacing inside the ends, and off the coordinates that vertices tend to lie on
        at = (np.arange(planes) + 0.5 + 1e-4) / planes - 0.5
        return list(surface.contours(axis, at * extent[axis]))

    def length_of(line: NDArray[np.float64]) -> float:
        return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())

    trial = 16
    total = sum(map(length_of, lines(trial)))
    found = lines(max(1, round(trial * n * step / max(total, 1e-9))))
    if max_strokes is not None:
        found = found[:max_strokes]
    # n contacts in all (before any turns out to be unreachable), evenly over the lines
    lengths = np.array([length_of(line) for line in found])
    if not lengths.sum() > 0:
        raise ValueError("no contour found: the mesh has no extent between the scan planes")
    position = (np.arange(n) + 0.5) / n * lengths.sum()
    ends = np.cumsum(lengths)
    owner = np.searchsorted(ends, position, side="right").clip(max=len(found) - 1)
    points = np.empty((n, 3))
    for index, line in enumerate(found):
        mine = owner == index
        along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
        for k in range(3):
            points[mine, k] = np.interp(position[mine] - (ends[index] - lengths[index]), along, line[:, k])
    closest, face, _ = surface.closest(points)
    contacts, normals, fits = finger.place(closest, face)
    if not fits.any():
        raise ValueError("no contact is reachable on the scan lines")
    for index in np.flatnonzero(fits):
        record.touch((tuple(contacts[index].tolist()), tuple(normals[index].tolist())), int(owner[index]))
