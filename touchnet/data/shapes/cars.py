"""Procedural cars, vans, pickups and racing cars."""

import functools

import numpy as np

from touchnet.data.shapes.fields import Array, Field, Solid, box, capsule, curve, cylinder, polyline, smooth_min, tube


def car(rng: np.random.Generator, resolution: int) -> Solid:
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
    roof = curve(top) if smooth else polyline(top)
    belly = polyline(
        [(-0.5, clear * uniform(1.2, 1.8)), (-0.4, clear), (0.42, clear), (0.5, clear * uniform(1.0, 1.5))]
    )
    plan = curve([(-0.5, wide * uniform(0.82, 0.95)), (-0.3, wide), (0.25, wide), (0.5, wide * uniform(0.72, 0.92))])
    belt = min(hood_y, boot_y)
    lean = uniform(0.2, 0.5) if kind != "van" else uniform(0.05, 0.2)
    edge = uniform(0.012, 0.045)
    side_bulge = uniform(0, 0.03)

    margin = 0.06
    solid = Solid((-0.58, -0.01, -wide - margin), (0.56, high + 0.1, wide + margin), resolution)

    def shell(x: Array, y: Array, z: Array) -> Array:
        # The sides lean inwards above the belt line and bulge a little below it.
        half = plan(x) - lean * np.maximum(y - belt, 0) - side_bulge * ((y - belt * 0.6) / high) ** 2
        upright = smooth_min(roof(x) - y, y - belly(x), edge)
        flank = half - np.abs(z)
        return smooth_min(smooth_min(upright, flank, edge), 0.5 - np.abs(x), edge)

    solid.add(shell, (-0.5, 0, -wide), (0.5, high + 0.02, wide))

    front, rear = uniform(0.29, 0.34), uniform(-0.34, -0.27)
    tread = wheel * uniform(0.32, 0.5)
    arch = wheel * uniform(1.08, 1.25)
    for x in (front, rear):
        for side in (1, -1):
            out = side * (float(plan(np.float32(x))) - tread)
            solid.cut(*cylinder((x, wheel, out + side * tread), 2, arch, tread * 2.4))
    for x in (front, rear):
        for side in (1, -1):
            out = side * (float(plan(np.float32(x))) - tread * uniform(0.9, 1.05))
            solid.add(*cylinder((x, wheel, out), 2, wheel, tread, wheel * 0.15))
            rim = wheel * uniform(0.5, 0.65)
            if rng.random() < 0.5:  # the rim lies deeper than the tyre
                solid.cut(*cylinder((x, wheel, out + side * tread), 2, rim, tread * 0.4))
        solid.add(*cylinder((x, wheel, 0), 2, wheel * 0.3, wide * 0.95))

    if kind == "pickup":
        back = top[5][0]
        wall, floor = 0.02, clear + (boot_y - clear) * uniform(0.3, 0.5)
        centre = ((back - 0.5) / 2 - 0.01, boot_y, 0)
        solid.cut(*box(centre, ((back + 0.5) / 2 - wall - 0.015, boot_y - floor, wide - wall - 0.015), 0.01))
    if kind == "open":
        seat = uniform(-0.2, -0.12)
        solid.cut(
            *box(((bonnet + seat) / 2 - 0.05, boot_y, 0), ((bonnet - seat) / 2 - 0.02, high * 0.28, wide - 0.035), 0.02)
        )
        for z in (wide * 0.45, -wide * 0.45):
            solid.add(*box((seat - 0.02, boot_y - 0.01, z), (0.025, high * 0.28, wide * 0.33), 0.02, 0.15))
        solid.add(*box((bonnet - 0.02, boot_y + 0.035, 0), (0.012, 0.05, wide * 0.85), 0.006, 0.6))
    if rng.random() < 0.7 and kind != "open":  # mirrors
        for side in (1, -1):
            x = bonnet - uniform(0.02, 0.06)
            out = float(plan(np.float32(x)))
            solid.add(*box((x, belt + 0.015, side * (out + 0.015)), (0.014, 0.016, 0.028), 0.008))
    if kind in ("racer", "coupe", "hatch") and rng.random() < (0.8 if kind == "racer" else 0.3):  # a spoiler
        y = (high if kind == "hatch" else boot_y) + uniform(0.03, 0.07)
        x = uniform(-0.47, -0.42)
        solid.add(*box((x, y, 0), (uniform(0.03, 0.05), 0.011, wide * uniform(0.75, 0.98)), 0.005, uniform(-0.2, 0.1)))
        for z in (wide * 0.6, -wide * 0.6):
            solid.add(*capsule((x, boot_y * 0.8, z), (x, y, z), 0.012))
    if kind in ("suv", "wagon", "van") and rng.random() < 0.45:  # rails along the roof
        for side in (1, -1):
            z = side * (wide - lean * (high - belt)) * 0.8
            a, b = crest + uniform(0.02, 0.08), uniform(-0.36, -0.28)
            solid.add(
                *tube(
                    [(a, high * 0.97, z), (a - 0.03, high + 0.02, z), (b + 0.03, high + 0.02, z), (b, high * 0.95, z)],
                    0.011,
                )
            )
    if kind in ("suv", "pickup") and rng.random() < 0.25:
        solid.add(*cylinder((-0.51, boot_y * 0.85, 0), 0, wheel * 0.9, 0.03, 0.01))
    if kind in ("sedan", "hatch", "suv") and rng.random() < 0.15:  # a taxi's or police car's lights
        solid.add(*box((crest - 0.03, high + 0.012, 0), (uniform(0.015, 0.03), 0.022, uniform(0.04, 0.12)), 0.008))
    if kind == "classic":
        for side in (1, -1):
            for x in (front, rear):
                field, low_end, high_end = cylinder(
                    (x, wheel * 1.05, side * (wide - tread * 0.2)), 2, wheel * 1.35, tread * 1.3, 0.02
                )
                cap = functools.partial(_upper_half, field, wheel * 1.05)
                solid.add(cap, low_end, high_end, blend=0.02)
            solid.add(*capsule((0.47, hood_y * 0.9, side * wide * 0.6), (0.5, hood_y * 0.9, side * wide * 0.6), 0.035))
            solid.add(
                *box(((front + rear) / 2, clear, side * (wide + 0.005)), ((front - rear) / 2, 0.012, 0.03), 0.006)
            )
    if rng.random() < 0.5:
        for x, y in ((0.5, clear * 1.5), (-0.5, clear * 1.6)):
            solid.add(
                *box((x, y + 0.02, 0), (uniform(0.012, 0.03), uniform(0.015, 0.03), wide * uniform(0.75, 0.92)), 0.01)
            )
    return solid


