"""Marching cubes in plain Python: the rules behind the table of csrc/cube_table.h, and one loop over cells."""

from functools import cache
from itertools import product

import torch
from torch import Tensor

from touchnet.reference._extraction import (
    DEFAULT_BOX,
    Box,
    border_crossing,
    check_box,
    check_counts,
    check_level,
    check_resolved,
    check_volume,
    crossing,
    volume_normals,
)

Triangle = tuple[int, int, int]

# Corner c of a cell lies at (c >> 2 & 1, c >> 1 & 1, c & 1): z, which is contiguous in memory, is the lowest bit.
CORNERS = [(c >> 2 & 1, c >> 1 & 1, c & 1) for c in range(8)]


def _edge(a: int, b: int) -> int:
    """Number of the cell edge between two corners: 4 axis + 2 u + v, (u, v) = the offsets along the other two axes."""
    axis = next(d for d in range(3) if CORNERS[a][d] != CORNERS[b][d])
    u, v = (CORNERS[a][d] for d in range(3) if d != axis)
    return 4 * axis + 2 * u + v


EDGES = {_edge(a, b): (a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b).bit_count() == 1}  # edge -> its ends


def _face(axis: int, side: int) -> list[int]:
    """The four corners of a cell face, counter-clockwise seen from outside the cell."""
    corners = []
    for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
        position = [0, 0, 0]
        position[axis], position[(axis + 1) % 3], position[(axis + 2) % 3] = side, u, v
        corners.append(position[0] * 4 + position[1] * 2 + position[2])
    return corners if side else corners[::-1]


FACES = [_face(axis, side) for axis in range(3) for side in range(2)]
FACE_EDGES = [{_edge(face[i - 1], face[i]) for i in range(4)} for face in FACES]


def cube_loops(case: int) -> list[list[int]]:
    """Closed loops of crossed edges on the surface of a cell; bit c of `case` says whether corner c is inside.

    Walking round a face, the surface runs from an edge that enters the solid to one that leaves it. Where two diagonal
    corners are inside, the two stay joined: each outside corner is cut off by itself. This depends on the signs of that
    face alone, so both cells at the face draw the same segments, in opposite directions.
    """
    following = {}
    for face in FACES:
        inside = [case >> c & 1 for c in face]
        entering = [i for i in range(4) if not inside[i - 1] and inside[i]]  # edge i runs from corner i - 1 to corner i
        leaving = [i for i in range(4) if inside[i - 1] and not inside[i]]
        for i in entering:
            j = leaving[0] if len(leaving) == 1 else (i - 1) % 4
            following[_edge(face[i - 1], face[i])] = _edge(face[j - 1], face[j])
    loops = []
    while following:
        loop = [min(following)]
        while (edge := following.pop(loop[-1])) != loop[0]:
            loop.append(edge)
        loops.append(loop)
    return loops


def _triangulations(loop: list[int]) -> list[list[Triangle]]:
    if len(loop) < 3:
        return [[]]
    found = []
    for m in range(1, len(loop) - 1):
        for left in _triangulations(loop[: m + 1]):
            for right in _triangulations(loop[m:]):
                found.append([*left, (loop[0], loop[m], loop[-1]), *right])
    return found


def _smallest_angle_cosine(triangles: list[Triangle]) -> float:
    """Cosine of the smallest angle with every vertex in the middle of its edge."""
    middle = {e: torch.tensor([CORNERS[a], CORNERS[b]], dtype=torch.float64).mean(0) for e, (a, b) in EDGES.items()}
    cosines = []
    for t in triangles:
        for i in range(3):
            left, right = middle[t[i - 1]] - middle[t[i]], middle[t[i - 2]] - middle[t[i]]
            cosines.append(torch.nn.functional.cosine_similarity(left, right, 0).item())
    return max(cosines)


