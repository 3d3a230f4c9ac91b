"""A session of `touchnet.Explorer`: what a few more contacts cost, beside starting anew."""

import itertools
from collections.abc import Iterator

import numpy as np

from benchmarks.cases import Case, benchmark
from benchmarks.exploration import bumpy_sphere
from touchnet import Explorer
from touchnet.data import simulate_touches
from touchnet.weights import load_model

CONTACTS, MORE, SUGGESTIONS = 2000, 16, 8
NEXT_WITHIN, MESH_WITHIN = 0.1, 0.5  # seconds on two cores


@benchmark
def explorer() -> Iterator[Case]:
    touches = simulate_touches(bumpy_sphere(), CONTACTS)
    more = simulate_touches(bumpy_sphere(), 40 * MORE, seed=1)
    model = load_model()
    session = Explorer(touches.points, touches.normals, weights=model)
    session.next(SUGGESTIONS)
    batches = itertools.cycle(zip(np.array_split(more.points, 40), np.array_split(more.normals, 40), strict=True))

    def add_and_ask() -> None:
        session.add(*next(batches))
        session.next(SUGGESTIONS)

    def anew() -> None:
        Explorer(session.points, session.normals, weights=model).next(SUGGESTIONS)

    yield Case(
        f"{MORE} contacts to {CONTACTS}, {SUGGESTIONS} suggestions",
        add_and_ask,
        anew,
        "a new session",
        limit=NEXT_WITHIN,
        limit_name="of 100 ms",
        repeats=5,
    )

    def add_and_mesh() -> None:
        session.add(*next(batches))
        session.mesh()

    yield Case(
        f"{MORE} contacts more, mesh at 128^3", add_and_mesh, limit=MESH_WITHIN, limit_name="of 500 ms", repeats=5
    )

    alone = Explorer(touches.points, weights=model)
    alone.mesh()

    def add_points_and_mesh() -> None:
        alone.add(next(batches)[0])
        alone.mesh()

    yield Case(
        f"{MORE} contacts more without normals, mesh at 128^3",
        add_points_and_mesh,
        lambda: Explorer(alone.points, weights=model).mesh(),
        "a new session",
        limit=MESH_WITHIN,
        limit_name="of 500 ms",
        repeats=5,
    )

    def all_anew() -> None:
        session.add(*next(batches))
        session.next(SUGGESTIONS, refit=True)

    yield Case(f"{MORE} contacts more, surface fitted again, {SUGGESTIONS} suggestions", all_anew, repeats=5)
