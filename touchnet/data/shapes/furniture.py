"""Procedural furniture: tables, stools, chairs, shelves and cabinets; legs and boards are 2 % of their size or more."""

import itertools

import numpy as np

from touchnet.data.shapes.fields import Solid, box, capsule, cylinder


def furniture(rng: np.random.Generator, resolution: int) -> Solid:
    """A table, chair, shelf or cabinet, standing on y = 0, about 1 in its longest direction."""
    kind = rng.choice(["table", "chair", "shelf", "cabinet"], p=[0.35, 0.35, 0.15, 0.15])
    return {"table": _table, "chair": _chair, "shelf": _shelf, "cabinet": _cabinet}[kind](rng, resolution)


def _table(rng: np.random.Generator, resolution: int) -> Solid:
    """Tables, desks, benches and stools: a top on legs or on a column."""
    wide, deep = 0.48, 0.48 * rng.uniform(0.35, 1.0)
    high = rng.uniform(0.3, 1.0)
    board = rng.uniform(0.012, 0.04)
    is_round = rng.random() < 0.3
    if is_round:
        deep = wide
    solid = Solid((-0.5, -0.02, -deep - 0.02), (0.5, high + 0.02, deep + 0.02), resolution)
    if is_round:
        solid.add(*cylinder((0, high - board, 0), 1, wide, board, rng.uniform(0.0, board)))
    else:
        solid.add(*box((0, high - board, 0), (wide, board, deep), rng.uniform(0.0, board)))
    if rng.random() < 0.25:
        _column(rng, solid, high - board, min(wide, deep) * rng.uniform(0.5, 0.9))
    else:
        inset = 0.72 if is_round else rng.uniform(0.75, 0.95)
        _legs(rng, solid, wide * inset, deep * inset, high - board)
    if rng.random() < 0.3:  # an apron or a box of drawers under the top
        hang = rng.uniform(0.03, 0.2) * high
        solid.add(*box((0, high - board - hang, 0), (wide * 0.65, hang, deep * 0.65), 0.01))
    return solid


def _chair(rng: np.random.Generator, resolution: int) -> Solid:
    """Chairs and armchairs, stools with a back, some padded."""
    seat, high = rng.uniform(0.35, 0.55), 1.0
    wide, deep = rng.uniform(0.2, 0.34), rng.uniform(0.2, 0.32)
    pad = rng.uniform(0.014, 0.07)
    lean = rng.uniform(0.0, 0.12)
    solid = Solid((-wide - 0.08, -0.02, -deep - 0.2), (wide + 0.08, high + 0.03, deep + 0.04), resolution)
    solid.add(*box((0, seat - pad, 0), (wide, pad, deep), rng.uniform(0.0, pad)))
    if rng.random() < 0.2:
        _column(rng, solid, seat - pad, min(wide, deep) * rng.uniform(0.7, 1.0))
    elif rng.random() < 0.15:
        solid.add(*box((0, seat / 2, 0), (wide * 0.95, seat / 2, deep * 0.95), 0.02))
    else:
        _legs(rng, solid, wide * 0.88, deep * 0.88, seat - pad)

    thick = rng.uniform(0.014, 0.05)
    top, bottom = (0.0, high - thick, -deep - lean), (0.0, seat - pad, -deep + thick)
    across = np.array([wide - thick, 0, 0])
    style = rng.choice(["board", "slats", "rails", "frame"])
    sides = (-1, 1) if style != "slats" else np.linspace(-1, 1, int(rng.integers(3, 7)))
    if style == "board":
        steps = np.linspace(np.array(bottom), np.array(top), 12)
        for centre in steps:
            half = np.linalg.norm(steps[1] - steps[0])
            solid.add(*box(centre, (wide, half, thick), 0.01))
    else:
        for side in sides:
            solid.add(*capsule(bottom + side * across, top + side * across, thick))
        for share in {"slats": (1.0,), "rails": (0.4, 0.7, 1.0), "frame": (1.0, 0.5)}[style]:
            at = (1 - share) * np.array(bottom) + share * np.array(top)
            solid.add(*capsule(at - across, at + across, thick))
    if rng.random() < 0.3:
        rest = seat + rng.uniform(0.12, 0.22)
        for side in (-1, 1):
            front, back = (side * wide, rest, deep * 0.8), (side * wide, rest, -deep - 0.4 * lean)
            solid.add(*capsule(front, back, thick))
            solid.add(*capsule(front, (side * wide, seat - pad, deep * 0.7), thick))
            solid.add(*capsule(back, side * across + back * np.array([0, 1, 1]), thick))
    return solid


