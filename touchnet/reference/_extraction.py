"""What the extractions share, compiled or reference: checks, where the surface crosses an edge, queries, normals."""

import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from touchnet.reference._checks import FLOATING, check_dtypes, check_tensor, describe, full_precision

Field = Callable[[Tensor], Tensor]
Box = Sequence[Sequence[float]] | Tensor
Cells = tuple[int, int, int]

DEFAULT_BOX: Box = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))  # the cube in which gridding and the samplers work

# A crossing keeps this fraction of its edge from both ends, so that no two vertices ever coincide ...
CROSSING_MARGIN = 1e-3
# ... which takes this many units in the last place of a coordinate.
RESOLVED_ULPS = 8
MOST_CELLS = 1 << 20  # along an axis


def check_box(box: Box) -> tuple[Tensor, Tensor]:
    """Lower and upper corner of a box, float64 (3,) each. ValueError unless finite and of positive extent."""
    corners = torch.as_tensor(box, dtype=torch.float64, device="cpu")
    if corners.shape != (2, 3):
        raise ValueError(f"box: expected two corners of three coordinates, (2, 3), got shape {tuple(corners.shape)}")
    lower, upper = corners
    if not bool(corners.isfinite().all()) or not bool((lower < upper).all()):
        raise ValueError(f"box: expected finite corners, lower < upper, got {lower.tolist()} and {upper.tolist()}")
    return lower, upper


def check_level(level: float) -> float:
    """The level as a float. ValueError unless finite."""
    if not math.isfinite(level):
        raise ValueError(f"level: expected a finite number, got {level}")
    return float(level)


def check_volume(volume: object) -> Tensor:
    """A volume (X,Y,Z) to extract from, in float32 where autocast asks for it."""
    check_tensor("volume", volume, ("X", "Y", "Z"))
    if min(volume.shape) < 2 or max(volume.shape) > MOST_CELLS:
        raise ValueError(f"volume: expected (X, Y, Z) of 2 to {MOST_CELLS} values each, got {tuple(volume.shape)}")
    (volume,) = full_precision(volume)
    check_dtypes({f"volume of shape {tuple(volume.shape)}": volume})
    return volume


def check_counts(volume: Tensor, level: float, not_finite: int, vertices: int) -> None:
    """ValueError where the volume holds values that are not finite, or no surface."""
    if not_finite:
        raise ValueError(f"volume: expected finite values, got {not_finite} NaN or infinite ones of {volume.numel()}")
    if not vertices:
        raise no_surface(level, volume.min().item(), volume.max().item())


def no_surface(level: float, minimum: float, maximum: float) -> ValueError:
    """The error of a field that is outside everywhere."""
    return ValueError(
        f"no surface: no value of the field reaches level {level:g} (minimum {minimum:g}, maximum {maximum:g})"
    )


def check_resolved(lower: Tensor, upper: Tensor, spacing: Tensor, points: torch.dtype = torch.float64) -> None:
    """ValueError where float64 cannot tell two vertices apart, or the dtype of the points two lattice points."""
    largest = torch.maximum(lower.abs(), upper.abs())
    for dtype, distance in ((torch.float64, CROSSING_MARGIN * spacing), (points, spacing)):
        if bool((distance < RESOLVED_ULPS * torch.finfo(dtype).eps * largest).any()):
            raise ValueError(
                f"box: {lower.tolist()} to {upper.tolist()} with a spacing of {spacing.min():.3g} is too far from the "
                f"origin for coordinates in {dtype}; move it nearer, use fewer cells, or points in float64"
            )
    if bool((spacing < 1e-100).any()) or bool((spacing > 1e100).any()):
        raise ValueError(f"box: expected a spacing of 1e-100 to 1e100, got {spacing.tolist()}")