def _upper_half(field: Field, level: float, x: Array, y: Array, z: Array) -> Array:
    return np.minimum(field(x, y, z), y - level)


def _formula(rng: np.random.Generator, resolution: int) -> Solid:
    """An open-wheeled racing car with wings in front and behind."""
    uniform = rng.uniform
    wide, wheel = uniform(0.18, 0.23), uniform(0.06, 0.075)
    solid = Solid((-0.56, -0.01, -wide - 0.03), (0.56, 0.34, wide + 0.03), resolution)
    body_y, slim = wheel * uniform(0.8, 1.1), uniform(0.04, 0.055)
    solid.add(*capsule((-0.3, body_y + 0.02, 0), (0.15, body_y + 0.02, 0), slim * 1.3, slim))
    solid.add(*capsule((0.1, body_y + 0.02, 0), (0.46, body_y - uniform(0, 0.025), 0), slim, 0.022))
    solid.add(*capsule((-0.05, body_y + 0.07, 0), (-0.4, body_y + 0.03, 0), uniform(0.04, 0.05), 0.02), blend=0.02)
    pods = uniform(0.5, 0.68) * wide
    for side in (1, -1):
        solid.add(
            *box((-0.12, body_y, side * pods * 0.75), (uniform(0.13, 0.2), uniform(0.028, 0.04), pods * 0.4), 0.025)
        )
    solid.cut(*capsule((0.03, body_y + 0.1, 0), (0.1, body_y + 0.09, 0), uniform(0.03, 0.036)))
    front, rear = uniform(0.28, 0.34), uniform(-0.38, -0.32)
    for x, tread in ((front, uniform(0.024, 0.034)), (rear, uniform(0.034, 0.045))):
        for side in (1, -1):
            solid.add(*cylinder((x, wheel, side * (wide - tread)), 2, wheel, tread, 0.012))
        for lift in (-0.02, 0.022):
            solid.add(*capsule((x - 0.02, wheel + lift, -wide + tread), (x - 0.02, wheel + lift, wide - tread), 0.011))
    solid.add(*box((0.47, uniform(0.03, 0.05), 0), (uniform(0.03, 0.045), 0.011, wide * uniform(0.8, 1)), 0.005, 0.1))
    solid.add(*capsule((0.44, body_y, 0), (0.47, 0.035, 0), 0.018))
    top = uniform(0.19, 0.28)
    solid.add(*box((-0.46, top, 0), (uniform(0.03, 0.05), 0.011, wide * 0.7), 0.005, -uniform(0.1, 0.35)))
    for side in (1, -1):
        solid.add(*box((-0.46, top - 0.03, side * wide * 0.7), (0.055, 0.055, 0.011), 0.005))
    solid.add(*capsule((-0.4, body_y, 0), (-0.46, top, 0), 0.014))
    solid.add(*capsule((-0.25, body_y, 0), (-0.44, body_y, 0), 0.03, 0.02))
    return solid
