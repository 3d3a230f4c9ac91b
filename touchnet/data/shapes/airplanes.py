"""Procedural airplanes: gliders to airliners and jets."""

import numpy as np
from numpy.typing import NDArray

from touchnet.data.shapes.fields import Array, Field, Solid, Vector, box, capsule, curve, cylinder, superellipse


def airplane(rng: np.random.Generator, resolution: int) -> Solid:
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
    solid = Solid((-0.62, -0.3, -span - 0.05), (0.6, high, span + 0.05), resolution)

    # The fuselage, from the tail at x = -0.5 to the nose at 0.5.
    nose, tail = uniform(0.08, 0.22), uniform(0.25, 0.45)
    tip = {"fighter": 0.1, "airliner": 0.25}.get(kind, uniform(0.15, 0.5))
    radius = curve(
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
    spine = curve([(-0.5, rise), (-0.5 + tail, 0), (0.5 - nose, 0), (0.5, -drop)])
    tall, squarish = uniform(0.95, 1.35), uniform(1.9, 2.8)
    if kind == "wing":
        tail, nose = 0.3, 0.2

    def fuselage(x: Array, y: Array, z: Array) -> Array:
        r = radius(x)
        return np.minimum(superellipse(z, y - spine(x), r, r * tall, squarish), 0.5 - np.abs(x))

    if kind == "wing":
        pod = capsule((uniform(-0.2, 0), 0, 0), (uniform(0.15, 0.3), 0, 0), slim, slim * 0.6)
        solid.add(*pod)
    elif kind == "twinboom":
        solid.add(*capsule((-0.1, 0, 0), (0.35, 0, 0), slim * 1.1, slim * 0.8))
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
                    solid.add(*capsule(low_end * flip, high_end * flip, thin * 0.75))
    elif kind == "light" and up > 0.5 and rng.random() < 0.7:  # struts of a high wing
        for side in (1, -1):
            flip = np.array([1, 1, side])
            solid.add(
                *capsule(np.array([place, -slim * 0.6, slim * 0.5]) * flip, wing.at(0.5 * span, 0.4) * flip, thin * 0.7)
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
                solid.add(*capsule((x, start - slim * 0.3, side * z * 0.4), (x, ground + wheel, side * z), thin * 0.75))
                solid.add(*cylinder((x, ground + wheel, side * z), 2, wheel, thin, 0.004))
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
    rng: np.random.Generator, solid: Solid, kind: str, slim: float, tall: float, rise: float, thin: float, span: float
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
            solid.add(*capsule((0.1, 0, side * out), (-0.5, 0.01, side * out), 0.022, thin))
            solid.add(*_fin(np.array([-0.4, 0.0, side * out]), 0.1, 0.7, uniform(0.07, 0.13), 0.3, thin))
        solid.add(*box((-0.46, uniform(0.01, 0.06), 0), (0.04, thin, out + 0.01), 0.004))
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
    solid: Solid,
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
                    *capsule(
                        centre + np.array([0, size * 0.6, 0]) * np.sign(-below), mount * np.array([1, 1, side]), thin
                    )
                )
    elif kind == "bizjet":
        size, long = slim * uniform(0.45, 0.6), uniform(0.05, 0.07)
        x, y = uniform(-0.32, -0.25), slim * uniform(0.2, 0.6)
        for side in (1, -1):
            centre = np.array([x, y, side * slim * uniform(1.5, 1.7)])
            _nacelle(solid, centre, size, long, rng.random() < 0.5)
            solid.add(*capsule((x, y * 0.8, 0), centre, thin * 1.3))
    elif kind == "turboprop" or (kind == "light" and rng.random() < 0.25):
        stations = [uniform(0.25, 0.36)] if rng.random() < 0.7 else [uniform(0.22, 0.3), uniform(0.45, 0.55)]
        for station in stations:
            mount = wing.at(station * span, 0.3)
            ahead = wing.at(station * span, 0.0)[0] + uniform(0.04, 0.09)
            for side in (1, -1):
                z = side * station * span
                solid.add(*capsule((mount[0], mount[1], z), (ahead, mount[1], z), slim * 0.38, slim * 0.3))
                _propeller(rng, solid, (ahead + slim * 0.3, mount[1], z), uniform(0.06, 0.1), thin)
    elif kind in ("light", "biplane"):
        _propeller(rng, solid, (0.505, -slim * 0.15, 0), uniform(0.08, 0.13), thin)
        solid.add(*capsule((0.46, -slim * 0.15, 0), (0.52, -slim * 0.15, 0), slim * 0.35, slim * 0.1))
    elif kind == "fighter":
        if rng.random() < 0.5:
            for side in (1, -1):
                out = side * slim * uniform(0.9, 1.25)
                solid.add(*box((-0.1, -slim * 0.1, out), (uniform(0.2, 0.32), slim * 0.5, slim * 0.45), slim * 0.25))
        if rng.random() < 0.5:
            for side in (1, -1):
                under = wing.at(span * uniform(0.4, 0.7), 0.4) * np.array([1, 1, side]) - np.array([0, thin * 2.2, 0])
                half = np.array([uniform(0.04, 0.08), 0, 0])
                solid.add(*capsule(under - half, under + half, thin * 1.3, thin * 0.9))
    elif kind == "twinboom":
        _propeller(rng, solid, (0.35 + slim * 0.8, 0, 0), uniform(0.07, 0.1), thin)


def _nacelle(solid: Solid, centre: NDArray[np.float64], size: float, long: float, hollow: bool) -> None:
    def barrel(x: Array, y: Array, z: Array) -> Array:
        along = (x - centre[0]) / long
        r = size * (1 - 0.28 * np.clip(-along, 0, 1) ** 2 - 0.12 * np.clip(along, 0, 1) ** 2)
        ring = r - np.sqrt((y - centre[1]) ** 2 + (z - centre[2]) ** 2)
        return np.minimum(ring, (1 - np.abs(along)) * long)

    reach = np.array([long, size, size])
    solid.add(barrel, centre - reach, centre + reach)
    if hollow:
        mouth = centre + np.array([long, 0, 0])
        solid.cut(*cylinder(mouth, 0, size * 0.6, long * 0.5))


def _propeller(rng: np.random.Generator, solid: Solid, hub: Vector, radius: float, thin: float) -> None:
    hub = np.asarray(hub, dtype=np.float64)
    if rng.random() < 0.3:
        solid.add(*cylinder(hub, 0, radius, thin * 0.8))
        return
    blades = int(rng.integers(2, 6))
    start = rng.uniform(0, 2 * np.pi)
    solid.add(*capsule(hub - np.array([0.02, 0, 0]), hub + np.array([0.01, 0, 0]), thin * 1.3, thin))
    for k in range(blades):
        turn = start + 2 * np.pi * k / blades
        end = hub + radius * np.array([0, np.cos(turn), np.sin(turn)])
        solid.add(*capsule(hub, end, thin * 0.9, thin * 0.75))
