"""Points into a volume and back, in plain torch: the specification of touchnet.ops.gridding and gridding_reverse."""

import torch
from torch import Tensor

from touchnet.reference import _cells, _checks


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
