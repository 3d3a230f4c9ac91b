"""Procedural bottles, airplanes, cars and simple solids: closed meshes out of seeded numbers, y up as real ones are.

A shape is the union of simple solids, each a field that is positive inside and about the distance to its surface there,
evaluated on a grid around the part only; marching cubes makes one closed mesh of the whole.
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from touchnet.data.dataset import TouchDataset
from touchnet.data.factory import MeshSource, Parameters, build
from touchnet.ops import marching_cubes

CATEGORIES = ("airplane", "bottle", "car", "solid")

# Raised when the same seed comes to mean another shape.
EDITION = 1

Array = NDArray[np.float32]
Field = Callable[[Array, Array, Array], Array]
Vector = Sequence[float]


def procedural_mesh(category: str, seed: int, *, resolution: int = 128) -> trimesh.Trimesh:
    """A closed bottle, airplane, car or simple solid (y up, longest side 1, centred) that depends on the seed alone.

    Args:
        category: "airplane", "bottle", "car" or "solid" (up to four balls, boxes, cylinders, cones and rings in one).
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
    solid = {"airplane": _airplane, "bottle": _bottle, "car": _car, "solid": _simple_solid}[category](rng, resolution)
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


class _Solid:
    """A union of parts on a grid over the box low..high, spacing = longest side / resolution."""

    def __init__(self, low: Vector, high: Vector, resolution: int) -> None:
        self.low = np.asarray(low, dtype=np.float64)
        self.spacing = float((np.asarray(high) - self.low).max()) / resolution
        self.shape = np.ceil((np.asarray(high) - self.low) / self.spacing).astype(int) + 1
        self.field = np.full(self.shape, -1, dtype=np.float32)

    def window(self, low: Vector, high: Vector) -> tuple[tuple[slice, ...], list[Array]]:
        """The part of the grid in a box, and its coordinates ready to broadcast."""
        first = np.clip(np.floor((np.asarray(low) - self.low) / self.spacing).astype(int) - 1, 0, self.shape)
        last = np.clip(np.ceil((np.asarray(high) - self.low) / self.spacing).astype(int) + 2, 0, self.shape)
        axes = []
        for axis in range(3):
            x = (self.low[axis] + self.spacing * np.arange(first[axis], last[axis])).astype(np.float32)
            axes.append(x.reshape([-1 if other == axis else 1 for other in range(3)]))
        return tuple(slice(a, b) for a, b in zip(first, last, strict=True)), axes

    def add(self, field: Field, low: Vector, high: Vector, *, blend: float = 0.0) -> None:
        """Union with field ≥ 0, which must be negative outside the box; `blend` rounds the joint (length)."""
        where, axes = self.window(np.asarray(low) - blend, np.asarray(high) + blend)
        self.field[where] = _smooth_max(self.field[where], field(*axes), blend)

    def cut(self, field: Field, low: Vector, high: Vector) -> None:
        """Difference with field ≥ 0, which must be negative outside the box."""
        where, axes = self.window(low, high)
        self.field[where] = np.minimum(self.field[where], -field(*axes))

    def mesh(self) -> trimesh.Trimesh:
        high = self.low + self.spacing * (self.shape - 1)
        vertices, faces = marching_cubes(
            torch.from_numpy(self.field).double(), 0.0, box=(tuple(self.low.tolist()), tuple(high.tolist()))
        )
        mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
        parts = mesh.split(only_watertight=False)
        # Parts that the numbers left without contact would float in the air.
        mesh = max(parts, key=lambda part: len(part.faces)) if len(parts) > 1 else mesh
        low, high = mesh.bounds
        return trimesh.Trimesh((mesh.vertices - (low + high) / 2) / (high - low).max(), mesh.faces, process=False)


def _smooth_max(a: Array, b: Array, width: float) -> Array:
    if width <= 0:
        return np.maximum(a, b)
    # Quilez' polynomial blend: exact where the two differ by more than the width.
    h = np.maximum(width - np.abs(a - b), 0) / width
    return np.maximum(a, b) + h * h * (width / 4)


def _smooth_min(a: Array, b: Array, width: float) -> Array:
    return -_smooth_max(-a, -b, width)


def _curve(knots: Sequence[tuple[float, float]]) -> Callable[[Array], Array]:
    """A curve through the knots (x, y) without overshoot, constant beyond the ends."""
    x, y = np.array(sorted(knots), dtype=np.float64).T
    keep = np.concatenate([[True], np.diff(x) > 1e-6])
    x, y = x[keep], y[keep]
    through = PchipInterpolator(x, y)
    return lambda at: through(np.clip(at, x[0], x[-1])).astype(np.float32)


def _polyline(knots: Sequence[tuple[float, float]]) -> Callable[[Array], Array]:
    x, y = np.array(sorted(knots), dtype=np.float64).T
    return lambda at: np.interp(at, x, y).astype(np.float32)


def _capsule(a: Vector, b: Vector, radius: float, end: float | None = None) -> tuple[Field, Vector, Vector]:
    """Segment a-b thickened by `radius`, which changes to `end` along the way."""
    a, b = np.asarray(a, dtype=np.float32), np.asarray(b, dtype=np.float32)
    end = radius if end is None else end
    along = b - a
    length2 = max(float(along @ along), 1e-12)

    def field(x: Array, y: Array, z: Array) -> Array:
        dx, dy, dz = x - a[0], y - a[1], z - a[2]
        t = np.clip((dx * along[0] + dy * along[1] + dz * along[2]) / length2, 0, 1)
        gap = np.sqrt((dx - t * along[0]) ** 2 + (dy - t * along[1]) ** 2 + (dz - t * along[2]) ** 2)
        return radius + t * (end - radius) - gap

    reach = max(radius, end)
    return field, np.minimum(a, b) - reach, np.maximum(a, b) + reach


def _tube(points: Sequence[Vector], radius: float) -> tuple[Field, Vector, Vector]:
    """Capsules along a polyline."""
    pieces = [_capsule(a, b, radius) for a, b in itertools.pairwise(points)]

    def field(x: Array, y: Array, z: Array) -> Array:
        return functools.reduce(np.maximum, [piece[0](x, y, z) for piece in pieces])

    return field, np.min([piece[1] for piece in pieces], axis=0), np.max([piece[2] for piece in pieces], axis=0)


def _cylinder(
    centre: Vector, axis: int, radius: float, half: float, rounding: float = 0.0
) -> tuple[Field, Vector, Vector]:
    centre = np.asarray(centre, dtype=np.float32)
    u, v = (k for k in range(3) if k != axis)

    def field(x: Array, y: Array, z: Array) -> Array:
        d = (x - centre[0], y - centre[1], z - centre[2])
        return _smooth_min(radius - np.sqrt(d[u] ** 2 + d[v] ** 2), half - np.abs(d[axis]), rounding)

    reach = np.full(3, radius)
    reach[axis] = half
    return field, centre - reach, centre + reach


