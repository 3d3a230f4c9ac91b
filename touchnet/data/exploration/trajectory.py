"""A finger explores a mesh: `simulate_touches`."""

import math
from collections.abc import Callable
from typing import Literal, get_args

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from touchnet.data.exploration.finger import Finger
from touchnet.data.exploration.record import Record, Touches
from touchnet.data.exploration.strokes import Starts, UpTheVariance, Wander
from touchnet.data.exploration.surface import Surface
from touchnet.data.exploration.sweeps import scan_lines, touch_uniform
from touchnet.data.gp import GaussianProcess, KernelName

Strategy = Literal["gp", "random_walk", "scan_lines", "uniform"]


def simulate_touches(
    mesh: "trimesh.Trimesh | Surface",
    n: int = 2048,
    *,
    seed: int = 0,
    start: ArrayLike | None = None,
    strategy: Strategy = "gp",
    step: float | tuple[float, float] | None = None,
    stroke_length: int | None = None,
    max_strokes: int | None = None,
    stop: float = 0.4,
    kernel: KernelName = "matern32",
    length_scale: float = 0.15,
    noise: float = 1e-3,
    candidates: int = 2048,
    finger_radius: float = 0.0,
    unreachable: ArrayLike | Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None = None,
    position_noise: float = 0.0,
    normal_noise: float = 0.0,
    dropout: float = 0.0,
) -> Touches:
    """n contacts of a finger that explores the closed, outward-wound mesh; the same seed gives the same bytes.

    The defaults are ideal contacts. Lengths (step, length_scale, finger_radius, position_noise) are relative to the
    longest side of the mesh's bounding box; start and unreachable are in the mesh's own frame.

    Args:
        mesh: closed triangle mesh, any number of components; or a Surface made of it, which serves any number of
            trajectories.
        n: number of contacts.
        seed: of the starting point and of every other random choice.
        start: point (3,) next to which the first contact is made; None draws it uniformly from the surface.
        strategy: "gp" slides along the gradient of the variance and restarts where the variance is highest;
            "random_walk" slides with a heading that wanders, and restarts anywhere; "scan_lines" follows the
            contours of equally spaced parallel planes, across the longest side; "uniform" touches independent random
            points, each a stroke of its own.
        step: distance of consecutive contacts of a stroke, or (low, high) between which each step is drawn. None:
            sqrt(area / n), the spacing of n contacts spread evenly over the surface, but at most 0.1.
            "scan_lines" spaces its planes so that n contacts with this step cover them all.
        stroke_length: most contacts of a stroke; None: 32, or n / max_strokes where that is more. ("gp" and
            "random_walk".)
        max_strokes: the exploration ends after so many strokes, with fewer than n contacts if need be.
        stop: a stroke of "gp" ends when the variance found at four contacts running is below this share of what an
            undisturbed stroke finds (or of the highest variance on the surface, once that is lower).
        kernel, length_scale, noise: of the Gaussian process (see GaussianProcess; for "thin_plate" length_scale is R).
        candidates: number of surface points among which starts are chosen.
        finger_radius: the finger is a sphere; only where it can rest is there a contact, so that narrow concavities
            stay untouched. Contact normals point to its centre.
        unreachable: where no contact can be made: a box ((3,), (3,)) of low and high corners, or a function from points
            (M, 3) to bool (M,), true where unreachable. A stroke ends there.
        position_noise: standard deviation of the reported positions, isotropic. The Gaussian process sees these.
        normal_noise: standard deviation, in degrees, of the tilt of the reported normals about two tangent axes.
        dropout: probability in [0, 1) that a contact goes unnoticed; n are still returned, except by "scan_lines".

    Raises:
        TypeError: mesh is neither a trimesh.Trimesh nor a Surface.
        ValueError: an argument is out of range, the mesh has no face with an area, or no contact is reachable.
    """
    _check(n >= 1, "n", "at least 1", n)
    low_step, high_step = (0.1, 0.1) if step is None else step if np.ndim(step) else (step, step)
    _check(0 < low_step <= high_step <= 1, "step", "in (0, 1], or 0 < low ≤ high ≤ 1", step)
    _check(stroke_length is None or stroke_length >= 1, "stroke_length", "None or at least 1", stroke_length)
    _check(max_strokes is None or max_strokes >= 1, "max_strokes", "None or at least 1", max_strokes)
    _check(0 <= stop < 1, "stop", "in [0, 1)", stop)
    _check(candidates >= 1, "candidates", "at least 1", candidates)
    _check(0 <= finger_radius <= 1, "finger_radius", "in [0, 1]", finger_radius)
    _check(0 <= position_noise < 1, "position_noise", "in [0, 1)", position_noise)
    _check(0 <= normal_noise < 90, "normal_noise", "in [0, 90) degrees", normal_noise)
    _check(0 <= dropout < 1, "dropout", "in [0, 1)", dropout)
    _check(strategy in get_args(Strategy), "strategy", f"one of {', '.join(get_args(Strategy))}", strategy)

    rng = np.random.default_rng(seed)
    surface = mesh if isinstance(mesh, Surface) else Surface(mesh)
    if step is None:
        low_step = high_step = min(0.1, math.sqrt(float(surface.areas.sum()) / n))
    finger = Finger(surface, finger_radius, _forbidden(unreachable))
    record = Record(n, GaussianProcess(kernel, length_scale=length_scale, noise=noise), rng)
    record.position_noise, record.normal_noise, record.dropout = position_noise, math.radians(normal_noise), dropout
    if strategy == "uniform":
        touch_uniform(finger, record, n if max_strokes is None else min(n, max_strokes), rng)
    elif strategy == "scan_lines":
        scan_lines(finger, record, n, (low_step + high_step) / 2, max_strokes)
    else:
        first = None if start is None else finger.nearest(surface.from_mesh(_point(start, "start")))
        limit = stroke_length or max(32, -(-n // max_strokes) if max_strokes else 0)
        steer = UpTheVariance(length_scale, rng) if strategy == "gp" else Wander(rng)
        if strategy == "random_walk":
            stop = 0.0
        low = stop * _free_variance(kernel, length_scale, noise, (low_step + high_step) / 2)
        starts = Starts(record.gp, *finger.starts(candidates, rng), n, anywhere=strategy == "random_walk")
        stroke = 0
        while record.count < n and stroke != max_strokes:
            contact, highest = starts.next(rng) if stroke or first is None else (first, 1.0)
            enough = min(low, stop * highest)
            length = quiet = 0
            steer.begin()
            while True:
                variance = record.touch(contact, stroke)
                length += 1
                quiet = quiet + 1 if variance < enough else 0
                if record.count == n or quiet == 4 or length == limit:
                    break
                direction = steer(record, contact, variance)
                distance = low_step if low_step == high_step else float(rng.uniform(low_step, high_step))
                following = finger.slide(contact, direction, distance)
                if following is None:
                    break
                contact = following
            stroke += 1
    return record.touches(surface)


def _free_variance(kernel: KernelName, length_scale: float, noise: float, step: float) -> float:
    """The variance that a straight stroke finds at its next contact when nothing else was touched."""
    gp = GaussianProcess(kernel, length_scale=length_scale, noise=noise)
    behind = 16 if kernel != "thin_plate" else max(1, min(16, int(length_scale / step)))  # within R
    line = np.arange(behind + 1)[:, None] * [step, 0.0, 0.0]
    gp.add(line[:-1])
    return float(gp.variance(line[-1:])[0])


def _point(value: ArrayLike, name: str) -> NDArray[np.float64]:
    point = np.asarray(value, dtype=np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ValueError(f"{name} should be a finite point of shape (3,), got {value}")
    return point


def _forbidden(
    unreachable: ArrayLike | Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None,
) -> Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None:
    if unreachable is None or callable(unreachable):
        return unreachable
    box = np.asarray(unreachable, dtype=np.float64)
    if box.shape != (2, 3) or not (box[0] <= box[1]).all():
        raise ValueError(f"unreachable should be a function or a box (low (3,), high (3,)), got {unreachable}")
    return lambda points: ((points >= box[0]) & (points <= box[1])).all(1)


def _check(holds: bool, name: str, expected: str, got: object) -> None:
    if not holds:
        raise ValueError(f"{name} should be {expected}, got {got}")
