"""Procedural machine parts: plates, brackets, turned parts, gears, pipes, housings and links of robots."""

import itertools

import numpy as np

from touchnet.data.shapes.fields import (
    Array,
    Field,
    Solid,
    Vector,
    ball,
    box,
    capsule,
    cylinder,
    polyline,
    smooth_min,
    superellipse,
    tube,
)

# Half of the thinnest wall, about a cell of a grid of 128.
THIN = 0.011


def part(rng: np.random.Generator, resolution: int) -> Solid:
    """A plate, bracket, turned part, gear, pipe, housing or link; about 1 in its longest direction, y its axis."""
    makers = {
        "plate": _plate,
        "bracket": _bracket,
        "turned": _turned,
        "gear": _gear,
        "pipe": _pipe,
        "housing": _housing,
        "link": _link,
    }
    return makers[rng.choice(list(makers), p=[0.12, 0.13, 0.15, 0.08, 0.14, 0.18, 0.2])](rng, resolution)


def _plate(rng: np.random.Generator, resolution: int) -> Solid:
    """A flat outline with holes, bosses and ribs."""
    thick = rng.uniform(THIN, 0.1)
    wide, deep = 0.48, rng.uniform(0.15, 0.48)
    high = rng.uniform(0.05, 0.25)
    solid = Solid((-0.5, -thick - 0.02, -0.5), (0.5, thick + 2 * high + 0.02, 0.5), resolution)
    style = rng.choice(["box", "disc", "lugs"])
    if style == "box":
        solid.add(*box((0, 0, 0), (wide, thick, deep), rng.uniform(0.0, thick)))
    elif style == "disc":
        power = rng.uniform(2.0, 4.0)

        def disc(x: Array, y: Array, z: Array) -> Array:
            return np.minimum(superellipse(x, z, wide, deep, power), thick - np.abs(y))

        solid.add(disc, (-wide, -thick, -deep), (wide, thick, deep))
    else:
        solid.add(*box((0, 0, 0), (wide * 0.75, thick, deep * 0.6)))
        for _ in range(int(rng.integers(1, 5))):
            lug = rng.uniform(0.06, 0.16)
            at = rng.uniform(-1, 1, size=2) * [wide - lug, min(deep, 0.48 - lug)]
            solid.add(*capsule((0, 0, 0), (at[0], 0, at[1]), thick))
            solid.add(*cylinder((at[0], 0, at[1]), 1, lug, thick))
    for _ in range(int(rng.integers(0, 4))):
        x, z = rng.uniform(-0.7, 0.7, size=2) * [wide, deep]
        if rng.random() < 0.5:
            solid.add(*cylinder((x, high, z), 1, rng.uniform(0.04, 0.13), high, 0.01))
        else:
            half = rng.uniform([0.05, 0, 0.015], [0.3, 0, 0.05]) + np.array([0, high, 0])
            solid.add(*box((x, high, z), half if rng.random() < 0.5 else half[[2, 1, 0]]))
    for _ in range(int(rng.integers(0, 6))):
        x, z = rng.uniform(-0.8, 0.8, size=2) * [wide, deep]
        solid.cut(*cylinder((x, 0, z), 1, rng.uniform(0.025, 0.12), 1.0))
    return solid


def _bracket(rng: np.random.Generator, resolution: int) -> Solid:
    """Two or three plates at right angles, with gussets and holes."""
    thick, wide = rng.uniform(THIN, 0.06), rng.uniform(0.1, 0.4)
    long, high = 0.48, rng.uniform(0.2, 0.9)
    solid = Solid((-0.5, -0.02, -wide - 0.02), (0.5, high + 0.02, wide + 0.02), resolution)
    solid.add(*box((0, thick, 0), (long, thick, wide)))
    walls = [-long + thick] if rng.random() < 0.5 else [-long + thick, long - thick]
    if rng.random() < 0.2:
        walls = [0.0]
    for x in walls:
        solid.add(*box((x, high / 2, 0), (thick, high / 2, wide * rng.uniform(0.7, 1.0))))
        if rng.random() < 0.5:
            leg, rib = rng.uniform(0.1, 0.9) * min(high, long), max(THIN, 0.6 * thick)
            solid.add(*_gusset(x, 1.0 if x <= 0 else -1.0, leg, rib))
        for _ in range(int(rng.integers(0, 3))):
            y, z = high * rng.uniform(0.3, 0.85), wide * rng.uniform(-0.6, 0.6)
            solid.cut(*cylinder((x, y, z), 0, rng.uniform(0.03, 0.5 * wide), 2 * thick + 0.02))
    for _ in range(int(rng.integers(0, 4))):
        x, z = rng.uniform(-0.6, 0.6, size=2) * [long, wide]
        solid.cut(*cylinder((x, 0, z), 1, rng.uniform(0.025, 0.08), 3 * thick))
    return solid


