"""Points into a volume and back, in plain torch: the specification of touchnet.ops.gridding and gridding_reverse."""

import torch
from torch import Tensor

from touchnet.reference import _cells, _checks

LEAST_WEIGHT = 1e-6  # a cell of less has no point


def gridding(
    points: Tensor,
    size: int | tuple[int, int, int],
    *,
    values: Tensor | None = None,
    memory_format: torch.memory_format = torch.contiguous_format,
) -> Tensor:
    """See touchnet.ops.gridding."""
    size = _checks.check_gridding(points, size, values, memory_format)
    points, values = _checks.full_precision(points, values)
    _checks.check_dtypes({"points": points} if values is None else {"points": points, "values": values})

    inside = ((points >= -1) & (points <= 1)).all(-1)  # (B, N); False for NaN
    cells = _cells.locate(torch.where(inside[..., None], points, torch.zeros_like(points)), size)
    # (B, 1 + K, N): what each point spreads
    spread = (
        torch.ones_like(points[..., :1])
        if values is None
        else torch.cat([torch.ones_like(points[..., :1]), values], -1)
    )
    spread = torch.where(inside[..., None], spread, torch.zeros_like(spread)).transpose(1, 2)
    volume = spread.new_zeros(*spread.shape[:2], size[0] * size[1] * size[2])
    for vertices, weight in _cells.corners(cells):
        vertex = _cells.flat(vertices, size)[:, None].expand(spread.shape)  # (B, 1 + K, N)
        volume = volume.scatter_add(2, vertex, weight[:, None] * spread)
    return volume.unflatten(2, size).contiguous(memory_format=memory_format)


def gridding_reverse(volume: Tensor, *, fill: float = 0.0) -> Tensor:
    """See touchnet.ops.gridding_reverse."""
    volume = _checks.check_density(volume)
    size = tuple(volume.shape[2:])
    density = volume[:, 0]
    corner_weights = []  # of each cell: (B, X - 1, Y - 1, Z - 1)
    for corner in range(8):
        i, j, k = corner >> 2 & 1, corner >> 1 & 1, corner & 1
        corner_weights.append(density[:, i : size[0] - 1 + i, j : size[1] - 1 + j, k : size[2] - 1 + k])
    total = sum(corner_weights)
    filled = total >= LEAST_WEIGHT
    safe = torch.where(filled, total, torch.ones_like(total))
    coordinates = []
    for axis, n in enumerate(size):
        upper = sum(weight for corner, weight in enumerate(corner_weights) if corner >> (2 - axis) & 1)
        lower_vertex = _cells.vertex_coordinates(n, dtype=volume.dtype, device=volume.device)[:-1]
        lower_vertex = lower_vertex.view([-1 if a == axis else 1 for a in range(3)])
        coordinates.append(lower_vertex + 2 / (n - 1) * (upper / safe))
    points = torch.stack(coordinates, -1)
    points = torch.where(filled[..., None], points, torch.full_like(points, fill))
    return torch.nn.functional.pad(points, (0, 0, 0, 1, 0, 1, 0, 1), value=fill).flatten(1, 3)
