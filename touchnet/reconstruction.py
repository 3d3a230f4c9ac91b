"""From contacts to a closed mesh in the contacts' own frame."""

from __future__ import annotations

import functools
import os
import warnings
from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple

import numpy as np
import torch
import trimesh
from torch import Tensor, nn

from touchnet import ops
from touchnet.confidence import TOLERANCE, expected_error, vertex_normals, within
from touchnet.contacts import check_contacts, check_outward, check_spread, thin
from touchnet.device import pick_device
from touchnet.frames import Frame, find_outliers
from touchnet.meshes import distances_to, fill_cavities

__all__ = ["reconstruct_field", "reconstruct_mesh"]

Up = Literal["x", "y", "z"] | None
Field = Callable[[Tensor], Tensor]

# Rows of the rotation from the input's axes to those of the model's cube, which is y-up.
_TO_Y_UP = {
    None: np.eye(3),
    "y": np.eye(3),
    "z": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "x": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
}


class Fitted(NamedTuple):
    """What one cube gives: the mesh, the expected errors (V,) at its vertices, the features of the contacts."""

    mesh: trimesh.Trimesh
    error: np.ndarray
    features: list[Tensor]


MAX_TOUCHES = 8192  # four times what models are trained with; more contacts are thinned
REFIT = 1.25  # how much larger the cube gets when the surface meets its faces
FAR = 0.03  # distance of contacts from the surface, as a share of the longest side, that earns a warning
CHUNK = 1 << 17  # queries a batch: their features take about 100 MB


def reconstruct_mesh(
    points: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    up: Up = None,
    weights: str | os.PathLike[str] | nn.Module = "default",
    resolution: int = 256,
    device: str | torch.device = "auto",
    level: float = 0.5,
    keep_cavities: bool = False,
    max_touches: int = MAX_TOUCHES,
    tolerance: float | None = None,
) -> trimesh.Trimesh:
    """Reconstructs the closed surface of the object that was touched.

    The contacts are mapped into the model's cube by `Frame.fit`, encoded once, and the occupancy is extracted around
    its surface, with the contacts as seeds so that no touched part is lost. If the surface meets the faces of the cube,
    all is done once more in a larger cube. No random numbers are drawn; the order of the contacts does not matter (up
    to rounding).

    Args:
        points: (N,3) contacts in any unit and offset, at least 4 distinct ones, all finite. Contacts that lie far from
            all others are left out (`touchnet.frames.find_outliers`).
        normals: (N,3) outward directions at the contacts; a row of zeros where one is not known.
        up: which axis of the input points up; `None` assumes nothing.
        weights: the name of weights in the package, the path of a safetensors file, or a model (it is moved to the
            device and put into evaluation mode).
        resolution: cells along the cube, whose side is 1.11 times the longest side of the box of the contacts.
        device: "cpu", "cuda", or "auto": CUDA where there is a device and a build for it.
        level: the occupancy at the surface.
        keep_cavities: keep enclosed cavities that no contact lies on.
        max_touches: more contacts than this are thinned evenly over the surface (`thin`).
        tolerance: the error, in the unit of the input, that "confidence" is about; None: 1 % of the longest side of the
            box of the contacts.

    Returns:
        A mesh in the frame and unit of the input, float64, outward winding, not processed (no vertex merged). Its
        `vertex_attributes`, float32 (V,), say how far to trust it: "expected_error", the mean distance at which to
        expect the true surface from a vertex, in the unit of the input, and "confidence", the probability that this
        distance is within the tolerance (`touchnet.confidence`). Its `metadata` say how it came about: "cell" (the
        side of a cell in the input's unit), "frame", "contacts" (used), "outliers" (left out), "cavities" (filled),
        "refitted", "meets_border", "distance" (median, from the contacts to the surface), "tolerance".

    Raises:
        ValueError: contacts that are too few, on a line or not finite; no surface at the level; normals or options that
            do not fit; coordinates too far from the origin for float64.

    Warns:
        UserWarning: outliers left out, contacts in a plane, normals that point inwards, a surface that meets the cube
            or is far from the contacts.
    """
    return reconstruct_with_field(
        points,
        normals=normals,
        up=up,
        weights=weights,
        resolution=resolution,
        device=device,
        level=level,
        keep_cavities=keep_cavities,
        max_touches=max_touches,
        tolerance=tolerance,
    ).mesh