def _box(centre: Vector, half: Vector, rounding: float = 0.0, pitch: float = 0.0) -> tuple[Field, Vector, Vector]:
    """A box with rounded edges, turned by `pitch` about z through its centre."""
    centre, half = np.asarray(centre, dtype=np.float32), np.asarray(half, dtype=np.float32)
    cos, sin = math.cos(pitch), math.sin(pitch)

    def field(x: Array, y: Array, z: Array) -> Array:
        dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
        a, b = cos * dx + sin * dy, cos * dy - sin * dx
        return _smooth_min(
            _smooth_min(half[0] - np.abs(a), half[1] - np.abs(b), rounding), half[2] - np.abs(dz), rounding
        )

    reach = np.array([abs(cos) * half[0] + abs(sin) * half[1], abs(sin) * half[0] + abs(cos) * half[1], half[2]])
    return field, centre - reach, centre + reach


def _superellipse(x: Array, z: Array, a: Array, b: Array, power: Array | float) -> Array:
    """About the distance to the inside of (|x|/a)^n + (|z|/b)^n = 1."""
    a, b = np.maximum(a, 1e-4), np.maximum(b, 1e-4)
    u, v = np.abs(x) / a, np.abs(z) / b
    norm = (u**power + v**power + 1e-12) ** (1 / power)
    return (1 - norm) * np.minimum(a, b)


# --- bottles ------------------------------------------------------------------------------------------------------


def _bottle(rng: np.random.Generator, resolution: int) -> _Solid:
    """Height 1; the mouth is up. Wine, beer, soda, whisky, flask, jar, jug, canister, spray and pump bottles."""
    kind = rng.choice(
        ["wine", "soda", "flask", "squared", "pill", "jug", "canister", "spray", "pump", "sport"],
        p=[0.15, 0.17, 0.12, 0.15, 0.08, 0.11, 0.07, 0.06, 0.06, 0.03],
    )
    radius = {
        "wine": rng.uniform(0.11, 0.19),
        "soda": rng.uniform(0.12, 0.21),
        "flask": rng.uniform(0.2, 0.42),
        "squared": rng.uniform(0.14, 0.3),
        "pill": rng.uniform(0.22, 0.4),
        "jug": rng.uniform(0.2, 0.36),
        "canister": rng.uniform(0.3, 0.42),
        "spray": rng.uniform(0.13, 0.22),
        "pump": rng.uniform(0.15, 0.26),
        "sport": rng.uniform(0.13, 0.2),
    }[kind]
    flat = {"squared": rng.uniform(0.4, 1), "canister": rng.uniform(0.4, 0.75), "spray": rng.uniform(0.55, 1)}.get(
        kind, rng.uniform(0.5, 0.9) if rng.random() < 0.15 else 1.0
    )
    power = {"squared": rng.uniform(3, 9), "canister": rng.uniform(3.5, 8)}.get(
        kind, rng.uniform(2.3, 4) if rng.random() < 0.2 else 2.0
    )
    head = {"spray": rng.uniform(0.2, 0.28), "pump": rng.uniform(0.15, 0.25)}.get(kind, 0.0)
    top = 1 - head
    neck = radius * rng.uniform(0.22, 0.5)
    if kind in ("pill", "sport"):
        neck = radius * rng.uniform(0.65, 0.95)
    if kind == "canister":
        neck = radius * rng.uniform(0.18, 0.3)
    neck = max(neck, 0.035)
    neck_length = top * {"wine": rng.uniform(0.18, 0.32), "flask": rng.uniform(0.15, 0.5)}.get(
        kind, rng.uniform(0.05, 0.14)
    )
    shoulder = top * {"pill": rng.uniform(0.03, 0.1), "canister": rng.uniform(0.05, 0.12)}.get(
        kind, rng.uniform(0.07, 0.32)
    )
    low = top - neck_length - shoulder  # where the body ends

    heel = min(rng.uniform(0.01, 0.08), 0.3 * radius)
    body = [(0.0, radius - heel * rng.uniform(0.2, 1)), (heel, radius)]
    style = rng.choice(["straight", "waist", "bulge", "taper", "flare"], p=[0.4, 0.2, 0.15, 0.15, 0.1])
    if kind == "flask":
        style = "bulge"
    middle = rng.uniform(0.35, 0.65) * low
    if style == "waist":
        body += [(middle, radius * rng.uniform(0.72, 0.93)), (low, radius * rng.uniform(0.85, 1.05))]
    elif style == "bulge":
        body[0] = (0.0, radius * rng.uniform(0.45, 0.8))
        body[1] = (middle, radius)
        body += [(low, radius * rng.uniform(0.7, 0.95))]
    elif style == "taper":
        body += [(low, radius * rng.uniform(0.7, 0.9))]
    elif style == "flare":
        body[0] = (0.0, radius * rng.uniform(0.7, 0.85))
        body += [(low, radius)]
    else:
        body += [(low * 0.6, radius), (low, radius)]
    end = body[-1][1]
    bend = rng.uniform(0.2, 0.8)
    lip = neck * rng.uniform(1.03, 1.2)
    body += [
        (low + shoulder * bend, neck + (end - neck) * rng.uniform(0.3, 0.75)),
        (low + shoulder, neck),
        (top - 0.035, neck * rng.uniform(0.88, 1.0)),
        (top - 0.03, lip),
        (top, lip),
    ]
    profile = _curve(body)
    ribs = int(rng.integers(3, 9)) if rng.random() < 0.2 else 0
    rib_depth = radius * rng.uniform(0.02, 0.06)
    flutes = int(rng.integers(5, 16)) if rng.random() < 0.15 else 0
    flute_depth = rng.uniform(0.02, 0.07)

    def shell(inset: float, bottom: float, ceiling: float) -> Field:
        def field(x: Array, y: Array, z: Array) -> Array:
            r = profile(y)
            round_off = np.clip((y - low) / max(shoulder, 1e-3), 0, 1)  # the neck is round whatever the body is
            if ribs:
                inner = (y > heel) & (y < low)
                r = r - np.where(
                    inner, rib_depth * (0.5 - 0.5 * np.cos(2 * np.pi * ribs * (y - heel) / (low - heel))), 0
                )
            a, b = r, r * (flat + (1 - flat) * round_off)
            n = power + (2 - power) * round_off
            if flutes:
                turn = np.arctan2(z, x)
                a = a * (1 - flute_depth * (1 - round_off) * (0.5 + 0.5 * np.cos(flutes * turn)))
                b = b * (1 - flute_depth * (1 - round_off) * (0.5 + 0.5 * np.cos(flutes * turn)))
            side = _superellipse(x, z, a, b, n) - inset
            return _smooth_min(_smooth_min(side, y - bottom, heel), ceiling - y, 0.008)

        return field

    reach = radius * 1.1
    beside = max(reach, 0.5 if kind == "spray" else 0, reach + 0.3 if kind in ("jug", "pump") else 0)
    solid = _Solid((-beside, -0.01, -reach - 0.01), (beside, 1.01, reach + 0.01), resolution)
    around = ((-reach, 0, -reach), (reach, top, reach))
    solid.add(shell(0, 0, top), *around)

    if rng.random() < 0.35:  # a dent in the bottom
        depth = rng.uniform(0.02, 0.12)
        wide = radius * flat * rng.uniform(0.4, 0.75)

        def dent(x: Array, y: Array, z: Array) -> Array:
            return depth * (1 - (x * x + z * z) / (wide * wide)) - y

        solid.cut(dent, (-wide, -0.1, -wide), (wide, depth, wide))
    else:
        depth = 0.0

    open_top = kind in ("wine", "soda", "flask", "squared", "jug", "pill") and neck > 0.045 and rng.random() < 0.4
    if open_top:
        wall = rng.uniform(0.016, max(0.018, min(0.03, 0.4 * neck)))
        solid.cut(shell(wall, depth + wall * 1.5, 1.2), (-reach, depth, -reach), (reach, 1.1, reach))
    elif kind not in ("spray", "pump"):
        cap = lip * rng.uniform(1.05, 1.35)
        high = rng.uniform(0.03, 0.1) if kind != "pill" else rng.uniform(0.1, 0.2)
        if kind == "pill":
            cap = min(max(cap, radius * rng.uniform(0.85, 1.0)), radius)
        if rng.random() < 0.75:
            solid.add(*_cylinder((0, top - high / 2, 0), 1, cap, high / 2, rng.uniform(0.002, 0.015)))
        if kind == "sport":
            solid.add(*_capsule((0, top - high, 0), (0, 0.995 - 0.02, 0), cap * 0.4, 0.02))

    if kind == "jug" or (kind in ("flask", "squared") and rng.random() < 0.15):
        _bottle_handle(rng, solid, profile, low + shoulder * 0.9, low * rng.uniform(0.25, 0.6), beside)
    if kind == "canister":
        _canister_grip(rng, solid, radius, low, flat)
    if kind == "spray":
        _spray_head(rng, solid, top, neck)
    if kind == "pump":
        _pump_head(rng, solid, top, neck)
    if rng.random() < 0.15 and kind in ("wine", "soda", "squared"):  # a raised label
        at, high = middle, rng.uniform(0.08, 0.2) * low

        def label(x: Array, y: Array, z: Array) -> Array:
            r = profile(np.full_like(y, at)) + 0.006
            return np.minimum(_superellipse(x, z, r, r * flat, power), high - np.abs(y - at))

        solid.add(label, (-reach, at - high, -reach), (reach, at + high, reach))
    return solid


