"""Marching cubes around the surface only, from a field that is queried in batches of points."""

from collections.abc import Sequence

import torch
from torch import Tensor

from touchnet.ops._ext import _C
from touchnet.ops.cubes import emit_mesh
from touchnet.reference._extraction import (
    DEFAULT_BOX,
    Box,
    Field,
    Queries,
    attach_gradient,
    check_level,
    check_octree,
    no_surface,
    unit_normals,
)


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
    """Closed triangle mesh around the part of a box where a field reaches the level.

    The field is evaluated on a coarse lattice, along the coarse edges whose two ends disagree, and at the corners of
    the fine cells that the surface crosses: it is followed from cell to cell. No point is evaluated twice (but for
    gradients). The result equals marching_cubes on the dense lattice, up to the order of vertices and faces, on every
    connected part of the surface that crosses such a coarse edge or that a seed finds. A part that lies between the
    coarse points and away from the seeds is not found at all, never half of it. Memory grows with the surface. The
    promise of marching_cubes (closed, manifold, no face without area) holds for every finite field.

    Args:
        field: points (M,3) of `dtype` on `device` to their values (M,), float32 or float64, high inside. Called many
            times, without gradients except for `differentiable` and `normals`.
        resolution: cells along the longest side of the box (cells are cubes, up to rounding of the shorter sides), or
            cells along each axis.
        level: a point is inside where value >= level.
        box: lower and upper corner; outside of it counts as outside the solid.
        coarse: about how many cells of the coarse lattice along the longest axis.
        seeds: points (N,3) near the surface; the cells around each are opened, and up to one coarse step (at most 16
            cells) along each axis from it.
        chunk: most points in one call of the field.
        dtype, device: of the points handed to the field.
        differentiable: vertices carry gradients into the parameters of the field (the end points of the crossed edges
            are evaluated again, with gradients).
        normals: also return outward unit normals, minus the gradient of the field by autograd at the vertices.

    Returns:
        vertices (V,3) float64, faces (F,3) int64, both on the CPU; normals (V,3) float64 where asked for.

    Raises:
        TypeError, ValueError: arguments or values of the wrong type or shape, values that are not finite, or none that
            reaches the level.

    Example:
        >>> ball = lambda points: 1 - points.norm(dim=1)  # 0.5 at the radius 0.5
        >>> vertices, faces = touchnet.ops.octree_marching_cubes(ball, resolution=64, coarse=16)
        >>> bool((vertices.norm(dim=1) - 0.5).abs().max() < 1e-3)
        True
    """
    level = check_level(level)
    lower, spacing, cells, seeds = check_octree(resolution, box, coarse, chunk, dtype, seeds)
    query = Queries(field, dtype, device, chunk)

    stride = -(-max(cells) // coarse)
    points = tuple(n + 1 for n in cells)
    cubes = _C.OctreeCubes(points, lower.tolist(), spacing.tolist(), level, stride, torch.get_num_threads())
    if seeds is not None:
        cubes.add_seeds(seeds.data_ptr(), len(seeds))
    while pending := cubes.pending():
        for begin in range(0, pending, chunk):
            count = min(chunk, pending - begin)
            batch = torch.empty(count, 3, dtype=dtype)
            cubes.write_points(begin, count, batch.data_ptr(), dtype == torch.float64)
            values = query(batch)
            cubes.read_values(begin, count, values.data_ptr(), values.dtype == torch.float64)
        cubes.advance()

    vertex_count, face_count, minimum, maximum = cubes.count()
    if not vertex_count:
        raise no_surface(level, minimum, maximum)
    vertices, faces, low, axis = emit_mesh(cubes, vertex_count, face_count, differentiable)
    del cubes
    if low is not None and axis is not None:
        vertices = attach_gradient(query, vertices, low, axis.long(), cells, lower, spacing, level)
    if not normals:
        return vertices, faces
    directions = -query.gradient(vertices.detach())
    return vertices, faces, unit_normals(directions, vertices.detach(), faces)