def _gusset(at: float, sign: float, leg: float, rib: float) -> tuple[Field, Vector, Vector]:
    """A triangle between the base and a wall at x = `at`, on the side of `sign`, `rib` thick both ways."""

    def field(x: Array, y: Array, z: Array) -> Array:
        out = sign * (x - np.float32(at))
        return np.minimum(np.minimum(leg - out - y, rib - np.abs(z)), np.minimum(out, y))

    return field, (-0.5, 0, -rib), (0.5, leg, rib)


def _turned(rng: np.random.Generator, resolution: int) -> Solid:
    """Shafts, flanges, pulleys, bushings, nozzles: steps of radius along y, most with a bore, some with bolt holes."""
    steps = int(rng.integers(1, 6))
    slender = rng.uniform(0.15, 1.0)
    edges = np.sort(np.concatenate([[0, 1], rng.random(steps - 1)]))
    edges *= 1.0 if slender < 0.5 else rng.uniform(0.15, 1.0)
    radii = slender * rng.uniform(0.15, 0.5, size=steps)
    radii[rng.integers(steps)] = 0.5 * slender
    radii = np.maximum(radii, 0.04)
    ends = radii * np.where(rng.random(steps) < 0.6, 1.0, rng.uniform(0.6, 1.2, size=steps))
    knots = []
    for (low, high), start, end in zip(itertools.pairwise(edges), radii, ends, strict=True):
        knots += [(low + 1e-3, start), (high - 1e-3, end)]
    profile = polyline(knots)
    thinnest, widest = min(radii.min(), ends.min()), max(radii.max(), ends.max())
    high = float(edges[-1])
    bore = min(thinnest - 0.025, thinnest * rng.uniform(0.3, 0.85)) if rng.random() < 0.6 else 0.0
    floor = high * rng.uniform(0.1, 0.7) if rng.random() < 0.4 else -0.1
    rounding = rng.uniform(0.0, 0.02)
    solid = Solid((-widest - 0.02, -0.02, -widest - 0.02), (widest + 0.02, high + 0.02, widest + 0.02), resolution)

    def outside(x: Array, y: Array, z: Array) -> Array:
        across = profile(y) - np.sqrt(x * x + z * z)
        return smooth_min(across, high / 2 - np.abs(y - high / 2), rounding)

    solid.add(outside, (-widest, 0, -widest), (widest, high, widest))
    if bore > 0.02:
        solid.cut(*cylinder((0, floor + 2, 0), 1, bore, 2.0))
        if floor > 0 and rng.random() < 0.5 and thinnest - 0.03 > 0.04:
            solid.cut(*cylinder((0, floor - 2 - 0.05, 0), 1, rng.uniform(0.03, thinnest - 0.025), 2.0))
    if rng.random() < 0.35:
        _bolt_circle(rng, solid, max(bore, 0.0), widest)
    return solid


def _bolt_circle(rng: np.random.Generator, solid: Solid, inner: float, outer: float) -> None:
    if outer - inner < 0.12:
        return
    middle, count = (inner + outer) / 2, int(rng.integers(3, 9))
    hole = min(rng.uniform(0.025, 0.3 * (outer - inner)), 0.8 * np.pi * middle / count)
    for turn in 2 * np.pi * np.arange(count) / count:
        solid.cut(*cylinder((middle * np.cos(turn), 0, middle * np.sin(turn)), 1, hole, 2.0))


