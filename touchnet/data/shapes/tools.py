"""Procedural hand tools and kitchen tools, lying along x: handles, blades, heads and jaws."""

import numpy as np

from touchnet.data.shapes.fields import (
    Array,
    Field,
    Solid,
    Vector,
    ball,
    box,
    capsule,
    curve,
    cylinder,
    superellipse,
    tube,
)

# Half of the thinnest blade, about a cell of a grid of 128.
THIN = 0.012


def tool(rng: np.random.Generator, resolution: int) -> Solid:
    """A hammer, screwdriver, wrench, spoon, brush, blade, pair of pliers, drill, torch or clamp; about 1 long."""
    makers = {
        "hammer": _hammer,
        "driver": _driver,
        "wrench": _wrench,
        "spoon": _spoon,
        "brush": _brush,
        "blade": _blade,
        "pliers": _pliers,
        "drill": _drill,
        "clamp": _clamp,
    }
    return makers[rng.choice(list(makers))](rng, resolution)


def _grid(resolution: int, high: float, deep: float) -> Solid:
    return Solid((-0.55, -high, -deep), (0.55, high, deep), resolution)


def _handle(rng: np.random.Generator, solid: Solid, start: float, end: float, thickness: float) -> None:
    """From x = start to end: a turned profile, round, flat or with flutes."""
    x = np.linspace(start, end, 5)
    radii = thickness * rng.uniform(0.75, 1.1, size=5)
    radii[[0, -1]] *= rng.uniform(0.6, 1.0, size=2)
    profile = curve(list(zip(x, radii, strict=True)))
    flat = rng.uniform(0.5, 1.0) if rng.random() < 0.5 else 1.0
    flutes = int(rng.integers(4, 9)) if rng.random() < 0.25 else 0
    power = rng.uniform(2.5, 5) if rng.random() < 0.25 else 2.0

    def field(x: Array, y: Array, z: Array) -> Array:
        r = profile(x)
        if flutes:
            r = r * (0.94 + 0.06 * np.cos(flutes * np.arctan2(z, y)))
        return np.minimum(superellipse(y, z, r * flat, r, power), np.minimum(x - start, end - x))

    reach = 1.1 * thickness
    solid.add(field, (start, -reach, -reach), (end, reach, reach))


def _hammer(rng: np.random.Generator, resolution: int) -> Solid:
    """Hammers, mallets, axes and picks: a head across the end of a handle."""
    solid = _grid(resolution, 0.15, 0.36)
    _handle(rng, solid, -0.5, 0.46, rng.uniform(0.022, 0.05))
    at = rng.uniform(0.36, 0.42)
    long, thick = rng.uniform(0.1, 0.3), rng.uniform(0.04, 0.1)
    if rng.random() < 0.5:
        solid.add(*cylinder((at, 0, 0), 2, thick, long, rng.uniform(0.0, 0.02)))
    else:
        solid.add(*box((at, 0, 0), (thick, thick * rng.uniform(0.7, 1.0), long), rng.uniform(0.0, 0.02)))
    if rng.random() < 0.5:  # a claw or a spike on one side
        tip = (at - rng.uniform(0.0, 0.12), 0, min(long + rng.uniform(0.05, 0.15), 0.33))
        for side in (-1, 1) if rng.random() < 0.5 else (0,):
            y = side * 0.5 * thick
            solid.add(*tube([(at, y, 0.3 * long), (at, y, long), tip + np.array([0, y, 0])], [0.04, 0.035, 0.018]))
    return solid


def _driver(rng: np.random.Generator, resolution: int) -> Solid:
    """Screwdrivers, pens, markers, candles, torches, bats: turned bodies, one after another."""
    knots, x = [], -0.5
    thick = rng.uniform(0.03, 0.13)
    for _ in range(int(rng.integers(1, 5))):
        end = min(x + rng.uniform(0.15, 0.6), 0.5)
        radius = max(thick * rng.uniform(0.25, 1.0), 0.016)
        knots += [(x, radius), (end - 0.01, radius * rng.uniform(0.8, 1.1))]
        x = end
    if x < 0.5:
        radius = max(0.4 * thick, 0.016)
        knots += [(x, radius), (0.5, radius)]
    profile = curve(knots)
    reach = max(r for _, r in knots) * 1.05
    solid = _grid(resolution, reach + 0.03, reach + 0.03)
    power = rng.uniform(3, 8) if rng.random() < 0.15 else 2.0

    def field(x: Array, y: Array, z: Array) -> Array:
        r = profile(x)
        return np.minimum(superellipse(y, z, r, r, power), 0.5 - np.abs(x))

    solid.add(field, (-0.5, -reach, -reach), (0.5, reach, reach))
    if rng.random() < 0.3:
        solid.add(*box((-0.2, reach, 0), (rng.uniform(0.04, 0.2), 0.02, 0.02), 0.005))
    return solid


