"""What touchnet promises of a mesh, checked."""

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

__all__ = ["check_closed"]


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
    unused = len(vertices) - len(np.unique(faces))
    if unused:
        raise ValueError(f"the mesh has {unused} vertices without a face")

    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    directed = start * len(vertices) + end
    undirected = np.minimum(start, end) * len(vertices) + np.maximum(start, end)
    order = np.argsort(undirected, kind="stable")
    keys, counts = np.unique(undirected, return_counts=True)
    wrong = int((counts != 2).sum())
    if wrong:
        raise ValueError(
            f"the mesh is not closed: {wrong} of {len(keys)} edges have {counts[counts != 2].min()} to "
            f"{counts[counts != 2].max()} faces instead of 2"
        )
    if len(np.unique(directed)) != len(directed):
        raise ValueError("the mesh has edges that both of their faces run through in the same direction")

    # Corners (face, vertex) that share an edge at the same vertex belong to one fan.
    first, second = order[0::2], order[1::2]  # half-edges of opposite direction; half-edge h starts at corner h

    def following(half_edge: np.ndarray) -> np.ndarray:
        return half_edge // 3 * 3 + (half_edge + 1) % 3

    rows = np.concatenate([first, following(first)])
    columns = np.concatenate([following(second), second])
    links = coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(len(start), len(start)))
    fans = connected_components(links, directed=False)[0]
    if fans != len(vertices):
        raise ValueError(f"the mesh touches itself: {fans} fans of faces at {len(vertices)} vertices")

    corners = vertices[faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    flat = int((areas <= 0).sum())
    if flat:
        raise ValueError(f"the mesh has {flat} of {len(faces)} faces without area")
    # About the middle, so that a small object far from the origin keeps its digits.
    corners = corners - vertices.mean(axis=0)
    volume = float(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6)
    if not volume > 0:
        raise ValueError(f"the mesh is inside out: its volume is {volume:g}")
