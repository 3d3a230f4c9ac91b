"""Procedural figures: animals, people, fruits and lumps, limbs grown into each other, round all over."""

import numpy as np

from touchnet.data.shapes.fields import Solid, ball, capsule, tube


def figure(rng: np.random.Generator, resolution: int) -> Solid:
    """An animal on four legs, a person, a bird, a bent fruit or a lump; about 1 in its longest direction."""
    makers = {"animal": _animal, "person": _person, "bird": _bird, "fruit": _fruit, "lump": _lump}
    return makers[rng.choice(list(makers), p=[0.3, 0.2, 0.15, 0.15, 0.2])](rng, resolution)


def _animal(rng: np.random.Generator, resolution: int) -> Solid:
    """A trunk on four legs, with neck, head, ears and tail. It looks along x."""
    solid = Solid((-0.62, -0.03, -0.32), (0.72, 1.1, 0.32), resolution)
    blend = rng.uniform(0.02, 0.07)
    long, hip = rng.uniform(0.18, 0.34), rng.uniform(0.22, 0.5)
    chest, rump = rng.uniform(0.1, 0.2, size=2)
    solid.add(*capsule((-long, hip, 0), (long, hip + rng.uniform(-0.03, 0.06), 0), rump, chest))
    thick = rng.uniform(0.025, 0.07)
    for x, wide in ((-long, rump), (long, chest)):
        step = rng.uniform(-0.1, 0.1)
        for side in (-1, 1):
            z = side * wide * 0.6
            knee = (x + side * step * 0.5 + rng.uniform(-0.04, 0.04), hip * 0.5, z)
            foot = (x + side * step, 0.03, z)
            solid.add(*tube([(x, hip, z), knee, foot], [1.4 * thick, thick, max(0.8 * thick, 0.02)]), blend=blend)
            if rng.random() < 0.5:
                solid.add(*capsule(foot, (foot[0] + 0.04, 0.03, z), max(0.9 * thick, 0.022)), blend=0.02)
    rise, reach = rng.uniform(0.05, 0.4), rng.uniform(0.08, 0.25)
    head = np.array([long + reach, hip + rise, 0])
    neck = rng.uniform(0.05, 0.11)
    solid.add(*capsule((long * 0.9, hip, 0), head, chest * 0.8, neck), blend=blend)
    skull = rng.uniform(0.07, 0.13)
    solid.add(*ball(head, (skull, skull * rng.uniform(0.8, 1.1), skull * rng.uniform(0.7, 1.0))), blend=blend)
    snout = head + np.array([skull + rng.uniform(0.0, 0.12), -rng.uniform(0.0, 0.08), 0])
    solid.add(*capsule(head, snout, skull * 0.7, max(skull * rng.uniform(0.3, 0.6), 0.025)), blend=0.02)
    _ears(rng, solid, head, skull)
    if rng.random() < 0.75:
        bend = [-long - rump - rng.uniform(0.0, 0.08), hip + rng.uniform(-0.2, 0.2), 0]
        tip = [bend[0] - rng.uniform(-0.04, 0.08), bend[1] + rng.uniform(-0.15, 0.15), rng.uniform(-0.1, 0.1)]
        solid.add(*tube([(-long, hip + 0.3 * rump, 0), bend, tip], [0.04, 0.03, 0.02]), blend=0.02)
    return solid


def _ears(rng: np.random.Generator, solid: Solid, head: np.ndarray, skull: float) -> None:
    kind = rng.choice(["none", "round", "long"])
    if kind == "none":
        return
    for side in (-1, 1):
        if kind == "round":
            at = head + np.array([0, 0.75, side * 0.7]) * skull
            solid.add(*ball(at, skull * np.array([0.3, 0.45, 0.45])), blend=0.01)
        else:
            root = head + np.array([0, 0.7, side * 0.4]) * skull
            tip = root + np.array([rng.uniform(-0.06, 0.03), rng.uniform(0.05, 0.16), side * 0.05])
            solid.add(*capsule(root, tip, 0.03, 0.02), blend=0.01)


def _person(rng: np.random.Generator, resolution: int) -> Solid:
    """A trunk, a head, two arms and two legs, standing or sitting. It looks along x."""
    solid = Solid((-0.45, -0.04, -0.62), (0.62, 1.06, 0.62), resolution)
    blend = rng.uniform(0.015, 0.05)
    stout = rng.uniform(0.8, 1.8)
    hip, neck = rng.uniform(0.35, 0.5), rng.uniform(0.72, 0.82)
    waist, chest = 0.075 * stout, 0.085 * stout
    for side in (-1, 1):
        solid.add(*capsule((0, hip, side * 0.4 * waist), (0, neck - chest, side * 0.5 * chest), waist, chest))
    head = (neck + 1.0) / 2
    radius = 1.0 - head
    solid.add(*capsule((0, neck - chest, 0), (0, head, 0), 0.045 * stout), blend=blend)
    solid.add(*ball((0.01, head, 0), (radius, radius * 1.05, radius * 0.9)), blend=0.01)
    thick = 0.035 * stout
    sits = rng.random() < 0.25
    for side in (-1, 1):
        shoulder = np.array([0, neck - 0.6 * chest, side * 1.3 * chest])
        out, forward = rng.uniform(-0.2, 1.4), rng.uniform(-0.5, 1.2)
        down = np.array([np.sin(forward) * np.cos(out), -np.cos(forward) * np.cos(out), side * np.sin(out)])
        elbow = shoulder + 0.17 * down
        hand = elbow + 0.16 * (down + rng.normal(size=3) * 0.4)
        hand = np.clip(hand, [-0.4, 0.05, -0.57], [0.57, 1.0, 0.57])
        solid.add(*tube([shoulder, elbow, hand], [thick, 0.85 * thick, max(0.7 * thick, 0.022)]), blend=blend)
        socket = np.array([0, hip, side * 0.7 * waist])
        if sits:
            knee = socket + np.array([0.28, rng.uniform(-0.03, 0.03), side * rng.uniform(0.0, 0.1)])
            foot = knee + np.array([rng.uniform(-0.05, 0.1), -0.28, 0])
        else:
            knee = socket * (1, 0.52, 1) + np.array([rng.uniform(-0.06, 0.12), 0, side * rng.uniform(0.0, 0.06)])
            foot = np.array([knee[0] - rng.uniform(-0.02, 0.1), 0.03, knee[2] + side * rng.uniform(0.0, 0.06)])
        solid.add(*tube([socket, knee, foot], [1.3 * thick, thick, max(0.8 * thick, 0.025)]), blend=blend)
        solid.add(*capsule(foot, foot + np.array([0.08, 0, 0]), max(0.8 * thick, 0.025)), blend=0.01)
    return solid


