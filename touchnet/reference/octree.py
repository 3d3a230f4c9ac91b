"""Octree marching cubes in plain Python: sets of cells and a dictionary of values."""

from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from typing import NamedTuple

import torch
from torch import Tensor

from touchnet.reference._extraction import (
    DEFAULT_BOX,
    Box,
    Field,
    Queries,
    attach_gradient,
    border_crossing,
    check_level,
    check_octree,
    crossing,
    no_surface,
    unit_normals,
)
from touchnet.reference.cubes import CORNERS, EDGES, cube_triangles

Point = tuple[int, int, int]  # of the lattice, from -1: the layer around the box is outside everywhere
AXES: tuple[Point, Point, Point] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


class Segment(NamedTuple):
    start: Point
    axis: int
    length: int


def octree_marching_cubes(
    field: Field,
    *,
    resolution: int | Sequence[int],
    level: float = 0.5,
    box: Box = DEFAULT_BOX,
    coarse: int = 64,
    seeds: Tensor | None = None,
    chunk: int = 1 << 20,
    dtype: torch.dtype = torch.float32,
    device: torch.device | str = "cpu",
    differentiable: bool = False,
    normals: bool = False,
) -> tuple[Tensor, ...]:
    """Twin of touchnet.ops.octree_marching_cubes: the same mesh, its vertices and faces in another order."""
    level = check_level(level)
    lower, spacing, cells, seeds = check_octree(resolution, box, coarse, chunk, dtype, seeds)
    query = Queries(field, dtype, device, chunk)
    stride = -(-max(cells) // coarse)
    values: dict[Point, float] = {}

    def evaluate(points: set[Point]) -> None:
        missing = sorted(p for p in points if p not in values and all(0 <= p[d] <= cells[d] for d in range(3)))
        for begin in range(0, len(missing), chunk):
            part = missing[begin : begin + chunk]
            found = query((lower + torch.tensor(part) * spacing).to(dtype))
            values.update(zip(part, found.tolist(), strict=True))

    def inside(point: Point) -> bool:
        return point in values and values[point] >= level

    # Where to start: along every crossed edge of the coarse lattice, and around the seeds.
    ticks = [[*range(0, n, stride), n] for n in cells]
    evaluate(set(product(*ticks)))
    segments = []
    for axis in range(3):
        ends = [-1, *ticks[axis], cells[axis] + 1]
        for point in product(*ticks):
            for first, last in pairwise(ends):
                start, end = ((*point[:axis], at, *point[axis + 1 :]) for at in (first, last))
                if point[axis] in (first, last) and inside(start) != inside(end):
                    segments.append(Segment(start, axis, last - first))
    wanted: set[Point] = set()
    for seed in [] if seeds is None else seeds.tolist():
        position = (torch.tensor(seed, dtype=torch.float64) - lower) / spacing
        if not position.isfinite().all():
            continue
        position = position.clamp(min=0).minimum(torch.tensor(cells, dtype=torch.float64))
        cell = position.floor().long().minimum(torch.tensor(cells) - 1).tolist()
        wanted |= {(cell[0] + a, cell[1] + b, cell[2] + c) for a, b, c in product((-1, 0, 1), repeat=3)}
        nearest, reach = (position + 0.5).floor().long().tolist(), min(stride, 16)
        for axis in range(3):
            first = max(nearest[axis] - reach, -1)
            last = min(nearest[axis] + reach, cells[axis] + 1)
            segments.append(Segment((*nearest[:axis], first, *nearest[axis + 1 :]), axis, last - first))
    evaluate({p for segment in segments for p in _points(segment)})
    for segment in segments:
        points = list(_points(segment))
        for a, b in pairwise(points):
            if inside(a) != inside(b):
                wanted |= {tuple(a[d] - (0 if d == segment.axis else o[d]) for d in range(3)) for o in CORNERS}

    # Follow the surface through the faces of the cells that it crosses.
    visited: set[Point] = set()
    while wanted:
        evaluate({_add(cell, corner) for cell in wanted for corner in CORNERS})
        visited |= wanted
        front, wanted = wanted, set()
        for cell in front:
            for axis, side in product(range(3), range(2)):
                signs = {inside(_add(cell, corner)) for corner in CORNERS if corner[axis] == side}
                step = tuple((2 * side - 1) * a for a in AXES[axis])
                if len(signs) == 2 and _add(cell, step) not in visited:
                    wanted.add(_add(cell, step))

    # One vertex on every crossed edge of the visited cells, and their triangles.
    vertex_of: dict[tuple[Point, int], int] = {}
    faces = []
    for cell in sorted(visited):
        case = sum(inside(_add(cell, corner)) << c for c, corner in enumerate(CORNERS))
        for triangle in cube_triangles(case):
            keys = [(_add(cell, CORNERS[EDGES[edge][0]]), edge // 4) for edge in triangle]
            faces.append([vertex_of.setdefault(key, len(vertex_of)) for key in keys])
    if not vertex_of:
        raise no_surface(level, min(values.values()), max(values.values()))
    positions, low = [], []
    for start, axis in vertex_of:
        end = _add(start, AXES[axis])
        real = start in values and end in values
        if real:
            ends = torch.tensor([values[start], values[end]], dtype=torch.float64)
            t = crossing(ends[0], ends[1], level).item()
        else:
            t = border_crossing(start not in values)
        position = torch.tensor(start, dtype=torch.float64)
        position[axis] += t
        positions.append(lower + position * spacing)
        low.append((start[0] * (cells[1] + 1) + start[1]) * (cells[2] + 1) + start[2] if real else -1)
    vertices, triangles = torch.stack(positions), torch.tensor(faces)
    if differentiable:
        axes = torch.tensor([axis for _, axis in vertex_of])
        vertices = attach_gradient(query, vertices, torch.tensor(low), axes, cells, lower, spacing, level)
    if not normals:
        return vertices, triangles
    directions = -query.gradient(vertices.detach())
    return vertices, triangles, unit_normals(directions, vertices.detach(), triangles)


def _add(a: Point, b: Point) -> Point:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _points(segment: Segment) -> Iterator[Point]:
    for n in range(segment.length + 1):
        yield tuple(s + (n if d == segment.axis else 0) for d, s in enumerate(segment.start))