def _wrench(rng: np.random.Generator, resolution: int) -> Solid:
    """A flat shank with an open jaw, a ring or a knob at either end."""
    thick, wide = rng.uniform(THIN, 0.04), rng.uniform(0.03, 0.07)
    solid = _grid(resolution, thick + 0.03, 0.2)
    solid.add(*box((0, 0, 0), (0.4, thick * rng.uniform(0.7, 1.0), wide), rng.uniform(0.0, thick)))
    for side in (-1, 1):
        radius = rng.uniform(1.2, 2.4) * wide
        at = side * (0.5 - radius)
        solid.add(*cylinder((at, 0, 0), 1, radius, thick, rng.uniform(0.0, 0.01)))
        bore = radius * rng.uniform(0.4, 0.65)
        kind = rng.choice(["jaw", "ring", "knob"], p=[0.45, 0.4, 0.15])
        if kind == "jaw":
            solid.cut(*box((at + side * radius * 0.6, 0, 0), (radius * 0.8, 0.1, bore), 0.0, 0.0))
        elif kind == "ring":
            solid.cut(*cylinder((at, 0, 0), 1, bore, 0.1))
    return solid


def _spoon(rng: np.random.Generator, resolution: int) -> Solid:
    """Spoons, ladles and scoops, forks, paddles and rackets: a thin handle and a hollow, flat or toothed head."""
    long, wide, deep = rng.uniform(0.12, 0.26), rng.uniform(0.08, 0.2), rng.uniform(0.04, 0.14)
    solid = _grid(resolution, 0.26, 0.24)
    at = 0.5 - long
    lift = rng.uniform(0.0, 0.12)
    thick = rng.uniform(0.014, 0.03)
    bend = lift * rng.uniform(0.2, 1.0)
    handle = [(-0.5 + thick, lift, 0), (-0.2, bend, 0), (at - 0.8 * long, 0, 0), (at - 0.6 * long, 0, 0)]
    solid.add(*tube(handle, [thick * rng.uniform(1.0, 1.8), thick, thick, thick]))
    kind = rng.choice(["bowl", "paddle", "fork"], p=[0.5, 0.3, 0.2])
    if kind == "bowl":
        wall = rng.uniform(0.02, 0.035)
        solid.add(*ball((at, 0, 0), (long, deep, wide)), blend=0.01)
        solid.cut(*box((at, 0.3, 0), (long, 0.3 - 0.002, wide)))
        solid.cut(*ball((at, 0, 0), np.maximum([long - wall, deep - wall, wide - wall], 0.01)))
    elif kind == "paddle":
        solid.add(*_slab(at, long, wide, max(THIN, thick * 0.7)))
    else:
        solid.add(*_slab(at, long, wide, max(THIN, thick * 0.7)))
        teeth = int(rng.integers(2, 5))
        pitch = 2 * wide / teeth
        for n in range(1, teeth):
            solid.cut(*box((at + 0.5 * long, 0, -wide + n * pitch), (0.7 * long, 0.1, 0.25 * pitch)))
    return solid


def _slab(at: float, long: float, wide: float, thick: float) -> tuple[Field, Vector, Vector]:
    """A rounded outline, `thick` up and down, its middle at x = `at`."""

    def field(x: Array, y: Array, z: Array) -> Array:
        return np.minimum(superellipse(x - np.float32(at), z, long, wide, 3.0), thick - np.abs(y))

    return field, (at - long, -thick, -wide), (at + long, thick, wide)


def _brush(rng: np.random.Generator, resolution: int) -> Solid:
    """Brushes, mops, irons, rakes: a handle and a block under or before its end."""
    solid = _grid(resolution, 0.3, 0.26)
    _handle(rng, solid, -0.5, 0.3, rng.uniform(0.02, 0.05))
    long, high, wide = rng.uniform(0.06, 0.25), rng.uniform(0.02, 0.12), rng.uniform(0.04, 0.22)
    drop = rng.uniform(0.0, 0.1)
    solid.add(*box((0.48 - long, -drop, 0), (long, max(high, drop), wide), rng.uniform(0.0, 0.03)))
    if rng.random() < 0.4:
        solid.add(*box((0.48 - long, -drop - high, 0), (long * 0.9, high + 0.03, wide * 0.85)))
    return solid


def _blade(rng: np.random.Generator, resolution: int) -> Solid:
    """Knives, spatulas, trowels, saws: a handle and a thin blade."""
    solid = _grid(resolution, 0.16, 0.26)
    split = rng.uniform(-0.2, 0.2)
    _handle(rng, solid, -0.5, split + 0.02, rng.uniform(0.025, 0.06))
    start, end = rng.uniform(0.02, 0.22), rng.uniform(0.015, 0.2)
    thick = rng.uniform(THIN, 0.02)
    lift = rng.uniform(0.0, 0.1) if rng.random() < 0.3 else 0.0
    shift = start - end if rng.random() < 0.4 else 0.0  # one straight edge

    def field(x: Array, y: Array, z: Array) -> Array:
        share = np.clip((x - split) / (0.5 - split), 0, 1)
        half = start + (end - start) * share
        side = half - np.abs(z - shift * share)
        return np.minimum(np.minimum(side, thick - np.abs(y - lift * share)), np.minimum(x - split, 0.5 - x))

    solid.add(field, (split, -0.15, -0.25), (0.5, 0.15, 0.25))
    return solid