def check_octree(
    resolution: int | Sequence[int], box: Box, coarse: int, chunk: int, dtype: torch.dtype, seeds: object
) -> tuple[Tensor, Tensor, Cells, Tensor | None]:
    """Lower corner and spacing (3,) float64, cells along each axis, and the seeds (N,3) float64 on the CPU.

    A single resolution counts the cells along the longest side; cells are cubes, up to rounding of the others.
    """
    lower, upper = check_box(box)
    if isinstance(resolution, int):
        sides = (upper - lower).tolist()
        cells = [resolution if side == max(sides) else max(1, round(resolution * side / max(sides))) for side in sides]
    else:
        cells = [int(n) for n in resolution]
    if len(cells) != 3 or min(cells) < 1 or max(cells) > MOST_CELLS:
        raise ValueError(f"resolution: expected cells along the longest side or 3, 1 to {MOST_CELLS}, got {resolution}")
    if dtype not in FLOATING:
        raise TypeError(f"dtype: expected float32 or float64, got {dtype}")
    spacing = (upper - lower) / torch.tensor(cells, dtype=torch.float64)
    check_resolved(lower, upper, spacing, dtype)
    for name, number in (("coarse", coarse), ("chunk", chunk)):
        if number < 1:
            raise ValueError(f"{name}: expected at least 1, got {number}")
    if seeds is not None:
        check_tensor("seeds", seeds, ("N", "3"), last=3)
        seeds = seeds.detach().to("cpu", torch.float64).contiguous()
    return lower, spacing, (cells[0], cells[1], cells[2]), seeds


def crossing(low: Tensor, high: Tensor, level: float) -> Tensor:
    """Where the field meets the level between the two ends of an edge, in [CROSSING_MARGIN, 1 - CROSSING_MARGIN].

    low, high: float64 values (V,) at the two ends, one of them >= level, the other below. Zero gradient where clamped.
    """
    difference = high - low
    t = (level - low) / difference
    t = torch.where(difference.isinf(), (level / 2 - low / 2) / (high / 2 - low / 2), t)
    clamped = t.detach().clamp(CROSSING_MARGIN, 1 - CROSSING_MARGIN)
    return torch.where(clamped == t, t, clamped)


def border_crossing(low_end_outside: bool) -> float:
    """The same on an edge that leaves the box, beyond which the field counts as minus infinity."""
    return 1 - CROSSING_MARGIN if low_end_outside else CROSSING_MARGIN


class Queries:
    """A field whose values are checked, called on at most `chunk` points at a time."""

    def __init__(self, field: Field, dtype: torch.dtype, device: torch.device | str, chunk: int) -> None:
        self.field, self.dtype, self.device, self.chunk = field, dtype, torch.device(device), chunk

    def __call__(self, points: Tensor) -> Tensor:
        """Values (M,) on the CPU, without gradients."""
        with torch.no_grad():
            values = self.values(points).cpu().contiguous()
        if not_finite := int((~values.isfinite()).sum()):
            raise ValueError(f"field: expected finite values, got {not_finite} NaN or infinite ones of {len(values)}")
        return values

    def values(self, points: Tensor) -> Tensor:
        """Values (M,) of the field at points (M,3)."""
        values = self.field(points.to(self.device))
        if not isinstance(values, Tensor):
            raise TypeError(f"field: expected it to return a tensor (M,), got {describe(values)}")
        if values.shape != points.shape[:1]:
            raise ValueError(
                f"field: expected values of shape ({len(points)},) for points ({len(points)}, 3), "
                f"got {tuple(values.shape)}"
            )
        if values.dtype not in FLOATING:
            raise TypeError(f"field: expected it to return float32 or float64, got {describe(values)}")
        return values

    def gradient(self, points: Tensor) -> Tensor:
        """Gradient (V,3) float64 of the field at points (V,3), on the CPU."""
        found = []
        for part in points.to(self.dtype).split(self.chunk):
            with torch.enable_grad():
                part = part.to(self.device).requires_grad_()
                values = self.values(part)
                if not values.requires_grad:
                    raise ValueError("normals: expected a field that autograd can follow from its points to its values")
                (gradient,) = torch.autograd.grad(values.sum(), part)
            found.append(gradient.cpu().double())
        return torch.cat(found)


