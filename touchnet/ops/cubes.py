"""Marching cubes over a dense volume: a closed mesh from any finite field."""

import math
from typing import Any

import torch
from torch import Tensor

from touchnet.ops._ext import _C
from touchnet.ops._launch import launch, refuse_transforms
from touchnet.reference._extraction import (
    CROSSING_MARGIN,
    DEFAULT_BOX,
    Box,
    check_box,
    check_counts,
    check_level,
    check_resolved,
    check_volume,
    crossing,
    volume_normals,
)


def marching_cubes(
    volume: Tensor, level: float = 0.5, *, box: Box = DEFAULT_BOX, normals: bool = False
) -> tuple[Tensor, ...]:
    """Closed triangle mesh around the part of a volume where the value reaches the level.

    The outside of the box counts as outside the solid, so the mesh closes there, 0.001 of a spacing beyond the box. For
    every finite field each edge has exactly two faces, each vertex one fan, and no face is without area
    (docs/marching_cubes.md). The result does not depend on the number of threads (torch.get_num_threads).

    Args:
        volume: values (X,Y,Z), float32 or float64; value (i,j,k) belongs to the point lower + (i,j,k) * spacing.
        level: a point is inside where value >= level.
        box: lower and upper corner of the volume, where its first and last values lie.
        normals: also return the outward unit normal of every vertex: minus the gradient of the volume (central
            differences, one-sided at the faces of the box); where it vanishes, the mean of the faces around.

    Returns:
        vertices (V,3) float64, differentiable in `volume` (twice); a vertex held at 0.001 of its edge has no gradient.
        faces (F,3) int64, counter-clockwise seen from outside.
        normals (V,3) float64, only where asked for.

    Raises:
        TypeError: volume is not a float32 or float64 tensor.
        ValueError: wrong shape, values that are not finite, or none that reaches the level.

    Example:
        >>> volume = torch.zeros(3, 3, 3)
        >>> volume[1, 1, 1] = 1  # one inside point: an octahedron around it
        >>> vertices, faces = touchnet.ops.marching_cubes(volume)
        >>> len(vertices), len(faces)
        (6, 8)
    """
    refuse_transforms("marching_cubes")
    lower, upper = check_box(box)
    level = check_level(level)
    volume = check_volume(volume)
    spacing = (upper - lower) / (torch.tensor(volume.shape, dtype=torch.float64) - 1)
    check_resolved(lower, upper, spacing)
    with_edges = normals or (volume.requires_grad and torch.is_grad_enabled())
    vertices, faces, low, axis = _MarchingCubes.apply(volume, level, lower.tolist(), spacing.tolist(), with_edges)
    if not normals:
        return vertices, faces
    return vertices, faces, volume_normals(volume, level, box, vertices, faces, low, axis.long())


class _MarchingCubes(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, volume: Tensor, level: float, lower: list[float], spacing: list[float], with_edges: bool
    ) -> tuple[Tensor, Tensor, Tensor | None, Tensor | None]:
        # low (V,): index in the flat volume of the lower end of a vertex's edge, -1 where the edge leaves the box.
        # axis (V,): the edge's direction.
        extract = _extract if volume.device.type == "cpu" else _extract_on_gpu
        vertices, faces, low, axis = extract(volume.contiguous(), level, lower, spacing, with_edges)
        ctx.save_for_backward(volume, low, axis)
        ctx.level, ctx.spacing = level, spacing
        ctx.mark_non_differentiable(*(t for t in (faces, low, axis) if t is not None))
        return vertices, faces, low, axis

    @staticmethod
    def backward(ctx: Any, grad_vertices: Tensor, *_: Any) -> tuple[Tensor | None, ...]:
        # In torch operations, so that it can be differentiated again.
        volume, low, axis = ctx.saved_tensors
        real = low >= 0
        low, axis = low[real], axis[real].long()
        high = low + volume.new_tensor(_strides(volume), dtype=torch.long)[axis]
        a, b = volume.reshape(-1)[low].double(), volume.reshape(-1)[high].double()
        t = crossing(a, b, ctx.level)
        free = (t > CROSSING_MARGIN) & (t < 1 - CROSSING_MARGIN)
        along = grad_vertices[real].gather(1, axis[:, None])[:, 0] * grad_vertices.new_tensor(ctx.spacing)[axis]
        rate = torch.where(free, along / (b - a), 0.0)
        grad = torch.zeros(volume.numel(), dtype=volume.dtype, device=volume.device)
        grad = grad.index_add(0, low, (rate * (t - 1)).to(volume.dtype)).index_add(
            0, high, (-rate * t).to(volume.dtype)
        )
        return grad.view(volume.shape), None, None, None, None