def _gear(rng: np.random.Generator, resolution: int) -> Solid:
    """Gears, knobs, wheels with spokes: teeth around, a hub, a bore."""
    thick, teeth = rng.uniform(0.03, 0.3), int(rng.integers(6, 26))
    depth, sharp = rng.uniform(0.02, 0.1), rng.uniform(1.0, 4.0)
    solid = Solid((-0.5, -0.35, -0.5), (0.5, 0.35, 0.5), resolution)

    def wheel(x: Array, y: Array, z: Array) -> Array:
        wave = np.clip(sharp * np.sin(teeth * np.arctan2(z, x)), -1, 1)
        return np.minimum(0.48 - depth * (0.5 - 0.5 * wave) - np.sqrt(x * x + z * z), thick - np.abs(y))

    solid.add(wheel, (-0.48, -thick, -0.48), (0.48, thick, 0.48))
    hub, bore = rng.uniform(0.1, 0.2), rng.uniform(0.03, 0.09)
    if rng.random() < 0.5:  # thinner between rim and hub, or holes there
        if rng.random() < 0.5:
            web = thick * rng.uniform(0.3, 0.8)

            def groove(x: Array, y: Array, z: Array) -> Array:
                r = np.sqrt(x * x + z * z)
                return np.minimum(np.minimum(0.37 - r, r - hub), np.abs(y) - max(web, THIN))

            solid.cut(groove, (-0.38, -0.35, -0.38), (0.38, 0.35, 0.38))
        else:
            _bolt_circle(rng, solid, hub, 0.4)
    if rng.random() < 0.6:
        solid.add(*cylinder((0, 0, 0), 1, hub, min(thick + rng.uniform(0.0, 0.2), 0.33), 0.005))
    if rng.random() < 0.75:
        solid.cut(*cylinder((0, 0, 0), 1, bore, 1.0))
    return solid


def _pipe(rng: np.random.Generator, resolution: int) -> Solid:
    """Straight pipes, elbows, bends and tees, open at their ends or solid, some with collars."""
    radius = rng.uniform(0.05, 0.2)
    wall = rng.uniform(0.02, max(0.025, min(0.06, 0.5 * radius)))
    hollow = rng.random() < 0.7 and radius - wall > 0.02
    style = rng.choice(["straight", "elbow", "bend", "tee"])
    if style == "bend":
        turn, arc = rng.uniform(1.0, 4.0), rng.uniform(0.25, 0.5)
        steps = np.linspace(0, turn, 13)
        paths = [np.stack([arc * np.cos(steps), arc * np.sin(steps), np.zeros(13)], axis=1)]
    else:
        ends = {"straight": [(-0.5, 0, 0), (0.5, 0, 0)], "elbow": [(0.6, 0, 0), (0, 0.5, 0)]}.get(
            style, [(-0.5, 0, 0), (0.5, 0, 0), (0, 0.5, 0)]
        )
        paths = [np.array([(0, 0, 0), end]) * rng.uniform(0.6, 1.0) for end in ends]
    low = np.min([path.min(0) for path in paths], axis=0) - radius * 1.4
    high = np.max([path.max(0) for path in paths], axis=0) + radius * 1.4
    solid = Solid(low - 0.02, high + 0.02, resolution)
    cuts: list[tuple[np.ndarray, np.ndarray]] = []
    for path in paths:
        solid.add(*tube(path, radius))
        last = [(path[-1], path[-1] - path[-2])] + ([(path[0], path[0] - path[1])] if style == "bend" else [])
        cuts += last
        if rng.random() < 0.4:
            end, along = last[0]
            back = end - along / np.linalg.norm(along) * min(rng.uniform(0.02, 0.08), np.linalg.norm(along))
            solid.add(*capsule(back, end, radius * rng.uniform(1.1, 1.35)))
    for end, along in cuts:  # flat ends
        solid.cut(*_beyond(end, along, 2.0 * radius))
    if hollow:
        for path in paths:
            solid.cut(*tube(path, radius - wall))
    return solid


def _beyond(end: np.ndarray, along: np.ndarray, reach: float) -> tuple[Field, np.ndarray, np.ndarray]:
    """What lies beyond `end` in the direction `along`, within `reach` of it."""
    out = (along / np.linalg.norm(along)).astype(np.float32)
    centre = end.astype(np.float32)

    def field(x: Array, y: Array, z: Array) -> Array:
        dx, dy, dz = x - centre[0], y - centre[1], z - centre[2]
        return np.minimum(
            dx * out[0] + dy * out[1] + dz * out[2], np.float32(reach) - np.sqrt(dx * dx + dy * dy + dz * dz)
        )

    return field, end - reach, end + reach