@cache
def cube_triangles(case: int) -> tuple[Triangle, ...]:
    """Triangles of a cell as triples of its edges, counter-clockwise seen from outside the solid.

    Of the triangulations of a loop without a diagonal between two edges of one face, the one with the largest smallest
    angle is taken. (A diagonal inside a face could coincide with one of the neighbour's: four triangles at one edge.)
    """
    triangles: list[Triangle] = []
    for loop in cube_loops(case):
        sides = {frozenset((loop[i - 1], loop[i])) for i in range(len(loop))}
        allowed = [
            candidate
            for candidate in _triangulations(loop)
            if all(
                side in sides or not any(side <= edges for edges in FACE_EDGES)
                for t in candidate
                for side in (frozenset((t[0], t[1])), frozenset((t[1], t[2])), frozenset((t[2], t[0])))
            )
        ]
        triangles += min(allowed, key=lambda candidate: round(_smallest_angle_cosine(candidate), 9))
    return tuple(triangles)


def marching_cubes(
    volume: Tensor, level: float = 0.5, *, box: Box = DEFAULT_BOX, normals: bool = False
) -> tuple[Tensor, ...]:
    """Twin of touchnet.ops.marching_cubes: the same vertices and faces in the same order, one Python step at a time."""
    lower, upper = check_box(box)
    level = check_level(level)
    volume = check_volume(volume)
    last = torch.tensor(volume.shape) - 1
    spacing = (upper - lower) / last
    check_resolved(lower, upper, spacing)
    values = volume.cpu().double()
    inside = torch.nn.functional.pad(values.detach() >= level, (1,) * 6)  # the outside layer around the box
    check_counts(volume.detach(), level, int((~values.isfinite()).sum()), int(inside.sum()))

    # One vertex on every lattice edge whose two ends disagree.
    is_in = inside.tolist()
    cells = [n + 1 for n in volume.shape]
    vertex_of: dict[tuple[int, int, int, int], int] = {}
    for i, j in product(range(cells[0]), range(cells[1])):
        for axis, (a, b, c) in enumerate(((1, 0, 0), (0, 1, 0), (0, 0, 1))):
            for k in range(cells[2]):
                if is_in[i][j][k] != is_in[i + a][j + b][k + c]:
                    vertex_of[axis, i, j, k] = len(vertex_of)

    # The triangles of every cell.
    faces = []
    for i, j, k in product(*map(range, cells)):
        case = sum(is_in[i + a][j + b][k + c] << corner for corner, (a, b, c) in enumerate(CORNERS))
        for triangle in cube_triangles(case):
            face = []
            for edge in triangle:
                a, b, c = CORNERS[EDGES[edge][0]]
                face.append(vertex_of[edge // 4, i + a, j + b, k + c])
            faces.append(face)

    # Where the vertices lie.
    axis, *start = torch.tensor(list(vertex_of)).unbind(1)
    start = torch.stack(start, 1) - 1
    end = start + torch.eye(3, dtype=torch.long)[axis]
    start_outside, end_outside = (start < 0).any(1), (end > last).any(1)
    real = ~(start_outside | end_outside)
    low = values[tuple(start.clamp(min=0).unbind(1))]
    high = values[tuple(end.minimum(last).unbind(1))]
    t = crossing(torch.where(real, low, level - 1), torch.where(real, high, level + 1), level)
    t = torch.where(start_outside, border_crossing(True), torch.where(end_outside, border_crossing(False), t))
    along = torch.eye(3, dtype=torch.float64)[axis]
    vertices = lower + (start + along * t[:, None]) * spacing
    mesh = vertices.to(volume.device), torch.tensor(faces, device=volume.device)
    if not normals:
        return mesh
    flat = torch.where(real, (start * torch.tensor([(last[1] + 1) * (last[2] + 1), last[2] + 1, 1])).sum(1), -1)
    return *mesh, volume_normals(volume, level, box, *mesh, flat.to(volume.device), axis.to(volume.device))