def _strides(volume: Tensor) -> tuple[int, int, int]:
    return volume.shape[1] * volume.shape[2], volume.shape[2], 1


def _extract(
    volume: Tensor, level: float, lower: list[float], spacing: list[float], with_edges: bool
) -> tuple[Tensor, Tensor, Tensor | None, Tensor | None]:
    kind = _C.DenseCubesFloat if volume.dtype == torch.float32 else _C.DenseCubesDouble
    cubes = kind(volume.data_ptr(), tuple(volume.shape), lower, spacing, level, torch.get_num_threads())
    vertex_count, face_count, not_finite = cubes.count()
    check_counts(volume, level, not_finite, vertex_count)
    return emit_mesh(cubes, vertex_count, face_count, with_edges)


def _extract_on_gpu(
    volume: Tensor, level: float, lower: list[float], spacing: list[float], with_edges: bool
) -> tuple[Tensor, Tensor, Tensor | None, Tensor | None]:
    """The same by the CUDA kernels, with vertices and faces in the order of the points they start from."""
    source = volume.data_ptr(), tuple(volume.shape), lower, spacing, level
    count = math.prod(n + 1 for n in volume.shape)  # points and cells with the layer around the box
    edges, triangles = torch.empty(2, count, dtype=torch.int32, device=volume.device)
    launch("cube_counts", volume, *source, edges.data_ptr(), triangles.data_ptr())
    vertices_until, faces_until = edges.cumsum(0), triangles.cumsum(0)
    vertex_count, face_count = int(vertices_until[-1]), int(faces_until[-1])
    check_counts(volume, level, int((~volume.isfinite()).sum()), vertex_count)
    vertices = torch.empty(vertex_count, 3, dtype=torch.float64, device=volume.device)
    faces = torch.empty(face_count, 3, dtype=torch.long, device=volume.device)
    low = torch.empty(vertex_count, dtype=torch.long, device=volume.device)
    axis = torch.empty(vertex_count, dtype=torch.uint8, device=volume.device)
    outputs = (tensor.data_ptr() for tensor in (vertices, low, axis))
    launch("cube_vertices", volume, *source, vertices_until.data_ptr(), *outputs)
    launch("cube_faces", volume, *source, vertices_until.data_ptr(), faces_until.data_ptr(), faces.data_ptr())
    return (vertices, faces, low, axis) if with_edges else (vertices, faces, None, None)


def emit_mesh(
    cubes: Any, vertex_count: int, face_count: int, with_edges: bool
) -> tuple[Tensor, Tensor, Tensor | None, Tensor | None]:
    """Vertices (V,3), faces (F,3), and where asked for the lower end (V,) and the axis (V,) of every vertex's edge."""
    vertices = torch.empty(vertex_count, 3, dtype=torch.float64)
    faces = torch.empty(face_count, 3, dtype=torch.long)
    if not with_edges:
        cubes.emit(vertices.data_ptr(), faces.data_ptr(), 0, 0)
        return vertices, faces, None, None
    low = torch.empty(vertex_count, dtype=torch.long)
    axis = torch.empty(vertex_count, dtype=torch.uint8)
    cubes.emit(vertices.data_ptr(), faces.data_ptr(), low.data_ptr(), axis.data_ptr())
    return vertices, faces, low, axis
