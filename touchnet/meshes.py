"""What touchnet promises of a mesh, checked, and cavities that no touch can have reached, filled."""

import numpy as np
import point_cloud_utils as pcu
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

__all__ = ["check_closed", "distances_to", "fill_cavities"]

AROUND = 8  # vertices near a point whose faces may hold the place closest to it


def check_closed(mesh: trimesh.Trimesh) -> None:
    """Checks that a mesh is the closed, oriented 2-manifold surface of a solid.

    That is: finite vertices, all of them used; each edge in exactly two faces that run through it in opposite
    directions; the faces around each vertex in one fan; no face without area; a positive volume.

    Raises:
        ValueError: one line that names the first promise broken and how often it is.
    """
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if not len(faces):
        raise ValueError("the mesh has no faces")
    broken = int((~np.isfinite(vertices)).any(axis=1).sum())
    if broken:
        raise ValueError(f"the mesh has {broken} vertices that are not finite")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(f"the mesh has faces that name vertices beyond its {len(vertices)}")
    unused = int((np.bincount(faces.reshape(-1), minlength=len(vertices)) == 0).sum())
    if unused:
        raise ValueError(f"the mesh has {unused} vertices without a face")

    fans = _count_fans(faces, len(vertices))
    if fans != len(vertices):
        raise ValueError(f"the mesh touches itself: {fans} fans of faces at {len(vertices)} vertices")

    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normals = _cross(b - a, c - a)
    flat = int((np.abs(normals).max(axis=1) <= 0).sum())
    if flat:
        raise ValueError(f"the mesh has {flat} of {len(faces)} faces without area")
    # About the middle, so that a small object far from the origin keeps its digits.
    volume = float(np.einsum("ij,ij->", a - vertices.mean(axis=0), normals) / 6)
    if not volume > 0:
        raise ValueError(f"the mesh is inside out: its volume is {volume:g}")


def distances_to(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Distances from points to the surface of a mesh whose faces are of about one size.

    Only the faces at the 8 vertices nearest to a point are looked at: exact next to the surface; elsewhere the result
    may be too large by a small part of itself. A tree of all faces takes twice as long for a large mesh, and needs the
    compiled extension, which a reconstruction can do without.

    Args:
        mesh: with at least one face.
        points: (N,3), finite.

    Returns:
        (N,)
    """
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    count = min(AROUND, len(vertices))
    to_vertex, near = cKDTree(vertices).query(points, k=count)
    to_vertex, near = to_vertex.reshape(len(points), count), near.reshape(len(points), count)
    used = np.zeros(len(vertices), dtype=bool)
    used[near] = True
    faces = mesh.faces[used[mesh.faces].any(axis=1)]
    at_vertex = coo_array(
        (np.ones(faces.size, dtype=np.int8), (faces.reshape(-1), np.arange(faces.size) // 3)),
        shape=(len(vertices), len(faces)),
    ).tocsr()
    at_point = coo_array(
        (np.ones(near.size, dtype=np.int8), (np.arange(near.size) // count, near.reshape(-1))),
        shape=(len(points), len(vertices)),
    ).tocsr()
    pairs = (at_point @ at_vertex).tocoo()
    closest = trimesh.triangles.closest_point(vertices[faces[pairs.col]], points[pairs.row])
    distances = to_vertex[:, 0].copy()
    np.fmin.at(distances, pairs.row, np.linalg.norm(closest - points[pairs.row], axis=1))
    return distances


def _count_fans(faces: np.ndarray, count: int) -> int:
    """The number of fans of faces around all `count` vertices.

    Raises:
        ValueError: an edge that has not exactly two faces, of opposite direction.
    """
    # Half-edge h runs from corner h of the flattened faces to the next corner of its face.
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    edge = np.minimum(start, end) * count + np.maximum(start, end)
    order = np.argsort(edge)
    ordered = edge[order]
    one, other = order[0::2], order[1::2]
    paired = len(edge) % 2 == 0 and (ordered[0::2] == ordered[1::2]).all() and (ordered[1:-1:2] != ordered[2::2]).all()
    if not paired:
        counts = np.unique(ordered, return_counts=True)[1]
        wrong = counts[counts != 2]
        raise ValueError(
            f"the mesh is not closed: {len(wrong)} of {len(counts)} edges have {wrong.min()} to {wrong.max()} faces "
            "instead of 2"
        )
    same = int((start[one] == start[other]).sum())
    if same:
        raise ValueError(f"the mesh has {same} edges that both of their faces run through in the same direction")

    # The half-edge before h in its face, turned round, leaves the vertex that h leaves: the next one of the fan.
    twin = np.empty_like(order)
    twin[one], twin[other] = other, one
    half_edges = np.arange(len(edge))
    step = twin[half_edges // 3 * 3 + (half_edges + 2) % 3]
    # Each cycle of `step` is a fan: find its smallest half-edge, by steps of doubling length.
    smallest = half_edges
    while True:
        lower = np.minimum(smallest, smallest[step])
        if (lower == smallest).all():
            return int((smallest == half_edges).sum())
        smallest, step = lower, step[step]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products (N,3); several times faster than numpy's."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


# A cavity whose walls at least this share of the contacts touched is real.
TOUCHED_SHARE = 0.02


def fill_cavities(
    vertices: np.ndarray, faces: np.ndarray, contacts: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, int]:
    """Drops the parts of a closed surface that bound enclosed cavities, and what floats inside those.

    A cavity without an opening cannot be touched from outside, so contacts say nothing about it. It is kept where
    contacts lie on its walls (simulated ones, or taken through a hole that the surface closes).

    Args:
        vertices: (V, 3) float64; faces: (F, 3) int64 of a closed, oriented 2-manifold wound outwards (`check_closed`).
        contacts: (N, 3) in the coordinates of the vertices.

    Returns:
        The vertices and faces that are left, in their order, and the number of cavities filled.
    """
    links = coo_array((np.ones(2 * len(faces), bool), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())))
    links.resize((len(vertices), len(vertices)))
    count, part_of_vertex = connected_components(links, directed=False)
    part = part_of_vertex[faces[:, 0]]
    # About a point of the part itself: far from the origin the terms of small parts would drown in rounding.
    first = np.full(count, len(vertices))
    np.minimum.at(first, part_of_vertex, np.arange(len(vertices)))
    a, b, c = (vertices[faces[:, k]] - vertices[first[part]] for k in range(3))
    volume = np.bincount(part, weights=np.einsum("ij,ij->i", a, np.cross(b, c)), minlength=count)
    cavity = volume < 0
    if cavity.any() and contacts is not None and len(contacts):
        nearest = part_of_vertex[cKDTree(vertices).query(contacts)[1]]
        cavity &= np.bincount(nearest, minlength=count) < TOUCHED_SHARE * len(contacts)
    if not cavity.any():
        return vertices, faces, 0
    walls = np.ascontiguousarray(faces[cavity[part]][:, ::-1])
    solid = np.flatnonzero(~cavity & (volume > 0))
    winding = pcu.triangle_soup_fast_winding_number(vertices, walls, vertices[first[solid]])
    dropped = cavity.copy()
    dropped[solid[np.asarray(winding) > 0.5]] = True
    kept = ~dropped[part_of_vertex]
    renumbered = np.cumsum(kept) - 1
    return vertices[kept], renumbered[faces[~dropped[part]]], int(cavity.sum())
