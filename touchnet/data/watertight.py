"""Closed, outward-wound meshes from whatever a modeller left: triangle soups, open shells, flipped faces.

Lengths are given as shares of the longest side of the mesh's bounding box, so one setting fits millimetres and metres.
"""

import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import point_cloud_utils as pcu
import torch
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, sparse

from touchnet.data.closest_points import ClosestPoints
from touchnet.ops import marching_cubes

METHODS = ("auto", "manifold", "closing", "alpha_wrap")

# A closed mesh counts as hollow when it leaves empty more than HOLLOW_SHARE of the places that a ball of HOLLOW_BALL
# cannot enter and that triangles surround in HOLLOW_BLOCKED of all directions. Cups pass (the ball enters through the
# mouth), biplanes pass (open to the sides between the wings), car bodies with open windows do not.
HOLLOW_BALL = 0.08
HOLLOW_BLOCKED = 0.7
HOLLOW_SHARE = 0.35


class MeshReport(NamedTuple):
    """What `inspect_mesh` found. `open_edges` counts edges that do not have exactly two faces."""

    open_edges: int
    winding_consistent: bool
    volume: float
    """In cubed units of the mesh; negative when it is wound inwards."""
    simple: bool
    """Every face separates outside from inside: no face inside another part, no face counted twice."""
    thin: float
    """Share of the surface whose wall is thinner than 1 % of the longest side."""

    @property
    def closed(self) -> bool:
        return self.open_edges == 0 and self.winding_consistent


def make_watertight(
    mesh: trimesh.Trimesh, *, method: str = "auto", resolution: int = 20_000, offset: float = 0.0025, seed: int = 0
) -> trimesh.Trimesh:
    """A closed mesh, faces wound outwards, around any triangle mesh; in the coordinates of the input.

    Methods:
        auto: a mesh that is closed already keeps its faces (flipped with a warning where they wind inwards). Others are
            closed by `manifold`; a hollow result (an open shell whose inside was reached through its holes) is
            replaced by `closing` with the smallest of the balls 2, 4, 8 % that leaves it solid. A shell that is still
            hollow though its faces look outwards all around (a car body without a floor) is filled where their winding
            number exceeds 0.5.
        manifold: Huang, Su, Guibas, "Robust watertight manifold surface generation", 2018: an octree around the
            triangles, its outer boundary, then vertices pulled towards the triangles up to `offset`.
        closing: what a ball of radius 4 % rolling around the triangles cannot reach.
        alpha_wrap: CGAL's alpha wrap (alpha 1 % of the box's diagonal, again with 3 and 8 % when hollow) through
            pymeshlab (extra `[data]`).

    Args:
        resolution: of `manifold`, about the number of leaves of the octree.
        offset: distance of the closed surface from the triangles; a sheet without thickness becomes twice as thick.
        seed: of `manifold`, which is random otherwise.

    Returns:
        A `trimesh.Trimesh`; its `metadata` says `closed_by` (str) and `hollow` (share of the inside left empty).

    Raises:
        ValueError: no usable triangle, or no closed mesh with positive volume came out.
        ImportError: `alpha_wrap` without pymeshlab.
    """
    if method not in METHODS:
        raise ValueError(f"method should be one of {', '.join(METHODS)}, got {method!r}")
    vertices, faces, centre, side = _normalised(mesh)
    if method == "auto":
        kept = _orient_closed(vertices, faces)
        if kept is not None:
            faces, how = kept
            return _finish(vertices, faces, centre, side, how, 0.0)

    if method == "closing":
        closed_vertices, closed_faces = _close_by_ball(vertices, faces, 0.04, offset)
        how = "closing 0.04"
        hollow = 0.0
    elif method == "alpha_wrap":
        closed_vertices, closed_faces, how, hollow = _alpha_wrap(vertices, faces, offset)
    else:
        closed_vertices, closed_faces = _manifold(vertices, faces, resolution, offset, seed)
        how = f"manifold {resolution}"
        coarse = _coarse_solid(vertices, faces)
        hollow = _hollow_share(closed_vertices, closed_faces, coarse)
        if method == "auto" and hollow > HOLLOW_SHARE:
            for ball in (0.02, 0.04, 0.08):
                solid_vertices, solid_faces = _close_by_ball(vertices, faces, ball, offset)
                left = _hollow_share(solid_vertices, solid_faces, coarse)
                if left <= HOLLOW_SHARE:
                    closed_vertices, closed_faces, how, hollow = solid_vertices, solid_faces, f"closing {ball}", left
                    break
        if method == "auto":
            enclosed = _enclosed(vertices, faces)
            left = _hollow_share(closed_vertices, closed_faces, enclosed)
            if left > HOLLOW_SHARE:
                closed_vertices, closed_faces = _fill_by_winding(vertices, faces, offset)
                how, hollow = "winding fill", _hollow_share(closed_vertices, closed_faces, enclosed)
    return _finish(closed_vertices, closed_faces, centre, side, how, hollow)


