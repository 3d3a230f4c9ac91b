"""Procedural cups, mugs and vases: open vessels with walls of 2 to 7 % of their size, and filled ones of these kinds.

Both are needed: where a network has seen many hollow vessels and few filled ones, it takes filled bottles for hollow.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from touchnet.data.shapes.fields import Array, Field, Solid, curve, cylinder, smooth_min, superellipse
from touchnet.data.shapes.handles import add_handle

# Two cells of a grid of 128.
THINNEST = 0.018

Profile = Callable[[Array], Array]


def cup(rng: np.random.Generator, resolution: int) -> Solid:
    """Tumblers, goblets and glasses with a stem, lidded beakers. Height 1, the mouth up."""
    kind = rng.choice(["tumbler", "goblet", "beaker"], p=[0.45, 0.35, 0.2])
    section = _section(rng)
    if kind == "goblet":
        return _goblet(rng, resolution, section)
    rim = rng.uniform(0.25, 0.5)
    wall = rng.uniform(THINNEST, 0.06)
    profile = curve(_side(rng, 1.0, rim * rng.uniform(0.6, 1.0), rim))
    solid = _body(profile, 1.0, section, resolution)
    base = rng.uniform(0.0, 0.1) if rng.random() < 0.3 else 0.0  # a hollow under the bottom
    if base:
        _cut(solid, profile, -0.1, base, wall, section)
    if kind == "tumbler":
        floor = rng.uniform(1.0, 4.0 if rng.random() < 0.3 else 1.6)
        _cut(solid, profile, base, 1.2, wall, section, floor=floor, heel=rng.uniform(0.0, 0.1))
    else:
        high, wide = rng.uniform(0.03, 0.12), rim * rng.uniform(1.0, 1.12)
        solid.add(*cylinder((0, 1 - high / 2, 0), 1, wide, high / 2, rng.uniform(0.002, 0.02)))
    return solid


def mug(rng: np.random.Generator, resolution: int) -> Solid:
    """A mug with a handle, or a teacup, some on a saucer. Height 1 at most, the mouth up."""
    section = _section(rng)
    tall = rng.uniform(0.55, 1.0)
    rim = rng.uniform(0.36, 0.48)
    saucer = rng.random() < 0.15
    wall = rng.uniform(1.8 if saucer else 1.4, 3.5) * THINNEST
    profile = curve(_side(rng, tall, rim * rng.uniform(0.5 if saucer else 0.75, 1.0), rim))
    aside = rim * 1.15 + rng.uniform(0.15, 0.35)
    solid = _body(profile, tall, section, resolution, aside=aside, all_round=0.85 if saucer else 0.0)
    high, low = tall * rng.uniform(0.72, 0.93), tall * rng.uniform(0.12, 0.4)
    add_handle(rng, solid, profile, high, low, aside, two=0.0)
    if saucer:
        plate = rng.uniform(0.6, 0.84)
        rise, thick = rng.uniform(0.03, 0.12), rng.uniform(THINNEST, 0.03)  # half as thick as it is

        def dish(x: Array, y: Array, z: Array) -> Array:
            out = np.sqrt(x * x + z * z)
            height = rise * np.clip(out / plate, 0, 1) ** 2
            return np.minimum(thick - np.abs(y - height), plate - out)

        solid.add(dish, (-plate, -thick, -plate), (plate, rise + thick, plate))
    if rng.random() < 0.85:
        floor = rng.uniform(1.0, 2.5)
        _cut(solid, profile, 0.0, tall + 0.2, wall, section, floor=floor, heel=rng.uniform(0.0, 0.1))
    return solid


def vase(rng: np.random.Generator, resolution: int) -> Solid:
    """Vases, urns, pots and jars, with a foot or without, some with two handles, some shut. Height 1, the mouth up."""
    section = _section(rng)
    pot = rng.random() < 0.25
    belly = rng.uniform(0.16, 0.5)
    wall = rng.uniform(THINNEST, 0.05)
    if pot:
        knots = _side(rng, 1.0, belly * rng.uniform(0.5, 0.9), belly)
    else:
        at = rng.uniform(0.25, 0.75)
        neck_at = rng.uniform(at + 0.1, 0.93)
        neck = belly * rng.uniform(0.3, 0.85)
        knots = [
            (0.0, belly * rng.uniform(0.35, 0.8)),
            (at, belly),
            (neck_at, neck),
            (1.0, neck * rng.uniform(1.0, 1.5)),
        ]
    foot = rng.uniform(0.05, 0.25) if rng.random() < 0.3 else 0.0
    if foot:
        waist = knots[0][1] * rng.uniform(0.4, 0.8)
        knots = [(0.0, knots[0][1] * rng.uniform(0.8, 1.2)), (foot * 0.6, waist)] + [
            (foot + y * (1 - foot), r) for y, r in knots
        ]
    profile = curve([(y, max(r, 0.06)) for y, r in knots])
    handles = not pot and rng.random() < 0.25
    beside = max(r for _, r in knots) * 1.05 + 0.25 if handles else 0.0
    solid = _body(profile, 1.0, section, resolution, all_round=beside)
    if handles:
        add_handle(rng, solid, profile, rng.uniform(0.8, 0.95), rng.uniform(0.4, 0.65), beside, two=0.8)
    narrow = not pot and neck < 0.6 * belly
    if rng.random() < (0.35 if narrow else 0.65):
        floor = rng.uniform(1.0, 2.5)
        _cut(solid, profile, foot, 1.2, wall, section, floor=floor, heel=rng.uniform(0.0, 0.15))
        return solid
    top = rng.random()
    if top < 0.25:  # an opening that does not lead far
        _cut(solid, profile, 1 - rng.uniform(0.04, 0.2), 1.2, wall, section)
    elif top < 0.6:  # a lid
        mouth = float(profile(np.float32(1.0)))
        high = rng.uniform(0.03, 0.12)
        solid.add(*cylinder((0, 1 - high / 2, 0), 1, mouth * rng.uniform(1.0, 1.25), high / 2, 0.01))
    return solid


class _Section(NamedTuple):
    """What a horizontal cut looks like: a superellipse of this power, `flat` times as deep as wide, with flutes."""

    power: float
    flat: float
    flutes: int
    depth: float


def _section(rng: np.random.Generator) -> _Section:
    round_ = rng.random() < 0.75
    return _Section(
        2.0 if round_ else rng.uniform(2.5, 7),
        1.0 if rng.random() < 0.85 else rng.uniform(0.65, 0.95),
        int(rng.integers(6, 20)) if rng.random() < 0.1 else 0,
        rng.uniform(0.02, 0.06),
    )


def _side(rng: np.random.Generator, high: float, bottom: float, top: float) -> list[tuple[float, float]]:
    """Knots (y, radius) of a wall from bottom to top: straight, rounded below, waisted, bulging, or with a lip."""
    at = high * rng.uniform(0.3, 0.7)
    between = bottom + (top - bottom) * at / high
    style = rng.choice(["straight", "round", "waist", "bulge", "lip"], p=[0.4, 0.2, 0.12, 0.13, 0.15])
    if style == "round":
        return [(0.0, bottom * rng.uniform(0.5, 0.8)), (0.25 * high, between), (high, top)]
    if style == "waist":
        return [(0.0, bottom), (at, between * rng.uniform(0.8, 0.95)), (high, top)]
    if style == "bulge":
        return [(0.0, bottom), (at, between * rng.uniform(1.05, 1.2)), (high, top)]
    if style == "lip":
        return [(0.0, bottom), (high - 0.08 * high, top * rng.uniform(0.85, 0.95)), (high, top)]
    # Knots on a straight line: the curve through them is the line.
    return [(0.0, bottom), (at, between), (high, top)]


def _goblet(rng: np.random.Generator, resolution: int, section: _Section) -> Solid:
    """A bowl on a stem on a foot."""
    stem_end = rng.uniform(0.2, 0.55)
    rim, wall = rng.uniform(0.18, 0.42), rng.uniform(THINNEST, 0.05)
    stem = rng.uniform(0.022, 0.05 if rng.random() < 0.6 else 0.12)
    foot = max(rim * rng.uniform(0.6, 1.05), 0.12)
    shape = rng.choice(["cone", "tulip", "bowl", "straight"])
    high = 1 - stem_end
    bowl = {
        "cone": [(0.0, stem), (0.5, (stem + rim) / 2), (1.0, rim)],
        "tulip": [(0.0, stem), (0.15, 0.8 * rim), (0.4, rim * rng.uniform(1.0, 1.25)), (1.0, rim)],
        "bowl": [(0.0, stem), (0.12, 0.6 * rim), (0.4, 0.9 * rim), (1.0, rim)],
        "straight": [(0.0, stem), (0.06, 0.85 * rim), (0.5, 0.92 * rim), (1.0, rim)],
    }[shape]
    knots = [
        (0.0, foot),
        (rng.uniform(0.02, 0.04), foot * rng.uniform(0.9, 1.0)),
        (rng.uniform(0.06, 0.14), stem * rng.uniform(1.0, 1.8)),
    ]
    if rng.random() < 0.3:  # a knob
        at = rng.uniform(0.4, 0.7) * stem_end
        knots += [(max(at - 0.05, 0.145), stem), (at + 0.02, stem * rng.uniform(1.3, 2.2)), (at + 0.07, stem)]
    knots += [(stem_end + share * high, radius) for share, radius in bowl]
    profile = curve(knots)
    solid = _body(profile, 1.0, section, resolution)
    if rng.random() < 0.85:
        under = 0.07 * high if shape == "straight" else 0.0  # what its bottom rises from the stem to the wall
        _cut(solid, profile, stem_end + under, 1.2, wall, section, floor=rng.uniform(1.0, 3.0))
    return solid


def _body(
    profile: Profile, high: float, section: _Section, resolution: int, *, aside: float = 0.0, all_round: float = 0.0
) -> Solid:
    """The filled vessel, on a grid with room for what is added: a handle up to x = `aside`, others to `all_round`."""
    reach = _reach(profile, high)
    wide = max(reach, all_round) + 0.02
    solid = Solid((-wide, -0.04, -wide), (max(wide, aside), high + 0.04, wide), resolution)
    solid.add(_turned(profile, 0.0, high, 0.0, section, 0.0), (-reach, 0.0, -reach), (reach, high, reach))
    return solid


def _cut(
    solid: Solid,
    profile: Profile,
    low: float,
    high: float,
    wall: float,
    section: _Section,
    *,
    floor: float = 0.0,
    heel: float = 0.0,
) -> None:
    """Takes out what lies `wall` inside the profile, from `floor` walls above `low` up; `heel` rounds the edge there.
    Walls are thicker on coarse grids, so that no hole opens."""
    reach, wall = _reach(profile, high), max(wall, 1.6 * solid.spacing)
    low += floor * wall
    solid.cut(_turned(profile, low, high, wall, section, heel), (-reach, low, -reach), (reach, high, reach))


def _reach(profile: Profile, high: float) -> float:
    return float(profile(np.linspace(0.0, high, 200)).max()) * 1.02


def _turned(profile: Profile, low: float, high: float, wall: float, section: _Section, heel: float) -> Field:
    """The profile turned about the y axis between two heights, smaller by `wall` measured across the wall."""

    def field(x: Array, y: Array, z: Array) -> Array:
        r = profile(y)
        if section.flutes:
            r = r * (1 - section.depth * (0.5 + 0.5 * np.cos(section.flutes * np.arctan2(z, x))))
        slope = (profile(y + 0.005) - profile(y - 0.005)) / 0.01
        inset = wall * np.sqrt(1 + np.minimum(slope * slope, 64))
        a, b = r - inset, r * section.flat - inset
        side = np.where(b > 0, superellipse(x, z, a, b, section.power), b)
        return np.minimum(smooth_min(side, y - low, heel), high - y)

    return field
