"""What a user would otherwise pick: reconstructions by maintained libraries, called as touchnet's own is."""

from typing import Any

import numpy as np
import torch
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull, Delaunay, QhullError, cKDTree

from touchnet import ops
from touchnet.contacts import thin
from touchnet.data.gp import GaussianProcess
from touchnet.frames import Frame
from touchnet.meshes import fill_cavities

# How far apart contacts lie is measured to the NEIGHBOURS-th nearest one, at the quantile SPARSE of the contacts:
# where a trajectory left gaps, not along its strokes. The scales below are in this unit.
NEIGHBOURS = 6
SPARSE = 0.9
ALPHA_SHAPE = 2.0
ALPHA_SHAPE_SIDE = 0.2  # at least this share of the longest side: contacts on a surface leave the inside empty
ALPHA_WRAP = 1.0
WRAP_OFFSET = 0.005  # share of the longest side
BALL = 1.0
GPIS_CONTACTS = 512  # more are thinned: with their offset points they make a matrix of 1536 rows
GPIS_LENGTH, SHELL_LENGTH = 0.6, 0.3  # length scales with and without normals in cube units (longest side 1.8)
GPIS_OFFSET = 0.02  # of the points inside and outside, in cube units
GPIS_NOISE = 1e-2
GPIS_COARSE = 16
GPIS_CHUNK = 4096  # queries at once: their covariances with 1536 points take 50 MB
SHELL_QUANTILE = 0.9


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


def spacing(points: ArrayLike) -> float:
    """How far apart contacts (N, 3) lie where they are sparse; 0 for fewer than two distinct ones."""
    points = np.unique(_checked("points", points), axis=0)
    if len(points) < 2:
        return 0.0
    distance, _ = cKDTree(points).query(points, k=min(NEIGHBOURS, len(points) - 1) + 1)
    return float(np.quantile(distance[:, -1], SPARSE))


def alpha_shape(points: ArrayLike, *, alpha: float | None = None) -> trimesh.Trimesh:
    """The boundary of the Delaunay tetrahedra with circumscribed spheres of radius below alpha, wound outwards.

    Every edge lies in an even number of faces; where two parts touch in an edge, it lies in four.

    Args:
        points: (N, 3).
        alpha: radius; by default in proportion to the spacing of the points, but not small against the whole.

    Raises:
        ValueError: the points lie in a plane, or no tetrahedron is small enough.
    """
    points = _checked("points", points)
    try:
        # A common offset costs digits in the lifted coordinates.
        centred = points - points.mean(axis=0) if len(points) else points
        tetrahedra = Delaunay(centred).simplices
    except (QhullError, ValueError):
        raise ValueError(f"points have no alpha shape: {len(points)} of them, or all in one plane") from None
    if alpha is None:
        alpha = max(ALPHA_SHAPE * spacing(points), ALPHA_SHAPE_SIDE * float(np.ptp(points, axis=0).max()))
    corners = centred[tetrahedra]  # (T, 4, 3)
    edges = corners[:, 1:] - corners[:, :1]
    volume = np.linalg.det(edges)
    solid = np.abs(volume) > 1e-12 * np.linalg.norm(edges, axis=2).max(axis=1, initial=0.0) ** 3
    tetrahedra, edges, volume = tetrahedra[solid], edges[solid], volume[solid]
    centre = np.linalg.solve(2 * edges, np.square(edges).sum(axis=2)[..., None])[..., 0]
    small = np.linalg.norm(centre, axis=1) < alpha
    tetrahedra, volume = tetrahedra[small], volume[small]
    faces = np.concatenate([tetrahedra[:, list(face)] for face in ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))])
    faces[np.tile(volume < 0, 4)] = faces[np.tile(volume < 0, 4)][:, ::-1]
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    faces = faces[first[count == 1]]
    if len(faces) == 0:
        raise ValueError(f"no tetrahedron of {len(points)} points has a circumscribed sphere smaller than {alpha:.3g}")
    used, faces = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(points[used], faces.reshape(-1, 3), process=False)


def alpha_wrap(points: ArrayLike, *, alpha: float | None = None) -> trimesh.Trimesh:
    """A closed surface shrunk around the points until a ball of radius alpha cannot pass between them (CGAL's alpha
    wrap by pymeshlab).

    Args:
        points: (N, 3).
        alpha: radius; by default in proportion to the spacing of the points.

    Raises:
        ImportError: pymeshlab is missing.
        ValueError: too few points.
    """
    pymeshlab = _pymeshlab("alpha wrap")
    points = _checked("points", points)
    alpha = ALPHA_WRAP * spacing(points) if alpha is None else alpha
    if len(points) < 4 or not alpha > 0:
        raise ValueError(f"alpha wrap needs 4 distinct points, got {len(points)}")
    side = float(np.ptp(points, axis=0).max())
    # The filter takes triangles only: each point becomes one too small to matter.
    tiny = 1e-6 * side
    corners = np.concatenate([points + tiny * corner for corner in np.eye(3)])
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=corners, face_matrix=np.arange(len(corners)).reshape(3, -1).T))
    return _filtered(
        "alpha wrap",
        meshes,
        "generate_alpha_wrap",
        points,
        alpha=pymeshlab.PureValue(alpha),
        offset=pymeshlab.PureValue(WRAP_OFFSET * side),
    )