def _pliers(rng: np.random.Generator, resolution: int) -> Solid:
    """Pliers, scissors, tongs: two bent arms that cross at a pin."""
    solid = _grid(resolution, 0.1, 0.3)
    pin = rng.uniform(0.0, 0.25)
    thick = rng.uniform(0.016, 0.035)
    spread, jaw = rng.uniform(0.06, 0.22), rng.uniform(0.02, 0.12)
    rings = rng.random() < 0.35
    for side in (-1, 1):
        arm = [(-0.5 + thick, 0, side * spread * rng.uniform(0.7, 1.0)), (-0.2, 0, side * spread), (pin, 0, 0)]
        arm += [(pin + 0.08, 0, -side * jaw), (0.47, 0, -side * jaw * 0.4)]
        solid.add(*tube(arm, [thick, thick, 1.2 * thick, thick, 0.016]))
        if rings:
            turns = np.linspace(0, 2 * np.pi, 13)
            radius = max(0.07, 2.6 * thick)
            x, z = -0.5 + thick + radius * (1 - np.cos(turns)), side * (spread + 0.02) + radius * np.sin(turns)
            solid.add(*tube([(a, 0, b) for a, b in zip(x, z, strict=True)], thick))
    solid.add(*cylinder((pin, 0, 0), 1, rng.uniform(1.5, 2.2) * thick, 1.2 * thick, 0.005))
    return solid


def _drill(rng: np.random.Generator, resolution: int) -> Solid:
    """Drills, glue guns, hair dryers: a barrel, a grip that hangs from it, perhaps a foot and a bit. Upright."""
    solid = Solid((-0.55, -0.75, -0.18), (0.6, 0.18, 0.18), resolution)
    radius = rng.uniform(0.06, 0.15)
    back, front = -rng.uniform(0.15, 0.35), rng.uniform(0.05, 0.25)
    if rng.random() < 0.7:
        solid.add(*cylinder(((back + front) / 2, 0, 0), 0, radius, (front - back) / 2, rng.uniform(0.0, 0.04)))
    else:
        half = ((front - back) / 2, radius, radius * rng.uniform(0.6, 1.0))
        solid.add(*box(((back + front) / 2, 0, 0), half, rng.uniform(0.0, 0.04)))
    nose = min(front + rng.uniform(0.05, 0.2), 0.45)
    solid.add(*capsule((front, 0, 0), (nose, 0, 0), radius * rng.uniform(0.5, 0.9), radius * rng.uniform(0.3, 0.6)))
    if rng.random() < 0.4:
        solid.add(*capsule((nose, 0, 0), (0.57, 0, 0), 0.02, 0.016))
    root = back + rng.uniform(0.0, 0.6) * (front - back)
    foot = np.array([root - rng.uniform(-0.05, 0.18), -rng.uniform(0.35, 0.6), 0])
    thick = rng.uniform(0.04, 0.08)
    solid.add(*capsule((root, 0, 0), foot, thick, thick * rng.uniform(0.8, 1.1)), blend=0.02)
    if rng.random() < 0.5:
        half = (rng.uniform(0.08, 0.16), rng.uniform(0.03, 0.09), rng.uniform(0.05, 0.12))
        solid.add(*box(foot, half, 0.015))
    if rng.random() < 0.6:
        solid.add(*capsule((root + thick, -radius, 0), (root + thick + 0.03, -radius - 0.1, 0), 0.025))
    return solid


def _clamp(rng: np.random.Generator, resolution: int) -> Solid:
    """Clamps, hooks, padlocks, handles: a bar bent into a C, a J or a ring, with a block or a screw."""
    solid = _grid(resolution, 0.56, 0.14)
    thick = rng.uniform(0.02, 0.07)
    a, b = 0.5 - thick, rng.uniform(0.15, 0.5) - thick
    opening = rng.uniform(0.0, 2.6) if rng.random() < 0.8 else 0.0
    turns = np.linspace(opening / 2, 2 * np.pi - opening / 2, 25)
    power = rng.uniform(0.4, 1.0)  # 1: an ellipse, less: squarer
    x, y = (np.sign(f(turns)) * np.abs(f(turns)) ** power for f in (np.cos, np.sin))
    solid.add(*tube([(a * u, b * v, 0) for u, v in zip(x, y, strict=True)], thick))
    if rng.random() < 0.4:
        side = -a if rng.random() < 0.5 else 0.0
        half = (rng.uniform(0.06, 0.2), rng.uniform(0.06, 0.15), 0.12)
        solid.add(*box((side, -b if side == 0 else 0, 0), half, 0.02))
    if opening and rng.random() < 0.4:
        at = (a * x[0], b * y[0], 0)
        solid.add(*cylinder(at, 1, thick * 1.5, 0.08, 0.01))
    return solid
