"""What a user would otherwise pick: reconstructions by maintained libraries, called as touchnet's own is."""

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, QhullError


def convex_hull(points: ArrayLike) -> trimesh.Trimesh:
    """The convex hull of points (N, 3), wound outwards: the floor that every method should beat.

    Raises:
        ValueError: the points lie in a plane, or are fewer than four.
    """
    points = _checked("points", points)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        raise ValueError(f"points have no convex hull: {len(points)} of them, or all in one plane") from None
    faces = np.array(hull.simplices)
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inwards] = faces[inwards, ::-1]
    used, faces = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(points[used], faces.reshape(-1, 3), process=False)


def screened_poisson(points: ArrayLike, normals: ArrayLike, *, depth: int = 8) -> trimesh.Trimesh:
    """Screened Poisson reconstruction (Kazhdan and Hoppe 2013) by pymeshlab.

    Args:
        points: (N, 3).
        normals: (N, 3), outwards.
        depth: of the octree: the finest cells are 1 / 2**depth of the box.

    Raises:
        ImportError: pymeshlab is missing.
        ValueError: the solver found no surface.
    """
    try:
        import pymeshlab
    except ImportError:
        raise ImportError("screened Poisson needs pymeshlab: pip install 'touchnet[data]'") from None
    points, normals = _checked("points", points), _checked("normals", normals)
    if points.shape != normals.shape:
        raise ValueError(f"normals must have the shape of points {points.shape}, got {normals.shape}")
    meshes = pymeshlab.MeshSet(verbose=False)
    try:
        meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=points, v_normals_matrix=normals))
        # Few exact contacts: one a cell and a strong pull to them do better than the defaults, which are for noisy
        # scans, and in a box 1.3 times as large the surface closes. One thread: the result does not vary.
        meshes.generate_surface_reconstruction_screened_poisson(
            depth=depth, samplespernode=1.0, pointweight=10.0, scale=1.3, threads=1
        )
        mesh = meshes.current_mesh()
        vertices, faces = mesh.vertex_matrix(), mesh.face_matrix()
    except pymeshlab.PyMeshLabException as error:
        raise ValueError(f"screened Poisson failed on {len(points)} points: {error}") from None
    if len(faces) == 0:
        raise ValueError(f"screened Poisson found no surface in {len(points)} points")
    return trimesh.Trimesh(vertices, faces, process=False)


def _checked(name: str, points: ArrayLike) -> NDArray[np.float64]:
    array = np.ascontiguousarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (N, 3), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got NaN or infinity")
    return array