def attach_gradient(
    query: Queries,
    vertices: Tensor,
    low: Tensor,
    axis: Tensor,
    cells: Cells,
    lower: Tensor,
    spacing: Tensor,
    level: float,
) -> Tensor:
    """The same vertices (V,3), with gradients into whatever the field depends on.

    low (V,): flat index of the lower end of each vertex's edge, -1 where the edge leaves the box; axis (V,): direction.
    """
    free = (low >= 0).nonzero()[:, 0]
    low, axis = low[free], axis[free]
    points = [n + 1 for n in cells]
    strides = torch.tensor([points[1] * points[2], points[2], 1])
    used, ends = torch.stack([low, low + strides[axis]]).unique(return_inverse=True)
    index = torch.stack([used // strides[d] % points[d] for d in range(3)], 1)
    at = (lower + index * spacing).to(query.dtype)
    values = torch.cat([query.values(part).cpu().double() for part in at.split(query.chunk)])
    # The values may differ in the last bit from those of the search (other batches): only their gradient is taken, and
    # none where an edge is no longer crossed.
    start, end = values[ends].unbind(0)
    crossed = (start >= level) != (end >= level)
    t = crossing(torch.where(crossed, start, level - 1.0), torch.where(crossed, end, level + 1.0), level)
    shift = (t - t.detach()) * spacing[axis]
    return vertices + torch.zeros_like(vertices).index_put((free, axis), shift)


def volume_normals(
    volume: Tensor, level: float, box: Box, vertices: Tensor, faces: Tensor, low: Tensor, axis: Tensor
) -> Tensor:
    """Outward unit normals (V,3) at the vertices of a volume: minus its gradient, interpolated along the edges.

    low, axis: as in attach_gradient. Beyond the box the field falls to minus infinity: the vertices that close the mesh
    there face straight out.
    """
    lower, upper = (corner.to(volume.device) for corner in check_box(box))
    points = volume.new_tensor(volume.shape, dtype=torch.long)
    spacing = (upper - lower) / (points - 1)
    strides = torch.stack([points[1] * points[2], points[2], torch.ones_like(points[2])])
    flat = volume.reshape(-1)

    def gradient(index: Tensor) -> Tensor:  # central differences, one-sided at the faces of the box
        columns = []
        for d in range(3):
            position = index // strides[d] % points[d]
            before, after = (position > 0).long(), (position < points[d] - 1).long()
            difference = flat[index + after * strides[d]].double() - flat[index - before * strides[d]].double()
            columns.append(difference / ((before + after) * spacing[d]))
        return torch.stack(columns, 1)

    real = low >= 0
    start = low.clamp(min=0)
    end = torch.where(real, start + strides[axis], start)
    a, b = flat[start].double(), flat[end].double()
    t = crossing(torch.where(real, a, level - 1.0), torch.where(real, b, level + 1.0), level)[:, None]
    along = torch.eye(3, dtype=torch.float64, device=volume.device)[axis]
    outwards = along * (vertices.detach() - (lower + upper) / 2).sign()
    steepest = torch.where(real[:, None], (t - 1) * gradient(start) - t * gradient(end), outwards)
    return unit_normals(steepest, vertices, faces)


def unit_normals(directions: Tensor, vertices: Tensor, faces: Tensor) -> Tensor:
    """Directions (V,3) at unit length; where one is zero or not finite, the area-weighted mean of the faces around."""
    largest = directions.detach().abs().amax(1, keepdim=True)
    usable = (largest > 0) & largest.isfinite()
    scaled = torch.where(usable, directions / torch.where(usable, largest, 1.0), 0.0)
    if not bool(usable.all()):
        corners = vertices[faces] - vertices[faces[:, :1]]
        areas = torch.linalg.cross(corners[:, 1], corners[:, 2])
        around = torch.zeros_like(vertices).index_add(0, faces.reshape(-1), areas.repeat_interleave(3, 0))
        around = around / around.detach().abs().amax(1, keepdim=True).clamp(min=torch.finfo(around.dtype).tiny)
        scaled = torch.where(usable, scaled, around)
    return torch.nn.functional.normalize(scaled, dim=1, eps=torch.finfo(scaled.dtype).tiny)