class Reconstruction(NamedTuple):
    """A mesh as `reconstruct_mesh` returns it, and the field it is a level of.

    Attributes:
        field: from points (M,3) of the object to occupancy (M,) float64.
        normals: from contacts (M,3) to estimates of their normals (M,3), None of networks that make none.
    """

    mesh: trimesh.Trimesh
    field: Callable[[np.ndarray], np.ndarray]
    normals: Callable[[np.ndarray], np.ndarray] | None = None


def reconstruct_with_field(
    points: np.ndarray,
    *,
    normals: np.ndarray | None,
    up: Up,
    weights: str | os.PathLike[str] | nn.Module,
    resolution: int,
    device: str | torch.device,
    level: float,
    keep_cavities: bool = False,
    max_touches: int = MAX_TOUCHES,
    tolerance: float | None = None,
    guess: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Reconstruction:
    """`reconstruct_mesh` for callers that have more questions to the field.

    Args:
        guess: `Reconstruction.normals` of most of these contacts, which saves time: the estimates begin there.
    """
    points, directions = check_contacts(points, normals)
    if up not in _TO_Y_UP:
        raise ValueError(f'up should be "x", "y", "z" or None, got {up!r}')
    if tolerance is not None and not (np.isfinite(tolerance) and tolerance > 0):
        raise ValueError(f"tolerance should be a length above 0, got {tolerance}")
    device = pick_device(device)
    outliers = find_outliers(points)
    if outliers.any():
        first = int(np.flatnonzero(outliers)[0])
        shown = ", ".join(f"{x:g}" for x in points[first])
        warnings.warn(
            f"{int(outliers.sum())} of {len(points)} contacts lie far from all others and are left out "
            f"(the first: contact {first + 1} at {shown})",
            stacklevel=3,
        )
        points = points[~outliers]
        directions = None if directions is None else directions[~outliers]
    check_spread(points)
    if directions is not None:
        check_outward(points, directions)
    frame = Frame.fit(points, reject_outliers=False)
    if len(points) > max_touches:
        kept = thin(points, max_touches)
        points = points[kept]
        directions = None if directions is None else directions[kept]

    model = ready_model(weights, device)
    turned = None if directions is None else directions @ _TO_Y_UP[up].T

    def decode(features: list[Tensor], queries: Tensor) -> Tensor:
        with torch.inference_mode():
            return model.decode(features, queries[None])[0].float()

    def fit(frame: Frame) -> Fitted:
        touches = frame.to_cube(points) @ _TO_Y_UP[up].T
        begin = {} if guess is None else {"guess": _batch(guess(points) @ _TO_Y_UP[up].T, device)}
        with torch.inference_mode():
            features = model.encode(
                _batch(touches, device), None if turned is None else _batch(turned, device), **begin
            )
        field = functools.partial(decode, features)
        mesh = reconstruct_field(
            field,
            frame,
            up=up,
            keep_cavities=keep_cavities,
            resolution=resolution,
            level=level,
            seeds=points,
            device=device,
            dtype=torch.float32,
        )
        vertices, normals = (
            rows @ _TO_Y_UP[up].T for rows in (frame.to_cube(mesh.vertices), vertex_normals(mesh.vertices, mesh.faces))
        )
        error = frame.scale * expected_error(field, vertices, normals, touches, level=level, device=device)
        return Fitted(mesh, error, features)

    fitted, refitted = fit(frame), False
    if fitted.mesh.metadata["meets_border"]:
        fitted, refitted = _refit(fitted, fit, frame.enlarged(REFIT))
    mesh, error, features = fitted
    distance = float(np.median(distances_to(mesh, points)))
    longest = float(np.ptp(points, axis=0).max())
    if distance > FAR * longest:
        warnings.warn(
            f"half of the contacts lie more than {distance:.3g} from the surface, {distance / longest:.0%} of their "
            "longest side: these contacts do not look like the surface of an object that the model knows",
            stacklevel=3,
        )
    tolerance = TOLERANCE * longest if tolerance is None else float(tolerance)
    mesh.vertex_attributes["expected_error"] = error.astype(np.float32)
    mesh.vertex_attributes["confidence"] = within(error, tolerance).astype(np.float32)
    mesh.metadata.update(
        contacts=len(points), outliers=int(outliers.sum()), refitted=refitted, distance=distance, tolerance=tolerance
    )
    cube = mesh.metadata["frame"]

    def in_cube(places: np.ndarray) -> Tensor:
        return _batch(cube.to_cube(places) @ _TO_Y_UP[up].T, device)

    def occupancy(queries: np.ndarray) -> np.ndarray:
        return decode(features, in_cube(queries)[0]).double().cpu().numpy()

    def estimated_normals(contacts: np.ndarray) -> np.ndarray:
        with torch.inference_mode():
            return model.normals_of(features, in_cube(contacts))[0].double().cpu().numpy() @ _TO_Y_UP[up]

    return Reconstruction(mesh, occupancy, estimated_normals if getattr(model, "estimates_normals", False) else None)


def reconstruct_field(
    field: Field,
    frame: Frame,
    *,
    resolution: int | Sequence[int] = 256,
    level: float = 0.5,
    seeds: np.ndarray | None = None,
    up: Up = None,
    keep_cavities: bool = False,
    device: str | torch.device = "cpu",
    dtype: torch.dtype = torch.float64,
    chunk: int = CHUNK,
) -> trimesh.Trimesh:
    """Extracts the surface of any occupancy field in the cube and maps it back to the object's frame.

    Args:
        field: cube coordinates (M,3), y up, to values (M,), high inside.
        frame: the map from the object to the cube (before the turn that `up` asks for).
        resolution: cells along each side of the cube [-1,1]^3, or (x, y, z).
        level: the value at the surface; inside is value ≥ level.
        seeds: (N,3) points near the surface, in the object's frame.
        up: which axis of the object's frame points up; the mesh is turned back.
        keep_cavities: keep enclosed cavities that no seed lies on (`fill_cavities`).
        device, dtype: of the points handed to the field.
        chunk: most points in one call.

    Returns:
        As `reconstruct_mesh`; metadata "cell", "frame", "cavities" (filled) and
        "meets_border" (the solid is cut by the cube's faces).

    Raises:
        ValueError: no surface, values that are not finite, or coordinates too far from the origin for float64.
    """
    if up not in _TO_Y_UP:
        raise ValueError(f'up should be "x", "y", "z" or None, got {up!r}')
    if np.min(resolution) < 1:
        raise ValueError(f"resolution should be at least 1, got {resolution}")
    turn = _TO_Y_UP[up]
    cell = 2.0 / float(np.max(resolution)) * frame.scale
    # Vertices of one cell may lie a thousandth of its side apart.
    largest = float(np.abs(frame.centre).max()) + frame.scale
    if 1e-3 * cell < 8 * np.spacing(largest):
        raise ValueError(
            f"float64 steps of {np.spacing(largest):.3g} at the coordinate {largest:.3g} are too coarse for cells of "
            f"{cell:.3g}: move the object nearer to the origin"
        )
    if seeds is not None:
        seeds = torch.from_numpy(np.ascontiguousarray(frame.to_cube(seeds) @ turn.T))
    vertices, faces = ops.octree_marching_cubes(
        field, resolution=resolution, level=level, seeds=seeds, chunk=chunk, device=device, dtype=dtype
    )
    cube, corners, cavities = vertices.numpy(), faces.numpy(), 0
    if not keep_cavities:
        cube, corners, cavities = fill_cavities(cube, corners, None if seeds is None else seeds.numpy())
    mesh = trimesh.Trimesh(frame.from_cube(cube @ turn), corners, process=False, validate=False)
    # The vertices that close the mesh at a face of the cube lie just outside of it.
    mesh.metadata.update(cell=cell, frame=frame, cavities=cavities, meets_border=bool((np.abs(cube) > 1).any()))
    return mesh


def ready_model(weights: str | os.PathLike[str] | nn.Module, device: torch.device) -> nn.Module:
    """The model itself, or the one of that name or file: on the device, in evaluation mode."""
    if isinstance(weights, nn.Module):
        return weights.to(device).eval()
    from touchnet.weights import load_model

    return load_model(weights, device=device)


def _batch(rows: np.ndarray, device: torch.device) -> Tensor:
    return torch.from_numpy(rows).to(device=device, dtype=torch.float32)[None]


def _refit(fitted: Fitted, fit: Callable[[Frame], Fitted], frame: Frame) -> tuple[Fitted, bool]:
    """What a larger cube gives, or what is given where there is nothing; and which of them it is."""
    try:
        again = fit(frame)
    except ValueError as error:
        warnings.warn(f"the surface is cut off at the cube; in a larger cube: {error}", stacklevel=4)
        return fitted, False
    meets = again.mesh.metadata["meets_border"]
    still = "; it meets the larger cube too and is cut off flat there" if meets else ""
    warnings.warn(
        f"the surface met the faces of the cube and was fitted again in one {REFIT} times as large{still}", stacklevel=4
    )
    return again, True