def _bottle_handle(
    rng: np.random.Generator, solid: _Solid, profile: Callable[[Array], Array], high: float, low: float, beside: float
) -> None:
    thick = rng.uniform(0.018, 0.035)
    r0, r1 = (float(profile(np.float32(y))) for y in (low, high))
    out = min(max(r0, r1) + rng.uniform(0.09, 0.2), beside - thick - 0.01)
    turns = np.linspace(0, np.pi, 9)
    square = rng.uniform(0.5, 1.0)  # 1: half an ellipse, less: flatter
    lift = np.sign(np.cos(turns)) * np.abs(np.cos(turns)) ** square
    y = (low + high) / 2 - lift * (high - low) / 2
    inner = r0 + (r1 - r0) * (y - low) / (high - low) - 0.5 * thick
    x = inner + (out - inner) * np.sin(turns) ** square
    sides = (1, -1) if rng.random() < 0.12 else (1,)
    for side in sides:
        field, box_low, box_high = _tube([(side * a, b, 0) for a, b in zip(x, y, strict=True)], thick)
        solid.add(field, box_low, box_high, blend=0.01)


def _canister_grip(rng: np.random.Generator, solid: _Solid, radius: float, low: float, flat: float) -> None:
    """A hole through the upper corner, so that the rim becomes the handle."""
    wide, high = radius * rng.uniform(0.35, 0.5), low * rng.uniform(0.08, 0.16)
    centre = (radius * 0.35, low * rng.uniform(0.72, 0.82), 0)
    solid.cut(*_box(centre, (wide, high, 2 * radius), 0.02, rng.uniform(-0.3, 0.1)))


def _spray_head(rng: np.random.Generator, solid: _Solid, top: float, neck: float) -> None:
    long, high = rng.uniform(0.13, 0.24), rng.uniform(0.035, 0.05)
    solid.add(*_cylinder((0, top + 0.02, 0), 1, neck * 1.25, 0.05, 0.005))
    solid.add(*_capsule((0, top, 0), (0, 1 - high, 0), neck * 0.8))
    solid.add(*_box((long * 0.35, 1 - high, 0), (long, high, rng.uniform(0.03, 0.05)), 0.015))
    solid.add(*_capsule((long * 1.2, 1 - high, 0), (long * 1.35 + 0.03, 1 - high, 0), 0.025, 0.018))
    trigger = [
        (long * 0.9, 1 - 1.6 * high, 0),
        (long * 1.0, 1 - 0.12, 0),
        (long * 0.75, 1 - rng.uniform(0.16, 0.22), 0),
    ]
    solid.add(*_tube(trigger, rng.uniform(0.014, 0.02)))


def _pump_head(rng: np.random.Generator, solid: _Solid, top: float, neck: float) -> None:
    solid.add(*_cylinder((0, top, 0), 1, neck * 1.3, 0.03, 0.005))
    solid.add(*_capsule((0, top, 0), (0, 0.97, 0), max(0.018, neck * 0.35)))
    long = rng.uniform(0.1, 0.25)
    solid.add(*_cylinder((0, 0.965, 0), 1, neck * rng.uniform(0.7, 1.0), 0.025, 0.008))
    spout = [(0, 0.97, 0), (long * 0.8, 0.97 - rng.uniform(0, 0.02), 0), (long, 0.93 - rng.uniform(0, 0.03), 0)]
    solid.add(*_tube(spout, rng.uniform(0.016, 0.022)))


# --- airplanes ----------------------------------------------------------------------------------------------------