def _bird(rng: np.random.Generator, resolution: int) -> Solid:
    """Ducks, chicks and fish: a body, a head or none, a tail, wings or fins. It looks along x."""
    solid = Solid((-0.62, -0.3, -0.4), (0.62, 0.75, 0.4), resolution)
    blend = rng.uniform(0.02, 0.08)
    long, high, wide = rng.uniform(0.28, 0.42), rng.uniform(0.14, 0.28), rng.uniform(0.1, 0.26)
    solid.add(*ball((0, 0, 0), (long, high, wide)))
    if rng.random() < 0.65:
        skull = rng.uniform(0.09, 0.17)
        head = np.array([long * rng.uniform(0.5, 1.0), high + skull * rng.uniform(0.2, 1.5), 0])
        solid.add(*capsule((long * 0.5, high * 0.3, 0), head, skull * 0.8, skull * 0.7), blend=blend)
        solid.add(*ball(head, (skull, skull, skull * 0.9)), blend=blend)
        beak = head + np.array([skull + rng.uniform(0.0, 0.08), -0.2 * skull, 0])
        solid.add(*capsule(head, beak, 0.4 * skull, 0.022), blend=0.01)
    thin = rng.uniform(0.018, 0.04)
    tail = np.array([-long - rng.uniform(0.0, 0.08), rng.uniform(0.0, 0.15), 0])
    spread = np.array([0.12, rng.uniform(0.03, 0.2), thin])
    solid.add(*ball(tail, spread if rng.random() < 0.5 else spread[[0, 2, 1]]), blend=blend)
    solid.add(*capsule((-long * 0.6, 0, 0), tail, high * 0.4, 0.03), blend=blend)
    for side in (-1, 1):
        fin = (rng.uniform(-0.1, 0.1), rng.uniform(-0.05, 0.1), side * wide)
        solid.add(*ball(fin, (long * 0.5, high * rng.uniform(0.25, 0.5), max(thin, 0.03))), blend=0.02)
    return solid


def _fruit(rng: np.random.Generator, resolution: int) -> Solid:
    """Bananas, pears, gourds, carrots: a thickness that changes along an arc, perhaps a stalk."""
    bend = rng.uniform(0.0, 2.2)
    turns = np.linspace(-bend / 2, bend / 2, 17)
    radius = 0.85 / max(bend, 0.3)
    if bend < 0.3:
        points = np.stack([np.linspace(-0.42, 0.42, 17), np.zeros(17), np.zeros(17)], axis=1)
    else:
        points = radius * np.stack([np.sin(turns), 1 - np.cos(turns), np.zeros(17)], axis=1)
    along = np.linspace(0, 1, 17)
    knots = rng.uniform(0.05, 0.2, size=5)
    knots[[0, -1]] *= rng.uniform(0.2, 0.9, size=2)
    radii = np.maximum(np.interp(along, np.linspace(0, 1, 5), knots), 0.02)
    field, low, high = tube(points, radii)
    tip = points[-1] + np.array([rng.uniform(0.03, 0.1), rng.uniform(0.0, 0.08), 0])
    solid = Solid(np.minimum(low, tip - 0.03) - 0.02, np.maximum(high, tip + 0.03) + 0.02, resolution)
    solid.add(field, low, high)
    if rng.random() < 0.4:
        solid.add(*capsule(points[-1], tip, 0.025, 0.02), blend=0.02)
    return solid


def _lump(rng: np.random.Generator, resolution: int) -> Solid:
    """Three to eight ellipsoids and limbs in a tree: toys, stones, sculptures."""
    balls = [(np.zeros(3), rng.uniform(0.1, 0.25, size=3))]
    limbs = []
    for _ in range(int(rng.integers(2, 8))):
        near, radii = balls[rng.integers(len(balls))]
        away = rng.normal(size=3)
        away /= np.linalg.norm(away)
        centre = near + away * radii.mean() * rng.uniform(0.7, 2.2)
        balls.append((centre, rng.uniform(0.04, 0.22, size=3)))
        limbs.append((near, centre))
    low = np.min([centre - radii.max() for centre, radii in balls], axis=0)
    high = np.max([centre + radii.max() for centre, radii in balls], axis=0)
    solid = Solid(low - 0.1, high + 0.1, resolution)
    blend = rng.uniform(0.02, 0.12)
    for centre, radii in balls:
        solid.add(*ball(centre, radii), blend=blend)
    thick = rng.uniform(0.03, 0.06)
    for start, end in limbs:
        solid.add(*capsule(start, end, thick), blend=blend)
    return solid