def _shelf(rng: np.random.Generator, resolution: int) -> Solid:
    """Boards between two sides or four posts, with a back or without."""
    high, wide, deep = rng.uniform(0.5, 1.0), rng.uniform(0.2, 0.5), rng.uniform(0.1, 0.3)
    board = rng.uniform(0.011, 0.025)
    solid = Solid((-wide - 0.02, -0.02, -deep - 0.02), (wide + 0.02, high + 0.02, deep + 0.02), resolution)
    for y in np.linspace(board if rng.random() < 0.5 else 0.15 * high, high - board, int(rng.integers(2, 6))):
        solid.add(*box((0, y, 0), (wide, board, deep)))
    if rng.random() < 0.6:
        for side in (-1, 1):
            solid.add(*box((side * (wide - board), high / 2, 0), (board, high / 2, deep)))
    else:
        for x, z in itertools.product((-1, 1), repeat=2):
            post = rng.uniform(board, 1.6 * board)
            solid.add(*box((x * (wide - board), high / 2, z * (deep - board)), (post, high / 2, post)))
    if rng.random() < 0.4:
        solid.add(*box((0, high / 2, -deep + board), (wide, high / 2, board)))
    return solid


def _cabinet(rng: np.random.Generator, resolution: int) -> Solid:
    """A closed box, or one that is open in front, on feet or on the ground, with knobs and a rim or without."""
    high, wide, deep = rng.uniform(0.4, 0.98), rng.uniform(0.2, 0.48), rng.uniform(0.15, 0.4)
    foot = rng.uniform(0.04, 0.15) if rng.random() < 0.5 else 0.0
    solid = Solid((-wide - 0.04, -0.02, -deep - 0.04), (wide + 0.04, high + 0.02, deep + 0.08), resolution)
    middle, half = (high + foot) / 2, (high - foot) / 2
    solid.add(*box((0, middle, 0), (wide, half, deep), rng.uniform(0.0, 0.05)))
    if rng.random() < 0.5:
        wall = rng.uniform(0.025, 0.06)
        for _ in range(int(rng.integers(1, 3))):
            low = foot + wall + rng.uniform(0.0, 0.5) * half
            top = low + rng.uniform(0.3, 1.0) * (high - wall - low)
            cut = (wide - wall, (top - low) / 2, deep)
            solid.cut(*box((0, (top + low) / 2, wall + rng.uniform(0.0, 0.5) * deep), cut))
    else:
        for y in foot + 2 * half * rng.uniform(0.15, 0.85, size=int(rng.integers(0, 4))):
            solid.add(*capsule((0, y, deep), (0, y, deep + 0.03), 0.025))
    if rng.random() < 0.4:
        solid.add(*box((0, high - 0.02, 0), (wide + 0.03, 0.02, deep + 0.03), 0.005))
    if foot:
        _legs(rng, solid, wide * 0.9, deep * 0.9, foot + 0.02)
    return solid


def _legs(rng: np.random.Generator, solid: Solid, wide: float, deep: float, high: float) -> None:
    """Four legs, or three, up to `high`, square or round, tapered and splayed, some joined by stretchers."""
    thick = rng.uniform(0.012, 0.04)
    splay = rng.uniform(0.85, 1.0) if rng.random() < 0.4 else 1.0
    corners = [(-wide, -deep), (wide, -deep), (wide, deep), (-wide, deep)]
    if rng.random() < 0.12:
        corners = [(0.0, -deep), (wide, deep), (-wide, deep)]
    square = splay == 1.0 and rng.random() < 0.5
    end = thick * rng.uniform(0.6, 1.0)
    for x, z in corners:
        if square:
            solid.add(*box((x, high / 2, z), (thick, high / 2, thick), 0.005))
        else:
            solid.add(*capsule((x * splay, high, z * splay), (x, 0.012, z), thick, max(end, 0.012)))
    if rng.random() < 0.4:
        y = high * rng.uniform(0.15, 0.6)
        for (x0, z0), (x1, z1) in itertools.pairwise([*corners, corners[0]]):
            if rng.random() < 0.8:
                solid.add(*capsule((x0, y, z0), (x1, y, z1), 0.8 * max(thick, 0.016)))


def _column(rng: np.random.Generator, solid: Solid, high: float, foot: float) -> None:
    """One leg in the middle, on a plate or on three to five spread feet."""
    thick = rng.uniform(0.02, 0.08)
    solid.add(*capsule((0, 0.02, 0), (0, high, 0), thick, thick * rng.uniform(0.6, 1.0)))
    if rng.random() < 0.5:
        plate = rng.uniform(0.012, 0.03)
        solid.add(*cylinder((0, plate, 0), 1, foot, plate, 0.01))
        return
    feet = int(rng.integers(3, 6))
    for turn in 2 * np.pi * (np.arange(feet) / feet + rng.random()):
        solid.add(*capsule((0, 0.1, 0), (foot * np.sin(turn), 0.02, foot * np.cos(turn)), 0.02, 0.018))