def _airplane(rng: np.random.Generator, resolution: int) -> _Solid:
    """Nose towards +x, right wing towards +z. Airliners, props, gliders, fighters, biplanes, deltas, flying wings."""
    kind = rng.choice(
        ["airliner", "light", "glider", "fighter", "biplane", "bizjet", "turboprop", "wing", "twinboom"],
        p=[0.32, 0.17, 0.1, 0.13, 0.06, 0.08, 0.07, 0.04, 0.03],
    )
    uniform = rng.uniform
    slim = {
        "airliner": uniform(0.045, 0.068),
        "light": uniform(0.055, 0.085),
        "glider": uniform(0.04, 0.055),
        "fighter": uniform(0.045, 0.065),
        "biplane": uniform(0.07, 0.1),
        "bizjet": uniform(0.05, 0.068),
        "turboprop": uniform(0.055, 0.07),
        "wing": uniform(0.04, 0.07),
        "twinboom": uniform(0.05, 0.075),
    }[kind]
    span = {  # half of it
        "airliner": uniform(0.4, 0.56),
        "light": uniform(0.5, 0.72),
        "glider": uniform(0.85, 1.25),
        "fighter": uniform(0.24, 0.42),
        "biplane": uniform(0.45, 0.65),
        "bizjet": uniform(0.4, 0.52),
        "turboprop": uniform(0.45, 0.6),
        "wing": uniform(0.5, 1.0),
        "twinboom": uniform(0.5, 0.8),
    }[kind]
    # What is thin must stay visible to the grid: about two cells of it.
    thin = 0.011 * max(1.0, 2 * span)
    high = 0.42
    solid = _Solid((-0.62, -0.3, -span - 0.05), (0.6, high, span + 0.05), resolution)

    # The fuselage, from the tail at x = -0.5 to the nose at 0.5.
    nose, tail = uniform(0.08, 0.22), uniform(0.25, 0.45)
    tip = {"fighter": 0.1, "airliner": 0.25}.get(kind, uniform(0.15, 0.5))
    radius = _curve(
        [
            (-0.5, slim * (uniform(0.12, 0.25) if kind != "fighter" else uniform(0.5, 0.8))),
            (-0.5 + tail, slim * uniform(0.93, 1)),
            (0.5 - nose, slim),
            (0.5 - 0.35 * nose, slim * uniform(0.66, 0.82)),
            (0.5, slim * tip),
        ]
    )
    rise = slim * (uniform(0.3, 0.75) if kind != "fighter" else uniform(-0.1, 0.2))
    drop = slim * uniform(0, 0.3)
    spine = _curve([(-0.5, rise), (-0.5 + tail, 0), (0.5 - nose, 0), (0.5, -drop)])
    tall, squarish = uniform(0.95, 1.35), uniform(1.9, 2.8)
    if kind == "wing":
        tail, nose = 0.3, 0.2

    def fuselage(x: Array, y: Array, z: Array) -> Array:
        r = radius(x)
        return np.minimum(_superellipse(z, y - spine(x), r, r * tall, squarish), 0.5 - np.abs(x))

    if kind == "wing":
        pod = _capsule((uniform(-0.2, 0), 0, 0), (uniform(0.15, 0.3), 0, 0), slim, slim * 0.6)
        solid.add(*pod)
    elif kind == "twinboom":
        solid.add(*_capsule((-0.1, 0, 0), (0.35, 0, 0), slim * 1.1, slim * 0.8))
    else:
        solid.add(fuselage, (-0.5, -0.2, -0.16), (0.5, 0.2, 0.16))

    if kind in ("light", "glider", "fighter", "biplane", "twinboom"):  # a canopy
        at, long = uniform(0.12, 0.3), uniform(0.06, 0.14)
        canopy_high = slim * tall * uniform(0.3, 0.75)

        def canopy(x: Array, y: Array, z: Array) -> Array:
            d = ((x - at) / long) ** 2 + ((y - slim * tall * 0.7) / canopy_high) ** 2 + (z / (slim * 0.75)) ** 2
            return (1 - np.sqrt(d + 1e-9)) * canopy_high

        reach = slim * tall * 0.7 + canopy_high
        solid.add(canopy, (at - long, 0, -slim), (at + long, reach, slim), blend=0.008)

    # The main wing.
    sweep = {
        "airliner": uniform(0.35, 0.7),
        "bizjet": uniform(0.3, 0.6),
        "fighter": uniform(0.5, 1.3),
        "wing": uniform(0.3, 0.9),
    }.get(kind, uniform(-0.06, 0.12))
    root = {
        "airliner": uniform(0.15, 0.23),
        "fighter": uniform(0.28, 0.48),
        "glider": uniform(0.07, 0.1),
        "wing": uniform(0.3, 0.5),
    }.get(kind, uniform(0.12, 0.19))
    taper = {
        "fighter": uniform(0.08, 0.35),
        "airliner": uniform(0.2, 0.38),
        "wing": uniform(0.2, 0.45),
    }.get(kind, uniform(0.4, 1.0))
    place = uniform(-0.02, 0.12) if kind != "fighter" else uniform(-0.12, 0.0)
    if kind == "wing":
        place = uniform(0.1, 0.25)
    up = rng.choice(
        [-0.6, 0.0, 0.85], p={"airliner": [0.85, 0.05, 0.1], "turboprop": [0.3, 0, 0.7]}.get(kind, [0.4, 0.25, 0.35])
    )
    if kind == "wing":
        up = 0.0
    dihedral = uniform(0.02, 0.13) if up < 0.5 else uniform(-0.06, 0.03)
    leading = place + root / 2
    kink = uniform(0.25, 0.4) if kind == "airliner" else 0.0
    wing = _Wing(leading, up * slim * tall, root, taper, span, sweep, dihedral, thin, uniform(0.09, 0.15), kink)
    solid.add(*wing.part(), blend=0.006)
    if kind == "biplane":
        gap = uniform(0.13, 0.2)
        upper = _Wing(
            leading + uniform(0, 0.06), slim * tall + gap * 0.75, root, taper, span, sweep, dihedral, thin, 0.1, 0
        )
        solid.add(*upper.part())
        for z in [0.6, 0.12] if rng.random() < 0.6 else [0.4, 0.75, 0.12]:
            for shift in (0.2, 0.75):
                low_end, high_end = wing.at(z * span, shift), upper.at(z * span, shift)
                for side in (1, -1):
                    flip = np.array([1, 1, side])
                    solid.add(*_capsule(low_end * flip, high_end * flip, thin * 0.75))
    elif kind == "light" and up > 0.5 and rng.random() < 0.7:  # struts of a high wing
        for side in (1, -1):
            flip = np.array([1, 1, side])
            solid.add(
                *_capsule(
                    np.array([place, -slim * 0.6, slim * 0.5]) * flip, wing.at(0.5 * span, 0.4) * flip, thin * 0.7
                )
            )
    if kind in ("airliner", "bizjet", "glider") and rng.random() < 0.5:  # winglets
        tip_at = wing.at(span * 0.985, 0.5)
        rise_by = uniform(0.04, 0.1)
        chord = wing.chord(span)
        for side in (1, -1):
            solid.add(
                *_fin(
                    tip_at * np.array([1, 1, side]) + np.array([chord / 2, -thin, 0]),
                    chord,
                    0.6,
                    rise_by,
                    0.5,
                    thin,
                    uniform(0, 0.5) * side,
                )
            )

    _tail(rng, solid, kind, slim, tall, rise, thin, span)
    _engines(rng, solid, kind, slim, tall, rise, wing, span, thin)
    if kind in ("light", "biplane", "turboprop") and rng.random() < 0.55:  # wheels
        legs = [(place + 0.02, slim * uniform(1.4, 2.2)), (uniform(0.3, 0.38) if rng.random() < 0.6 else -0.42, 0.0)]
        ground = -slim * tall - uniform(0.06, 0.11)
        wheel = uniform(0.018, 0.03)
        for x, z in legs:
            for side in (1, -1) if z else (1,):
                start = float(spine(np.float32(x)))
                solid.add(
                    *_capsule((x, start - slim * 0.3, side * z * 0.4), (x, ground + wheel, side * z), thin * 0.75)
                )
                solid.add(*_cylinder((x, ground + wheel, side * z), 2, wheel, thin, 0.004))
    return solid


