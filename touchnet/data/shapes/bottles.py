"""Procedural bottles, jars, jugs and canisters."""

import numpy as np

from touchnet.data.shapes.fields import (
    Array,
    Field,
    Solid,
    box,
    capsule,
    curve,
    cylinder,
    smooth_min,
    superellipse,
    tube,
)
from touchnet.data.shapes.handles import add_handle


def bottle(rng: np.random.Generator, resolution: int) -> Solid:
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
    profile = curve(body)
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
            side = superellipse(x, z, a, b, n) - inset
            return smooth_min(smooth_min(side, y - bottom, heel), ceiling - y, 0.008)

        return field

    reach = radius * 1.1
    beside = max(reach, 0.5 if kind == "spray" else 0, reach + 0.3 if kind in ("jug", "pump") else 0)
    solid = Solid((-beside, -0.01, -reach - 0.01), (beside, 1.01, reach + 0.01), resolution)
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
            solid.add(*cylinder((0, top - high / 2, 0), 1, cap, high / 2, rng.uniform(0.002, 0.015)))
        if kind == "sport":
            solid.add(*capsule((0, top - high, 0), (0, 0.995 - 0.02, 0), cap * 0.4, 0.02))

    if kind == "jug" or (kind in ("flask", "squared") and rng.random() < 0.15):
        add_handle(rng, solid, profile, low + shoulder * 0.9, low * rng.uniform(0.25, 0.6), beside)
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
            return np.minimum(superellipse(x, z, r, r * flat, power), high - np.abs(y - at))

        solid.add(label, (-reach, at - high, -reach), (reach, at + high, reach))
    return solid


def _canister_grip(rng: np.random.Generator, solid: Solid, radius: float, low: float, flat: float) -> None:
    """A hole through the upper corner, so that the rim becomes the handle."""
    wide, high = radius * rng.uniform(0.35, 0.5), low * rng.uniform(0.08, 0.16)
    centre = (radius * 0.35, low * rng.uniform(0.72, 0.82), 0)
    solid.cut(*box(centre, (wide, high, 2 * radius), 0.02, rng.uniform(-0.3, 0.1)))


def _spray_head(rng: np.random.Generator, solid: Solid, top: float, neck: float) -> None:
    long, high = rng.uniform(0.13, 0.24), rng.uniform(0.035, 0.05)
    solid.add(*cylinder((0, top + 0.02, 0), 1, neck * 1.25, 0.05, 0.005))
    solid.add(*capsule((0, top, 0), (0, 1 - high, 0), neck * 0.8))
    solid.add(*box((long * 0.35, 1 - high, 0), (long, high, rng.uniform(0.03, 0.05)), 0.015))
    solid.add(*capsule((long * 1.2, 1 - high, 0), (long * 1.35 + 0.03, 1 - high, 0), 0.025, 0.018))
    trigger = [
        (long * 0.9, 1 - 1.6 * high, 0),
        (long * 1.0, 1 - 0.12, 0),
        (long * 0.75, 1 - rng.uniform(0.16, 0.22), 0),
    ]
    solid.add(*tube(trigger, rng.uniform(0.014, 0.02)))


def _pump_head(rng: np.random.Generator, solid: Solid, top: float, neck: float) -> None:
    solid.add(*cylinder((0, top, 0), 1, neck * 1.3, 0.03, 0.005))
    solid.add(*capsule((0, top, 0), (0, 0.97, 0), max(0.018, neck * 0.35)))
    long = rng.uniform(0.1, 0.25)
    solid.add(*cylinder((0, 0.965, 0), 1, neck * rng.uniform(0.7, 1.0), 0.025, 0.008))
    spout = [(0, 0.97, 0), (long * 0.8, 0.97 - rng.uniform(0, 0.02), 0), (long, 0.93 - rng.uniform(0, 0.03), 0)]
    solid.add(*tube(spout, rng.uniform(0.016, 0.022)))
