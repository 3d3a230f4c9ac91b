"""The map between coordinates and vertices (csrc/cell.h) in torch."""

from typing import NamedTuple

import torch
from torch import Tensor


class Cells(NamedTuple):
    """The cells of points (..., 3)."""

    index: Tensor  # (..., 3) int64: the cell's lower vertex along each axis, 0 ... n - 2
    t: Tensor  # (..., 3): weight of the upper vertex, 0 ... 1; differentiable in the points


def vertex_coordinates(n: int, *, dtype: torch.dtype, device: torch.device | str = "cpu") -> Tensor:
    """(n,): coordinate of each vertex along an axis, -1 + 2 i / (n - 1)."""
    return -1 + 2 * torch.arange(n, dtype=dtype, device=device) / (n - 1)


def locate(points: Tensor, size: tuple[int, int, int]) -> Cells:
    """Cells of finite points (..., 3) in a volume of `size` vertices; coordinates are clamped to [-1, 1].

    A coordinate within one epsilon of a vertex lies on it, so that a vertex reads back exactly.
    """
    n = torch.tensor(size, device=points.device)
    half = (n - 1).to(points.dtype) * 0.5
    clamped = points.clamp(-1, 1)
    index = torch.minimum(((clamped.detach() + 1) * half).long(), n - 2)
    lower = -1 + (2 * index).to(points.dtype) / (n - 1).to(points.dtype)
    t = (clamped - lower) * half
    snap = half * torch.finfo(points.dtype).eps
    snapped = torch.where(t < snap, torch.zeros_like(t), torch.where(t > 1 - snap, torch.ones_like(t), t))
    return Cells(index, t + (snapped - t).detach())


def corners(cells: Cells) -> list[tuple[Tensor, Tensor]]:
    """The eight corners of each cell, numbered 4 di + 2 dj + dk: vertex index (..., 3) and trilinear weight (...)."""
    result = []
    for corner in range(8):
        offset = torch.tensor([corner >> 2 & 1, corner >> 1 & 1, corner & 1], device=cells.t.device)
        x, y, z = torch.where(offset == 1, cells.t, 1 - cells.t).unbind(-1)
        result.append((cells.index + offset, x * y * z))
    return result


def flat(vertices: Tensor, size: tuple[int, int, int]) -> Tensor:
    """Row-major number of vertices (..., 3) in a volume of `size`."""
    i, j, k = vertices.unbind(-1)
    return (i * size[1] + j) * size[2] + k