class _Wing:
    """A tapered, swept lifting surface, symmetric about z = 0."""

    def __init__(
        self,
        leading: float,
        y: float,
        root: float,
        taper: float,
        span: float,
        sweep: float,
        dihedral: float,
        thin: float,
        thickness: float,
        kink: float,
    ) -> None:
        self.leading, self.y, self.root, self.taper, self.span = leading, y, root, taper, span
        self.sweep, self.dihedral, self.thin, self.thickness, self.kink = sweep, dihedral, thin, thickness, kink

    def chord(self, z: float) -> float:
        return float(self._chord(np.float32(z)))

    def _chord(self, z: Array) -> Array:
        s = np.minimum(np.abs(z) / self.span, 1)
        straight = self.root * (1 - (1 - self.taper) * s)
        if self.kink:  # airliners carry extra chord at the root
            straight = straight + self.root * 0.45 * np.maximum(0, 1 - s / self.kink)
        return straight

    def at(self, z: float, share: float) -> NDArray[np.float64]:
        """The middle of the wing at z, `share` of the chord behind its leading edge."""
        return np.array(
            [self.leading - self.sweep * abs(z) - share * self.chord(z), self.y + self.dihedral * abs(z), z]
        )

    def part(self) -> tuple[Field, Vector, Vector]:
        def field(x: Array, y: Array, z: Array) -> Array:
            out = np.abs(z)
            chord = self._chord(z)
            behind = self.leading - self.sweep * out - x  # distance from the leading edge
            share = np.clip(behind / chord, 0, 1)
            # Blunt in front, thin behind, never under what the grid can show.
            half = np.maximum(self.thickness * chord * 1.3 * np.sqrt(share) * (1 - share) + 0.1 * self.thin, self.thin)
            slab = half - np.abs(y - self.y - self.dihedral * out)
            edges = np.minimum(behind, chord - behind)
            return np.minimum(np.minimum(slab, edges + 0.0 * slab), self.span - out)

        ends = [self.leading, self.leading - self.sweep * self.span]
        back = [self.leading - 1.5 * self.root, ends[1] - self.chord(self.span)]
        thick = self.thickness * self.root * 1.1 + 2 * self.thin
        heights = [self.y, self.y + self.dihedral * self.span]
        return (
            field,
            (min(ends + back), min(heights) - thick, -self.span),
            (max(ends), max(heights) + thick, self.span),
        )


def _fin(
    base: NDArray[np.float64], chord: float, taper: float, high: float, sweep: float, thin: float, lean: float = 0.0
) -> tuple[Field, Vector, Vector]:
    """A vertical surface that starts at the front of its base and leans towards +z by `lean` a unit of height."""

    def field(x: Array, y: Array, z: Array) -> Array:
        up = y - base[1]
        s = np.clip(up / high, 0, 1)
        behind = base[0] - sweep * up - x
        length = chord * (1 - (1 - taper) * s)
        slab = thin - np.abs(z - base[2] - lean * up)
        return np.minimum(np.minimum(slab, np.minimum(behind, length - behind)), np.minimum(up, high - up))

    xs = [base[0], base[0] - chord, base[0] - sweep * high, base[0] - sweep * high - chord * taper]
    zs = [base[2], base[2] + lean * high]
    return (
        field,
        (min(xs), base[1], min(zs) - thin),
        (max(xs), base[1] + high, max(zs) + thin),
    )


def _tail(
    rng: np.random.Generator, solid: _Solid, kind: str, slim: float, tall: float, rise: float, thin: float, span: float
) -> None:
    uniform = rng.uniform
    if kind == "wing":
        for side in (1, -1):
            if rng.random() < 0.5:
                solid.add(*_fin(np.array([0.0, 0.0, side * span * 0.5]), 0.15, 0.6, uniform(0.06, 0.14), 0.6, thin))
        return
    if kind == "twinboom":
        out = uniform(0.12, 0.2)
        for side in (1, -1):
            solid.add(*_capsule((0.1, 0, side * out), (-0.5, 0.01, side * out), 0.022, thin))
            solid.add(*_fin(np.array([-0.4, 0.0, side * out]), 0.1, 0.7, uniform(0.07, 0.13), 0.3, thin))
        solid.add(*_box((-0.46, uniform(0.01, 0.06), 0), (0.04, thin, out + 0.01), 0.004))
        return
    chord, high = uniform(0.1, 0.18), uniform(0.12, 0.2)
    style = rng.choice(["plain", "tee", "vee", "twin", "cruciform", "canard"], p=_tail_odds(kind))
    root_y = rise + slim * 0.1
    front = -0.5 + chord + uniform(0, 0.03)
    sweep = uniform(0.5, 1.0) if kind in ("airliner", "fighter", "bizjet") else uniform(0.05, 0.6)
    half = span * uniform(0.28, 0.42) if kind not in ("glider", "fighter") else uniform(0.14, 0.24)
    tail_sweep = min(sweep, 0.7) if kind in ("airliner", "fighter", "bizjet") else uniform(0, 0.25)
    depth = uniform(0.65, 1.0) * chord
    if style == "vee":
        for side in (1, -1):
            solid.add(
                *_fin(
                    np.array([front, root_y, side * slim * 0.15]), chord, 0.6, high, 0.5, thin, side * uniform(0.9, 1.1)
                )
            )
        return
    if style == "twin":
        for side in (1, -1):
            lean = side * uniform(0, 0.4)
            solid.add(
                *_fin(
                    np.array([front + 0.02, 0.0, side * slim * uniform(0.8, 1.3)]),
                    chord,
                    0.5,
                    high * 0.9,
                    sweep,
                    thin,
                    lean,
                )
            )
        plane = _Wing(front, 0.0, depth, 0.5, half, tail_sweep, 0.0, thin, 0.08, 0)
    else:
        solid.add(*_fin(np.array([front, root_y, 0.0]), chord, uniform(0.4, 0.7), high, sweep, thin * 1.1), blend=0.004)
        lift = {"tee": high * 0.96, "cruciform": high * uniform(0.4, 0.6)}.get(style, 0.0)
        at = front - sweep * lift - 0.005
        if style == "canard":
            at, lift, half = uniform(0.3, 0.4), 0.0, half * 0.8
            root_y = 0.0
        plane = _Wing(at, root_y + lift, depth, uniform(0.4, 0.9), half, tail_sweep, uniform(-0.02, 0.1), thin, 0.09, 0)
    solid.add(*plane.part(), blend=0.004)


def _tail_odds(kind: str) -> list[float]:
    return {
        "airliner": [0.88, 0.09, 0.0, 0.0, 0.03, 0.0],
        "bizjet": [0.1, 0.75, 0.05, 0.0, 0.1, 0.0],
        "glider": [0.3, 0.5, 0.2, 0.0, 0.0, 0.0],
        "fighter": [0.4, 0.0, 0.05, 0.4, 0.0, 0.15],
        "turboprop": [0.4, 0.5, 0.0, 0.0, 0.1, 0.0],
    }.get(kind, [0.75, 0.08, 0.05, 0.04, 0.05, 0.03])