def inspect_mesh(mesh: trimesh.Trimesh, *, samples: int = 2000) -> MeshReport:
    """Whether a mesh can be labelled: closed, wound one way, no inner faces, and how much of it is thin."""
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if len(faces) == 0:
        raise ValueError("mesh should have faces, got none")
    open_edges, consistent = edge_report(faces)
    side = float(np.ptp(vertices[faces].reshape(-1, 3), axis=0).max())
    outside, inside, deep = _winding_beside(vertices, faces, (1e-4 * side, -1e-4 * side, -1e-2 * side), samples)
    return MeshReport(
        open_edges,
        consistent,
        signed_volume(vertices, faces),
        bool(_separates(outside, inside)),
        float(np.mean(deep < 0.5)),
    )


def signed_volume(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> float:
    """Volume enclosed by triangles (V,3), (F,3); negative where they wind inwards (divergence theorem)."""
    # Around the centre of the box, or far-away meshes lose all digits.
    corners = (vertices - (vertices.min(0) + vertices.max(0)) / 2)[faces]
    return float(np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def winding_number(vertices: ArrayLike, faces: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Fast winding number (Barill et al. 2018) of triangles (V,3), (F,3) at points (M,3): 1 inside, 0 outside.

    The far field is approximated: on closed meshes values are off by a few percent, far from the 0.5 that decides.
    """
    points = np.ascontiguousarray(points, dtype=np.float64).reshape(-1, 3)
    if len(points) == 0:
        return np.zeros(0)
    values = pcu.triangle_soup_fast_winding_number(
        np.ascontiguousarray(vertices, dtype=np.float64), np.ascontiguousarray(faces, dtype=np.int64), points
    )
    return np.asarray(values, dtype=np.float64).reshape(-1)


def _normalised(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], float]:
    """Merged finite vertices in unit coordinates and faces without repeated corners."""
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
    faces = faces[np.isfinite(vertices[faces]).all(axis=(1, 2))]
    if len(faces) == 0:
        raise ValueError("mesh should have faces with finite corners, got none")
    used, faces = np.unique(faces, return_inverse=True)
    vertices, merged = np.unique(vertices[used], axis=0, return_inverse=True)
    faces = merged.reshape(-1)[faces.reshape(-1, 3)]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    low, high = vertices.min(0), vertices.max(0)
    side = float((high - low).max())
    if len(faces) == 0 or not 0 < side < np.inf:
        raise ValueError(f"mesh should have triangles with an extent, got {len(faces)} and a longest side of {side:g}")
    centre = (low + high) / 2
    return (vertices - centre) / side, faces, centre, side


def _finish(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    centre: NDArray[np.float64],
    side: float,
    how: str,
    hollow: float,
) -> trimesh.Trimesh:
    open_edges, consistent = edge_report(faces)
    volume = signed_volume(vertices, faces) if len(faces) else 0.0
    if len(faces) == 0 or open_edges or not consistent or not volume > 0:
        raise ValueError(
            f"no closed mesh came out ({how}): {len(faces)} faces, {open_edges} open edges, volume {volume:.3g} "
            "of the cubed longest side"
        )
    closed = trimesh.Trimesh(vertices * side + centre, faces, process=False)
    closed.metadata.update(closed_by=how, hollow=round(hollow, 4))
    return closed


def edge_report(faces: NDArray[np.integer]) -> tuple[int, bool]:
    """Edges that do not have exactly two faces, and whether the two always run in opposite directions."""
    halves = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    forward = halves[:, 0] < halves[:, 1]
    key = halves.min(1) * (int(faces.max(initial=0)) + 1) + halves.max(1)
    _, edge, uses = np.unique(key, return_inverse=True, return_counts=True)
    balance = np.bincount(edge, np.where(forward, 1, -1))
    return int((uses != 2).sum()), bool((balance[uses == 2] == 0).all())


def _surface_points(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], count: int, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Area-uniform points and unit normals."""
    rng = np.random.default_rng(seed)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice_area = np.linalg.norm(cross, axis=1)
    total = np.cumsum(twice_area)
    pick = np.minimum(np.searchsorted(total, rng.random(count) * total[-1], side="right"), len(faces) - 1)
    r, s = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    chosen = corners[pick]
    points = (1 - r) * chosen[:, 0] + r * (1 - s) * chosen[:, 1] + r * s * chosen[:, 2]
    return points, cross[pick] / np.maximum(twice_area[pick], 1e-300)[:, None]


def _winding_beside(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], steps: Sequence[float], samples: int
) -> NDArray[np.float64]:
    """Winding numbers (steps, samples) at surface points moved by each of the steps along the normals."""
    points, normals = _surface_points(vertices, faces, samples)
    moved = points + np.asarray(steps)[:, None, None] * normals
    return winding_number(vertices, faces, moved).reshape(len(steps), samples)


def _separates(outside: NDArray[np.float64], inside: NDArray[np.float64]) -> bool:
    return np.mean((np.abs(outside) < 0.25) & (np.abs(inside - 1) < 0.25)) > 0.99


def _orient_closed(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> tuple[NDArray[np.int64], str] | None:
    """The faces wound outwards when they bound a solid already, else None."""
    if edge_report(faces)[0]:
        return None

    def bounds_a_solid(candidate: NDArray[np.int64]) -> bool:
        return edge_report(candidate)[1] and _separates(*_winding_beside(vertices, candidate, (1e-4, -1e-4), 2000))

    if bounds_a_solid(faces):
        return faces, "closed already"
    for candidate in (faces[:, ::-1], _orient_components(vertices, faces)):
        if bounds_a_solid(candidate):
            flipped = int((candidate != faces).any(1).sum())
            warnings.warn(f"{flipped} of {len(faces)} faces wound inwards were flipped", stacklevel=4)
            return candidate, "closed already, faces flipped"
    return None


def _orient_components(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Each connected component of a mesh without open edges wound one way and outwards."""
    halves = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    forward = halves[:, 0] < halves[:, 1]
    order = np.lexsort((halves.max(1), halves.min(1)))
    first, second = order[0::2], order[1::2]
    # 1: neighbours agree (the shared edge runs both ways), 1000: one must be flipped; two shared edges are summed.
    weight = np.where(forward[first] != forward[second], 1, 1000)
    a, b = first // 3, second // 3
    graph = sparse.coo_array(
        (np.concatenate([weight, weight]), (np.concatenate([a, b]), np.concatenate([b, a]))), (len(faces),) * 2
    ).tocsr()
    component = sparse.csgraph.connected_components(graph, directed=False)[1]
    flip = np.zeros(len(faces), dtype=bool)
    starts = np.unique(component, return_index=True)[1]
    for start in starts:
        nodes, parents = sparse.csgraph.breadth_first_order(graph, start)
        unlike = np.asarray(graph[parents[nodes[1:]], nodes[1:]]).reshape(-1) >= 1000
        for node, parent, differs in zip(nodes[1:].tolist(), parents[nodes[1:]].tolist(), unlike.tolist(), strict=True):
            flip[node] = flip[parent] ^ differs
    oriented = np.where(flip[:, None], faces[:, ::-1], faces)
    corners = vertices[oriented]
    parts = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    inwards = np.bincount(component, parts) < 0
    return np.where(inwards[component][:, None], oriented[:, ::-1], oriented)


def _closest(
    points: NDArray[np.float64], vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distances (M,) and closest points (M,3) on triangles."""
    closest, _, distance = ClosestPoints(vertices, faces)(points)
    return distance, closest


def _pull(
    wrapped: NDArray[np.float64],
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    offset: float,
    reach: float = np.inf,
) -> NDArray[np.float64]:
    """Vertices of a wrap moved to `offset` from the triangles, those farther than `reach` left alone."""
    distance, closest = _closest(wrapped, vertices, faces)
    direction = (wrapped - closest) / np.maximum(distance, 1e-12)[:, None]
    pulled = closest + direction * np.minimum(distance, offset)[:, None]
    return np.where((distance < reach)[:, None], pulled, wrapped)


def _manifold(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], resolution: int, offset: float, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    wrapped, wrapped_faces = pcu.make_mesh_watertight(vertices, faces, resolution, seed)
    wrapped, wrapped_faces = np.asarray(wrapped, np.float64), np.asarray(wrapped_faces, np.int64)
    if len(wrapped_faces) == 0:
        return wrapped, wrapped_faces
    # The wrap stands off by a cell of the octree, 0.25 to 1 % of the longest side depending on the mesh: pulled to one
    # and the same distance, walls keep their thickness and no two meshes differ by the luck of their octree.
    return _pull(wrapped, vertices, faces, offset), wrapped_faces


class _Grid(NamedTuple):
    origin: NDArray[np.float64]
    spacing: float
    depth: NDArray[np.float64]
    """Distance to the region the centre of the ball reaches; > radius: the ball never gets there."""
    distance: NDArray[np.float64]
    """About the distance to the triangles."""


def _roll_ball(vertices: NDArray[np.float64], faces: NDArray[np.int64], radius: float, spacing: float) -> _Grid:
    """Rolls a ball around the triangles on a grid of cubes."""
    low, high = vertices.min(0) - radius - 3 * spacing, vertices.max(0) + radius + 3 * spacing
    shape = np.ceil((high - low) / spacing).astype(int) + 1
    corners = vertices[faces]
    area = float(
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    )
    samples, _ = _surface_points(vertices, faces, int(np.clip(12 * area / spacing**2, 10_000, 3_000_000)))
    cells = np.rint((np.concatenate([samples, vertices]) - low) / spacing).astype(int)
    empty = np.ones(shape, dtype=bool)
    empty[tuple(cells.T)] = False
    distance = ndimage.distance_transform_edt(empty, sampling=spacing)
    # The grid's distance is off by up to a cell; what decides is computed exactly.
    near = np.argwhere(np.abs(distance - radius) < 2 * spacing)
    distance[tuple(near.T)] = _closest(low + near * spacing, vertices, faces)[0]
    regions, _ = ndimage.label(distance > radius)
    reached = regions == regions[0, 0, 0]
    depth, nearest = ndimage.distance_transform_edt(~reached, sampling=spacing, return_indices=True)
    # The region's edge lies between its last grid point and the next one: the part beyond the point is known.
    depth = np.where(reached, radius - distance, depth - (distance[tuple(nearest)] - radius))
    return _Grid(low, spacing, depth, distance)


def _close_by_ball(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], radius: float, offset: float, spacing: float = 1 / 160
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    grid = _roll_ball(vertices, faces, radius, spacing)
    return _extract(grid.depth - (radius - min(offset, radius / 2)), grid.origin, spacing, vertices, faces, offset)


def _fill_by_winding(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], offset: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The triangles, thickened, together with everything whose winding number exceeds 0.5."""
    # Flat shapes get the cells of `_close_by_ball`, bulky ones as many as a few seconds of winding numbers allow.
    spacing = max(1 / 160, float(np.cbrt(np.prod(np.ptp(vertices, axis=0) + 0.05) / 5e5)))
    thick = spacing  # thinner sheets would slip between grid points; pulled to `offset` afterwards
    grid = _roll_ball(vertices, faces, thick, spacing)
    points = _grid_points(grid)
    winding = winding_number(vertices, faces, points)
    # A shell's box bounds the filling, or it bulges out of a missing floor.
    from_box = np.minimum(points - vertices.min(0), vertices.max(0) - points).min(1)
    # The winding number changes over about a tenth of the side around a hole: scaled to lengths of that order.
    filling = np.minimum(0.1 * (winding - 0.5), from_box + offset)
    field = np.maximum(grid.depth, filling.reshape(grid.depth.shape))
    empty, _ = ndimage.label(field < 0)
    field[(empty > 0) & (empty != empty[0, 0, 0])] = spacing  # pockets that the filling sealed
    return _extract(field, grid.origin, spacing, vertices, faces, offset)


def _grid_points(grid: _Grid) -> NDArray[np.float64]:
    return grid.origin + np.indices(grid.depth.shape).reshape(3, -1).T * grid.spacing


def _extract(
    field: NDArray[np.float64],
    origin: NDArray[np.float64],
    spacing: float,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    offset: float,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The boundary of field ≥ 0, pulled to `offset` where it runs along the triangles."""
    field = np.pad(field, 1, constant_values=-spacing)  # under a floorless car the winding number is still large
    origin = origin - spacing
    high = origin + spacing * (np.array(field.shape) - 1)
    wrapped, wrapped_faces = marching_cubes(
        torch.from_numpy(np.ascontiguousarray(field)), 0.0, box=(tuple(origin.tolist()), tuple(high.tolist()))
    )
    wrapped, wrapped_faces = wrapped.numpy(), wrapped_faces.numpy()
    return _pull(wrapped, vertices, faces, offset, reach=1.5 * spacing), wrapped_faces


def _coarse_solid(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Up to 1000 points (K,3) that should be solid: see HOLLOW_BALL."""
    grid = _roll_ball(vertices, faces, HOLLOW_BALL, 1 / 64)
    deep = np.argwhere((grid.depth > HOLLOW_BALL + grid.spacing) & (grid.distance > 1.5 * grid.spacing))
    points = grid.origin + deep[:: max(1, len(deep) // 1000)] * grid.spacing
    # Directions of a Fibonacci sphere.
    height = (np.arange(64) + 0.5) / 32 - 1
    turn = np.arange(64) * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - height**2)
    directions = np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1)
    face, _, _ = pcu.ray_mesh_intersection(
        vertices, faces, np.repeat(points, 64, axis=0), np.tile(directions, (len(points), 1))
    )
    blocked = (np.asarray(face).reshape(-1, 64) >= 0).mean(axis=1)
    return points[blocked >= HOLLOW_BLOCKED]


def _enclosed(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Points (K,3) of a grid that the faces, as they are wound, enclose, away from the triangles."""
    axes = [np.arange(low, high, 1 / 40) for low, high in zip(vertices.min(0), vertices.max(0), strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points[winding_number(vertices, faces, points) > 0.5]
    return points[_closest(points, vertices, faces)[0] > 1 / 40] if len(points) else points


def _hollow_share(vertices: NDArray[np.float64], faces: NDArray[np.int64], coarse: NDArray[np.float64]) -> float:
    """Share of the coarse solid that a closed mesh leaves empty; 0 where the solid has no thick part."""
    if len(coarse) < 20:
        return 0.0
    return float(np.mean(winding_number(vertices, faces, coarse) < 0.5))


def _alpha_wrap(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], offset: float
) -> tuple[NDArray[np.float64], NDArray[np.int64], str, float]:
    try:
        import pymeshlab
    except ImportError as error:
        raise ImportError('method "alpha_wrap" needs pymeshlab: pip install "touchnet[data]"') from error
    coarse = _coarse_solid(vertices, faces)
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    for alpha in (0.01, 0.03, 0.08):
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(vertices, faces.astype(np.int32)))
        meshes.generate_alpha_wrap(
            alpha=pymeshlab.PureValue(alpha * diagonal), offset=pymeshlab.PureValue(min(offset, alpha * diagonal / 4))
        )
        result = meshes.current_mesh()
        wrapped, wrapped_faces = result.vertex_matrix(), result.face_matrix().astype(np.int64)
        hollow = _hollow_share(wrapped, wrapped_faces, coarse)
        if hollow <= HOLLOW_SHARE:
            break
    return wrapped, wrapped_faces, f"alpha wrap {alpha}", hollow