def _housing(rng: np.random.Generator, resolution: int) -> Solid:
    """Boxes, crates, cases, covers: a rounded box or cylinder, filled, or hollow and open on a side or by windows."""
    wide, high, deep = 0.48, rng.uniform(0.1, 0.48), rng.uniform(0.2, 0.48)
    wall = rng.uniform(2 * THIN, 0.07)
    rounding = rng.uniform(0.0, 0.12)
    is_round = rng.random() < 0.25
    solid = Solid((-0.5, -high - 0.1, -0.5), (0.5, high + 0.1, 0.5), resolution)

    def shell(inset: float, *, up: float = 0.0) -> tuple[Field, Vector, Vector]:
        half = (wide - inset, high - inset + up / 2, deep - inset)
        if is_round:
            return cylinder((0, up / 2, 0), 1, deep - inset, half[1], rounding)
        return box((0, up / 2, 0), half, rounding)

    solid.add(*shell(0.0))
    if rng.random() < 0.35:  # lugs or a rim
        rim = rng.uniform(0.02, 0.05)
        reach = (min(wide, deep) if is_round else wide) * 0.99
        half = (min(reach + 0.02, 0.49), rim, min(deep * 1.1, 0.49))
        solid.add(*box((0, rng.choice([-1, 1]) * (high - rim), 0), half, 0.005))
    if rng.random() < 0.6:
        opening = rng.choice(["top", "windows", "hole"], p=[0.6, 0.2, 0.2])
        solid.cut(*shell(wall, up=0.6 if opening == "top" else 0.0))
        if opening == "windows":
            for _ in range(int(rng.integers(1, 4))):
                half = rng.uniform(0.08, 0.3, size=2)
                axis = rng.integers(3)
                size = np.insert(half, axis, 0.3)
                centre = np.zeros(3)
                centre[axis] = rng.choice([-1, 1]) * 0.45
                solid.cut(*box(centre, size, 0.02))
        elif opening == "hole":
            solid.cut(*cylinder((0, high, 0), 1, rng.uniform(0.3, 0.8) * deep, high, 0.0))
        for x, z in itertools.product((-1, 1), repeat=2):
            if rng.random() < 0.2:  # a post for a screw
                solid.add(*cylinder((x * 0.6 * deep, -0.2 * high, z * 0.6 * deep), 1, 0.04, 0.8 * high))
    for _ in range(int(rng.integers(0, 3))):
        axis = int(rng.integers(3))
        centre = rng.uniform(-0.6, 0.6, size=3) * [wide, high, deep]
        centre[axis] = rng.choice([-1, 1]) * (wide, high, deep)[axis] * 0.95
        solid.add(*cylinder(centre, axis, rng.uniform(0.03, 0.12), 0.06, 0.01))
    return solid


def _link(rng: np.random.Generator, resolution: int) -> Solid:
    """Links of robots: drums on axes of their own, joined by an arm, with caps, bores and covers."""
    count = int(rng.integers(2, 4))
    centres, axes, radii, halves = [np.zeros(3)], [], [], []
    for n in range(count):
        axes.append(int(rng.integers(3)))
        radii.append(rng.uniform(0.08, 0.22))
        halves.append(rng.uniform(0.06, 0.25))
        if n:
            step = np.zeros(3)
            step[rng.integers(3)] = rng.choice([-1, 1]) * rng.uniform(0.2, 0.6)
            step[rng.integers(3)] += rng.uniform(-0.15, 0.15)
            centres.append(centres[-1] + step)
    margin = 0.32
    solid = Solid(np.min(centres, axis=0) - margin, np.max(centres, axis=0) + margin, resolution)
    blend = rng.uniform(0.0, 0.08)
    for (a, b), (r, s) in zip(itertools.pairwise(centres), itertools.pairwise(radii), strict=True):
        arm = rng.uniform(0.35, 0.95)
        solid.add(*capsule(a, b, arm * r, arm * s))
    for centre, axis, radius, half in zip(centres, axes, radii, halves, strict=True):
        if rng.random() < 0.2:
            solid.add(*ball(centre, (radius * 1.1,) * 3), blend=blend)
            continue
        solid.add(*cylinder(centre, axis, radius, half, rng.uniform(0.0, 0.03)), blend=blend)
        if rng.random() < 0.4:
            solid.add(*cylinder(centre, axis, radius * rng.uniform(0.5, 0.9), half + 0.03, 0.005))
        if rng.random() < 0.25:
            solid.cut(*cylinder(centre, axis, radius * rng.uniform(0.3, 0.7), 1.0 if rng.random() < 0.5 else half))
    return solid