def _engines(
    rng: np.random.Generator,
    solid: _Solid,
    kind: str,
    slim: float,
    tall: float,
    rise: float,
    wing: "_Wing",
    span: float,
    thin: float,
) -> None:
    uniform = rng.uniform
    if kind == "airliner":
        size, long = slim * uniform(0.4, 0.62), uniform(0.05, 0.08)
        stations = [uniform(0.28, 0.38)] if rng.random() < 0.65 else [uniform(0.26, 0.34), uniform(0.5, 0.62)]
        hollow = rng.random() < 0.5
        for station in stations:
            mount = wing.at(station * span, 0.1)
            below = size * uniform(1.15, 1.5) * (-1 if wing.y < slim else 1)
            for side in (1, -1):
                centre = mount * np.array([1, 1, side]) + np.array([long * 0.7, below, 0])
                _nacelle(solid, centre, size, long, hollow)
                solid.add(
                    *_capsule(
                        centre + np.array([0, size * 0.6, 0]) * np.sign(-below), mount * np.array([1, 1, side]), thin
                    )
                )
    elif kind == "bizjet":
        size, long = slim * uniform(0.45, 0.6), uniform(0.05, 0.07)
        x, y = uniform(-0.32, -0.25), slim * uniform(0.2, 0.6)
        for side in (1, -1):
            centre = np.array([x, y, side * slim * uniform(1.5, 1.7)])
            _nacelle(solid, centre, size, long, rng.random() < 0.5)
            solid.add(*_capsule((x, y * 0.8, 0), centre, thin * 1.3))
    elif kind == "turboprop" or (kind == "light" and rng.random() < 0.25):
        stations = [uniform(0.25, 0.36)] if rng.random() < 0.7 else [uniform(0.22, 0.3), uniform(0.45, 0.55)]
        for station in stations:
            mount = wing.at(station * span, 0.3)
            ahead = wing.at(station * span, 0.0)[0] + uniform(0.04, 0.09)
            for side in (1, -1):
                z = side * station * span
                solid.add(*_capsule((mount[0], mount[1], z), (ahead, mount[1], z), slim * 0.38, slim * 0.3))
                _propeller(rng, solid, (ahead + slim * 0.3, mount[1], z), uniform(0.06, 0.1), thin)
    elif kind in ("light", "biplane"):
        _propeller(rng, solid, (0.505, -slim * 0.15, 0), uniform(0.08, 0.13), thin)
        solid.add(*_capsule((0.46, -slim * 0.15, 0), (0.52, -slim * 0.15, 0), slim * 0.35, slim * 0.1))
    elif kind == "fighter":
        if rng.random() < 0.5:
            for side in (1, -1):
                out = side * slim * uniform(0.9, 1.25)
                solid.add(*_box((-0.1, -slim * 0.1, out), (uniform(0.2, 0.32), slim * 0.5, slim * 0.45), slim * 0.25))
        if rng.random() < 0.5:
            for side in (1, -1):
                under = wing.at(span * uniform(0.4, 0.7), 0.4) * np.array([1, 1, side]) - np.array([0, thin * 2.2, 0])
                half = np.array([uniform(0.04, 0.08), 0, 0])
                solid.add(*_capsule(under - half, under + half, thin * 1.3, thin * 0.9))
    elif kind == "twinboom":
        _propeller(rng, solid, (0.35 + slim * 0.8, 0, 0), uniform(0.07, 0.1), thin)


def _nacelle(solid: _Solid, centre: NDArray[np.float64], size: float, long: float, hollow: bool) -> None:
    def barrel(x: Array, y: Array, z: Array) -> Array:
        along = (x - centre[0]) / long
        r = size * (1 - 0.28 * np.clip(-along, 0, 1) ** 2 - 0.12 * np.clip(along, 0, 1) ** 2)
        ring = r - np.sqrt((y - centre[1]) ** 2 + (z - centre[2]) ** 2)
        return np.minimum(ring, (1 - np.abs(along)) * long)

    reach = np.array([long, size, size])
    solid.add(barrel, centre - reach, centre + reach)
    if hollow:
        mouth = centre + np.array([long, 0, 0])
        solid.cut(*_cylinder(mouth, 0, size * 0.6, long * 0.5))


def _propeller(rng: np.random.Generator, solid: _Solid, hub: Vector, radius: float, thin: float) -> None:
    hub = np.asarray(hub, dtype=np.float64)
    if rng.random() < 0.3:
        solid.add(*_cylinder(hub, 0, radius, thin * 0.8))
        return
    blades = int(rng.integers(2, 6))
    start = rng.uniform(0, 2 * np.pi)
    solid.add(*_capsule(hub - np.array([0.02, 0, 0]), hub + np.array([0.01, 0, 0]), thin * 1.3, thin))
    for k in range(blades):
        turn = start + 2 * np.pi * k / blades
        end = hub + radius * np.array([0, np.cos(turn), np.sin(turn)])
        solid.add(*_capsule(hub, end, thin * 0.9, thin * 0.75))


# --- cars ---------------------------------------------------------------------------------------------------------