def ball_pivoting(points: ArrayLike, normals: ArrayLike, *, radius: float | None = None) -> trimesh.Trimesh:
    """Ball pivoting (Bernardini et al. 1999) by pymeshlab: an open mesh, with the points as its vertices.

    Args:
        points: (N, 3).
        normals: (N, 3), outwards.
        radius: of the ball; by default in proportion to the spacing of the points.

    Raises:
        ImportError: pymeshlab is missing.
        ValueError: the ball rests on no three points.
    """
    pymeshlab = _pymeshlab("ball pivoting")
    points, normals = _checked("points", points), _checked("normals", normals)
    if points.shape != normals.shape:
        raise ValueError(f"normals must have the shape of points {points.shape}, got {normals.shape}")
    radius = BALL * spacing(points) if radius is None else radius
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=points, v_normals_matrix=normals))
    return _filtered(
        "ball pivoting",
        meshes,
        "generate_surface_reconstruction_ball_pivoting",
        points,
        ballradius=pymeshlab.PureValue(radius),
    )


def gaussian_process_surface(
    points: ArrayLike, normals: ArrayLike | None = None, *, resolution: int = 128
) -> trimesh.Trimesh:
    """The implicit surface of a Gaussian process over the contacts (eq. 6), extracted by touchnet's octree.

    With normals each contact brings a value outside and one inside, and the surface is where the mean is 0. Without
    them the mean is positive on both sides of the surface and tells no inside: then a thin shell around the contacts is
    taken, thick enough to close between most neighbours, and what it encloses is filled.

    Args:
        points: (N, 3); more than GPIS_CONTACTS are thinned evenly.
        normals: (N, 3), outwards.
        resolution: cells along the cube around the points.

    Raises:
        ValueError: fewer than 4 points, or no surface.
    """
    points = _checked("points", points)
    if normals is not None:
        normals = _checked("normals", normals)
        if normals.shape != points.shape:
            raise ValueError(f"normals must have the shape of points {points.shape}, got {normals.shape}")
    if len(np.unique(points, axis=0)) < 4:
        raise ValueError(f"a Gaussian process surface needs 4 distinct points, got {len(points)}")
    frame = Frame.fit(points)
    kept = thin(points, GPIS_CONTACTS)
    contacts = frame.to_cube(points[kept])
    length = SHELL_LENGTH if normals is None else GPIS_LENGTH
    process = GaussianProcess("matern52", length_scale=length, noise=GPIS_NOISE, mean=1.0)
    if normals is None:
        process.add(contacts)
        _, near = cKDTree(contacts).query(contacts, k=min(NEIGHBOURS, len(contacts) - 1) + 1)
        between = (contacts + contacts[near[:, -1]]) / 2
        level = -float(np.quantile(process.mean(between), SHELL_QUANTILE))
    else:
        process.add(contacts, normals=normals[kept], offset=GPIS_OFFSET)
        level = 0.0
    # The mean is smooth and the contacts seed its surface, so a coarse lattice is enough to find the rest.
    cube, faces = ops.octree_marching_cubes(
        lambda queries: -torch.from_numpy(process.mean(queries.numpy())),
        resolution=resolution,
        coarse=GPIS_COARSE,
        level=level,
        seeds=torch.from_numpy(contacts),
        chunk=GPIS_CHUNK,
        dtype=torch.float64,
    )
    vertices, corners = cube.numpy(), faces.numpy()
    if normals is None:
        vertices, corners, _ = fill_cavities(vertices, corners)
    return trimesh.Trimesh(frame.from_cube(vertices), corners, process=False)


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
    pymeshlab = _pymeshlab("screened Poisson")
    points, normals = _checked("points", points), _checked("normals", normals)
    if points.shape != normals.shape:
        raise ValueError(f"normals must have the shape of points {points.shape}, got {normals.shape}")
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertex_matrix=points, v_normals_matrix=normals))
    # Few exact contacts: one a cell and a strong pull to them do better than the defaults, which are for noisy scans,
    # and in a box 1.3 times as large the surface closes. One thread: the result does not vary.
    return _filtered(
        "screened Poisson",
        meshes,
        "generate_surface_reconstruction_screened_poisson",
        points,
        depth=depth,
        samplespernode=1.0,
        pointweight=10.0,
        scale=1.3,
        threads=1,
    )


def _pymeshlab(method: str) -> Any:
    try:
        import pymeshlab
    except ImportError:
        raise ImportError(f"{method} needs pymeshlab: pip install 'touchnet[baselines]'") from None
    return pymeshlab


def _filtered(
    method: str, meshes: Any, filter_name: str, points: NDArray[np.float64], **options: Any
) -> trimesh.Trimesh:
    """What a filter of pymeshlab makes; ValueError where it makes no face."""
    try:
        meshes.apply_filter(filter_name, **options)
    except _pymeshlab(method).PyMeshLabException as error:
        raise ValueError(f"{method} failed on {len(points)} points: {error}") from None
    mesh = meshes.current_mesh()
    vertices, faces = mesh.vertex_matrix(), mesh.face_matrix()
    if len(faces) == 0:
        raise ValueError(f"{method} found no surface in {len(points)} points")
    used, faces = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(vertices[used], faces.reshape(-1, 3), process=False)


def _checked(name: str, points: ArrayLike) -> NDArray[np.float64]:
    array = np.ascontiguousarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} must have shape (N, 3), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got NaN or infinity")
    return array