def _car(rng: np.random.Generator, resolution: int) -> _Solid:
    """Length about 1 along x, front towards +x. Sedans, hatchbacks, wagons, SUVs, vans, pickups, coupés, racers."""
    uniform = rng.uniform
    kind = rng.choice(
        ["sedan", "hatch", "wagon", "suv", "van", "pickup", "coupe", "open", "racer", "formula", "classic"],
        p=[0.2, 0.14, 0.08, 0.14, 0.09, 0.09, 0.1, 0.04, 0.05, 0.04, 0.03],
    )
    if kind == "formula":
        return _formula(rng, resolution)
    high = {
        "suv": uniform(0.36, 0.44),
        "van": uniform(0.4, 0.52),
        "pickup": uniform(0.32, 0.4),
        "coupe": uniform(0.26, 0.3),
        "open": uniform(0.26, 0.3),
        "racer": uniform(0.24, 0.29),
        "classic": uniform(0.34, 0.4),
    }.get(kind, uniform(0.29, 0.36))
    wide = uniform(0.18, 0.22) * (1.05 if kind in ("racer", "suv") else 1)  # half of it
    wheel = high * uniform(0.2, 0.26) if kind != "suv" else high * uniform(0.21, 0.26)
    clear = wheel * uniform(0.35, 0.75) * (1.25 if kind in ("suv", "pickup") else 0.9)
    hood_y = clear + (high - clear) * uniform(0.45, 0.6)
    boot_y = clear + (high - clear) * uniform(0.5, 0.66)
    nose_y = hood_y * uniform(0.72, 0.98)
    bonnet = {"van": uniform(0.36, 0.46), "racer": uniform(0.1, 0.25)}.get(kind, uniform(0.17, 0.28))
    shield = {"van": uniform(0.02, 0.12)}.get(kind, uniform(0.08, 0.17))  # length of the windscreen
    # From the front to the back: nose, bonnet, windscreen, roof, rear window, boot.
    top = [(0.5, nose_y), (0.47, nose_y * 1.02), (bonnet, hood_y), (bonnet - shield, high * uniform(0.95, 0.985))]
    crest = uniform(-0.1, 0.02)
    if kind in ("hatch", "wagon", "suv", "van"):
        back = {"hatch": uniform(-0.4, -0.28), "van": uniform(-0.455, -0.44)}.get(kind, uniform(-0.46, -0.38))
        top += [(crest, high), (back, high * uniform(0.93, 1.0)), (-0.47, boot_y), (-0.5, boot_y * uniform(0.8, 0.95))]
    elif kind == "pickup":
        back = uniform(-0.15, -0.02)
        top += [(back + 0.06, high), (back, high * 0.97), (back - uniform(0.01, 0.05), boot_y), (-0.5, boot_y)]
    elif kind == "open":
        top = [*top[:2], (bonnet, hood_y), (bonnet - 0.02, boot_y), (-0.4, boot_y), (-0.5, boot_y * uniform(0.7, 0.9))]
    else:
        boot = uniform(-0.38, -0.26) if kind != "coupe" else uniform(-0.46, -0.36)
        top += [
            (crest, high),
            (crest - uniform(0.04, 0.12), high * 0.985),
            (boot, boot_y),
            (-0.48, boot_y * uniform(0.9, 1)),
            (-0.5, boot_y * uniform(0.75, 0.9)),
        ]
    smooth = rng.random() < 0.6
    roof = _curve(top) if smooth else _polyline(top)
    belly = _polyline(
        [(-0.5, clear * uniform(1.2, 1.8)), (-0.4, clear), (0.42, clear), (0.5, clear * uniform(1.0, 1.5))]
    )
    plan = _curve([(-0.5, wide * uniform(0.82, 0.95)), (-0.3, wide), (0.25, wide), (0.5, wide * uniform(0.72, 0.92))])
    belt = min(hood_y, boot_y)
    lean = uniform(0.2, 0.5) if kind != "van" else uniform(0.05, 0.2)
    edge = uniform(0.012, 0.045)
    side_bulge = uniform(0, 0.03)

    margin = 0.06
    solid = _Solid((-0.58, -0.01, -wide - margin), (0.56, high + 0.1, wide + margin), resolution)

    def shell(x: Array, y: Array, z: Array) -> Array:
        # The sides lean inwards above the belt line and bulge a little below it.
        half = plan(x) - lean * np.maximum(y - belt, 0) - side_bulge * ((y - belt * 0.6) / high) ** 2
        upright = _smooth_min(roof(x) - y, y - belly(x), edge)
        flank = half - np.abs(z)
        return _smooth_min(_smooth_min(upright, flank, edge), 0.5 - np.abs(x), edge)

    solid.add(shell, (-0.5, 0, -wide), (0.5, high + 0.02, wide))

    front, rear = uniform(0.29, 0.34), uniform(-0.34, -0.27)
    tread = wheel * uniform(0.32, 0.5)
    arch = wheel * uniform(1.08, 1.25)
    for x in (front, rear):
        for side in (1, -1):
            out = side * (float(plan(np.float32(x))) - tread)
            solid.cut(*_cylinder((x, wheel, out + side * tread), 2, arch, tread * 2.4))
    for x in (front, rear):
        for side in (1, -1):
            out = side * (float(plan(np.float32(x))) - tread * uniform(0.9, 1.05))
            solid.add(*_cylinder((x, wheel, out), 2, wheel, tread, wheel * 0.15))
            rim = wheel * uniform(0.5, 0.65)
            if rng.random() < 0.5:  # the rim lies deeper than the tyre
                solid.cut(*_cylinder((x, wheel, out + side * tread), 2, rim, tread * 0.4))
        solid.add(*_cylinder((x, wheel, 0), 2, wheel * 0.3, wide * 0.95))

    if kind == "pickup":
        back = top[5][0]
        wall, floor = 0.02, clear + (boot_y - clear) * uniform(0.3, 0.5)
        centre = ((back - 0.5) / 2 - 0.01, boot_y, 0)
        solid.cut(*_box(centre, ((back + 0.5) / 2 - wall - 0.015, boot_y - floor, wide - wall - 0.015), 0.01))
    if kind == "open":
        seat = uniform(-0.2, -0.12)
        solid.cut(
            *_box(
                ((bonnet + seat) / 2 - 0.05, boot_y, 0), ((bonnet - seat) / 2 - 0.02, high * 0.28, wide - 0.035), 0.02
            )
        )
        for z in (wide * 0.45, -wide * 0.45):
            solid.add(*_box((seat - 0.02, boot_y - 0.01, z), (0.025, high * 0.28, wide * 0.33), 0.02, 0.15))
        solid.add(*_box((bonnet - 0.02, boot_y + 0.035, 0), (0.012, 0.05, wide * 0.85), 0.006, 0.6))
    if rng.random() < 0.7 and kind != "open":  # mirrors
        for side in (1, -1):
            x = bonnet - uniform(0.02, 0.06)
            out = float(plan(np.float32(x)))
            solid.add(*_box((x, belt + 0.015, side * (out + 0.015)), (0.014, 0.016, 0.028), 0.008))
    if kind in ("racer", "coupe", "hatch") and rng.random() < (0.8 if kind == "racer" else 0.3):  # a spoiler
        y = (high if kind == "hatch" else boot_y) + uniform(0.03, 0.07)
        x = uniform(-0.47, -0.42)
        solid.add(*_box((x, y, 0), (uniform(0.03, 0.05), 0.011, wide * uniform(0.75, 0.98)), 0.005, uniform(-0.2, 0.1)))
        for z in (wide * 0.6, -wide * 0.6):
            solid.add(*_capsule((x, boot_y * 0.8, z), (x, y, z), 0.012))
    if kind in ("suv", "wagon", "van") and rng.random() < 0.45:  # rails along the roof
        for side in (1, -1):
            z = side * (wide - lean * (high - belt)) * 0.8
            a, b = crest + uniform(0.02, 0.08), uniform(-0.36, -0.28)
            solid.add(
                *_tube(
                    [(a, high * 0.97, z), (a - 0.03, high + 0.02, z), (b + 0.03, high + 0.02, z), (b, high * 0.95, z)],
                    0.011,
                )
            )
    if kind in ("suv", "pickup") and rng.random() < 0.25:
        solid.add(*_cylinder((-0.51, boot_y * 0.85, 0), 0, wheel * 0.9, 0.03, 0.01))
    if kind in ("sedan", "hatch", "suv") and rng.random() < 0.15:  # a taxi's or police car's lights
        solid.add(*_box((crest - 0.03, high + 0.012, 0), (uniform(0.015, 0.03), 0.022, uniform(0.04, 0.12)), 0.008))
    if kind == "classic":
        for side in (1, -1):
            for x in (front, rear):
                field, low_end, high_end = _cylinder(
                    (x, wheel * 1.05, side * (wide - tread * 0.2)), 2, wheel * 1.35, tread * 1.3, 0.02
                )
                cap = functools.partial(_upper_half, field, wheel * 1.05)
                solid.add(cap, low_end, high_end, blend=0.02)
            solid.add(*_capsule((0.47, hood_y * 0.9, side * wide * 0.6), (0.5, hood_y * 0.9, side * wide * 0.6), 0.035))
            solid.add(
                *_box(((front + rear) / 2, clear, side * (wide + 0.005)), ((front - rear) / 2, 0.012, 0.03), 0.006)
            )
    if rng.random() < 0.5:
        for x, y in ((0.5, clear * 1.5), (-0.5, clear * 1.6)):
            solid.add(
                *_box((x, y + 0.02, 0), (uniform(0.012, 0.03), uniform(0.015, 0.03), wide * uniform(0.75, 0.92)), 0.01)
            )
    return solid


def _upper_half(field: Field, level: float, x: Array, y: Array, z: Array) -> Array:
    return np.minimum(field(x, y, z), y - level)


def _formula(rng: np.random.Generator, resolution: int) -> _Solid:
    """An open-wheeled racing car with wings in front and behind."""
    uniform = rng.uniform
    wide, wheel = uniform(0.18, 0.23), uniform(0.06, 0.075)
    solid = _Solid((-0.56, -0.01, -wide - 0.03), (0.56, 0.34, wide + 0.03), resolution)
    body_y, slim = wheel * uniform(0.8, 1.1), uniform(0.04, 0.055)
    solid.add(*_capsule((-0.3, body_y + 0.02, 0), (0.15, body_y + 0.02, 0), slim * 1.3, slim))
    solid.add(*_capsule((0.1, body_y + 0.02, 0), (0.46, body_y - uniform(0, 0.025), 0), slim, 0.022))
    solid.add(*_capsule((-0.05, body_y + 0.07, 0), (-0.4, body_y + 0.03, 0), uniform(0.04, 0.05), 0.02), blend=0.02)
    pods = uniform(0.5, 0.68) * wide
    for side in (1, -1):
        solid.add(
            *_box((-0.12, body_y, side * pods * 0.75), (uniform(0.13, 0.2), uniform(0.028, 0.04), pods * 0.4), 0.025)
        )
    solid.cut(*_capsule((0.03, body_y + 0.1, 0), (0.1, body_y + 0.09, 0), uniform(0.03, 0.036)))
    front, rear = uniform(0.28, 0.34), uniform(-0.38, -0.32)
    for x, tread in ((front, uniform(0.024, 0.034)), (rear, uniform(0.034, 0.045))):
        for side in (1, -1):
            solid.add(*_cylinder((x, wheel, side * (wide - tread)), 2, wheel, tread, 0.012))
        for lift in (-0.02, 0.022):
            solid.add(*_capsule((x - 0.02, wheel + lift, -wide + tread), (x - 0.02, wheel + lift, wide - tread), 0.011))
    solid.add(*_box((0.47, uniform(0.03, 0.05), 0), (uniform(0.03, 0.045), 0.011, wide * uniform(0.8, 1)), 0.005, 0.1))
    solid.add(*_capsule((0.44, body_y, 0), (0.47, 0.035, 0), 0.018))
    top = uniform(0.19, 0.28)
    solid.add(*_box((-0.46, top, 0), (uniform(0.03, 0.05), 0.011, wide * 0.7), 0.005, -uniform(0.1, 0.35)))
    for side in (1, -1):
        solid.add(*_box((-0.46, top - 0.03, side * wide * 0.7), (0.055, 0.055, 0.011), 0.005))
    solid.add(*_capsule((-0.4, body_y, 0), (-0.46, top, 0), 0.014))
    solid.add(*_capsule((-0.25, body_y, 0), (-0.44, body_y, 0), 0.03, 0.02))
    return solid


# --- simple solids ------------------------------------------------------------------------------------------------


class _Piece(NamedTuple):
    """A primitive in its own axes, and a ball around its origin that it lies in."""

    field: Field
    reach: float


def _primitive(rng: np.random.Generator, size: float) -> _Piece:
    """A ball, box, cylinder, cone or ring whose half extents are about `size`, none less than 0.3 of it."""
    kind = rng.choice(["ball", "box", "cylinder", "cone", "ring"], p=[0.2, 0.35, 0.2, 0.1, 0.15])
    a, b, c = (size * rng.uniform(0.3, 1.0, size=3) ** 0.7).astype(np.float32)
    rounding = 0.6 * min(a, b, c) * rng.random() ** 3

    if kind == "ball":
        least = min(a, b, c)
        return _Piece(lambda x, y, z: (1 - np.sqrt((x / a) ** 2 + (y / b) ** 2 + (z / c) ** 2)) * least, max(a, b, c))
    if kind == "box":
        return _Piece(_box((0, 0, 0), (a, b, c), rounding)[0], math.hypot(a, b, c))
    if kind == "cylinder":
        return _Piece(_cylinder((0, 0, 0), 1, a, b, rounding)[0], math.hypot(a, b))
    if kind == "cone":
        top = a * rng.uniform(0.0, 0.6)

        def cone(x: Array, y: Array, z: Array) -> Array:
            radius = a + (top - a) * (y / b + 1) / 2
            return np.minimum(radius - np.sqrt(x * x + z * z), b - np.abs(y))

        return _Piece(cone, math.hypot(a, b))
    tube = max(0.25 * a, 0.2 * size)

    def ring(x: Array, y: Array, z: Array) -> Array:
        return tube - np.sqrt((np.sqrt(x * x + z * z) - a) ** 2 + y * y)

    return _Piece(ring, a + tube)


def _simple_solid(rng: np.random.Generator, resolution: int) -> _Solid:
    """Up to four primitives grown into each other, turned at random or along the axes; some with a hole or a notch."""
    count = rng.choice([1, 2, 3, 4], p=[0.35, 0.3, 0.2, 0.15])
    upright = rng.random() < 0.6
    placed: list[tuple[Field, np.ndarray, float]] = []
    for n in range(count):
        size = 0.5 if n == 0 else rng.uniform(0.25, 0.5)
        piece = _primitive(rng, size)
        centre = np.zeros(3)
        if n:
            _, near, reach = placed[rng.integers(n)]
            away = rng.normal(size=3)
            centre = near + away / np.linalg.norm(away) * rng.uniform(0.3, 0.8) * reach
        placed.append((_turned(piece.field, centre, _turn(rng, upright)), centre, piece.reach))
    low = np.min([centre - reach for _, centre, reach in placed], axis=0)
    high = np.max([centre + reach for _, centre, reach in placed], axis=0)
    solid = _Solid(low - 0.02, high + 0.02, resolution)
    blend = 0.05 * rng.random() if rng.random() < 0.5 else 0.0
    for field, centre, reach in placed:
        solid.add(field, centre - reach, centre + reach, blend=blend)
    if rng.random() < 0.3:
        piece = _primitive(rng, rng.uniform(0.12, 0.25))
        away = rng.normal(size=3)
        centre = away / np.linalg.norm(away) * rng.uniform(0.0, 0.6) * placed[0][2]
        solid.cut(_turned(piece.field, centre, _turn(rng, upright)), centre - piece.reach, centre + piece.reach)
    return solid


def _turn(rng: np.random.Generator, upright: bool) -> np.ndarray:
    """A random rotation, or one that exchanges axes."""
    if not upright:
        return np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return np.eye(3)[rng.permutation(3)]


def _turned(field: Field, centre: np.ndarray, turn: np.ndarray) -> Field:
    """The field moved to `centre`, its axes being the rows of `turn`."""
    rows, (cx, cy, cz) = turn.astype(np.float32), centre.astype(np.float32)

    def moved(x: Array, y: Array, z: Array) -> Array:
        x, y, z = x - cx, y - cy, z - cz
        return field(*(row[0] * x + row[1] * y + row[2] * z for row in rows))

    return moved
