"""How much two solids have in common."""

from typing import Any, NamedTuple, overload

import numpy as np
import trimesh
from numpy.typing import NDArray
from torch import Tensor

from touchnet.metrics.surfaces import is_closed
from touchnet.raster import cover


@overload
def volumetric_iou(a: Tensor, b: Tensor) -> Tensor: ...
@overload
def volumetric_iou(a: NDArray[np.bool_], b: NDArray[np.bool_]) -> NDArray[np.float64]: ...
@overload
def volumetric_iou(a: trimesh.Trimesh, b: trimesh.Trimesh, *, lines: int = ..., seed: int = ...) -> float: ...


def volumetric_iou(a: Any, b: Any, *, lines: int = 1 << 16, seed: int = 0) -> Any:
    """Intersection over union of two solids, given by labels at common points or as closed meshes.

    Meshes are compared along parallel lines, on which inside is known exactly (winding number >= 1, from the crossings
    counted with their signs) and so are the lengths of intersection and union. That takes fewer samples than labelled
    points do, above all for thin shapes.

    Args:
        a, b: boolean arrays or tensors of one shape, (N,) or (B, N); or two closed meshes wound outwards.
        lines: meshes only: about how many lines cross the box of both.
        seed: meshes only: of the position of the lines.

    Returns:
        (a & b).sum(-1) / (a | b).sum(-1), in [0, 1], 1 where both are empty: a scalar or (B,) of the kind that came;
        a float for meshes.

    Raises:
        ValueError: shapes differ, or a mesh is not closed.
        TypeError: not booleans, nor meshes.
    """
    if isinstance(a, trimesh.Trimesh) and isinstance(b, trimesh.Trimesh):
        for name, mesh in (("a", a), ("b", b)):
            if not is_closed(mesh.faces):
                raise ValueError(f"{name} must be a closed mesh, got one with open or inconsistently wound edges")
        if len(a.faces) == 0 or len(b.faces) == 0:
            return float(len(a.faces) == len(b.faces))
        lattice = Lattice.over(np.concatenate([box_of(a), box_of(b)]), lines, seed)
        return iou_along_lines(lattice.crossings(a), lattice.crossings(b))
    for name, labels in (("a", a), ("b", b)):
        if not isinstance(labels, Tensor | np.ndarray) or str(labels.dtype).removeprefix("torch.") != "bool":
            kind = getattr(labels, "dtype", type(labels).__name__)
            raise TypeError(f"{name} must be a boolean array or tensor, or both closed meshes, got {kind}")
    if a.shape != b.shape or a.ndim not in (1, 2):
        raise ValueError(f"a and b must have one shape (N,) or (B, N), got {tuple(a.shape)} and {tuple(b.shape)}")
    common, either = (a & b).sum(-1), (a | b).sum(-1)
    return (common + (either == 0)) / (either + (either == 0))


class Crossings(NamedTuple):
    """Where the lines of a lattice cross a mesh."""

    i: NDArray[np.int64]  # (C,) the line
    j: NDArray[np.int64]
    depth: NDArray[np.float64]  # (C,) along the line
    step: NDArray[np.int64]  # (C,) change of the winding number there, +1 (into the solid) or -1


class Lattice(NamedTuple):
    """Parallel lines through the points of a square lattice."""

    turn: NDArray[np.float64]  # (3, 3) rotation: the rows are the lattice's two axes and the direction of the lines
    origin: NDArray[np.float64]  # (2,) of the lattice, in its own axes
    spacing: float

    @classmethod
    def over(cls, points: NDArray[np.float64], lines: int, seed: int) -> "Lattice":
        """About `lines` lines through the box of the points (N, 3), along its shortest side.

        The lattice is turned by an odd angle, so that sides of the shape do not run along its rows.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        size = np.maximum(high - low, 1e-12 * max(1.0, float(np.abs(points).max())))
        axis = int(np.argmin(size))
        across, up = (axis + 1) % 3, (axis + 2) % 3
        sine, cosine = np.sin(0.37), np.cos(0.37)
        turn = np.zeros((3, 3))
        turn[0, across], turn[0, up] = cosine, sine
        turn[1, across], turn[1, up] = -sine, cosine
        turn[2, axis] = 1
        spacing = float(np.sqrt(size[across] * size[up] / lines))
        shift = np.random.default_rng(seed).random(2) * spacing
        return cls(turn, (turn @ low)[:2] + shift, spacing)

    def crossings(self, mesh: trimesh.Trimesh) -> Crossings:
        turned = np.asarray(mesh.vertices, dtype=np.float64) @ self.turn.T
        uv = (turned[:, :2] - self.origin) / self.spacing
        depth = turned[:, 2][mesh.faces]  # (F, 3)
        parts = [
            # Counter-clockwise seen along the lines' direction from above: the line leaves the solid there.
            Crossings(p.i, p.j, (p.weights * depth[p.face]).sum(axis=1), np.where(p.left, -1, 1))
            for p in cover(uv, mesh.faces)
        ]
        if not parts:
            return Crossings(*(np.zeros(0, dtype=np.int64) for _ in range(2)), np.zeros(0), np.zeros(0, dtype=np.int64))
        return Crossings(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def iou_along_lines(a: Crossings, b: Crossings) -> float:
    """Length of the lines inside both over length inside either; 0 when no line meets either."""
    i, j, depth = (np.concatenate(pair) for pair in zip(a[:3], b[:3], strict=True))
    if len(i) == 0:
        return 0.0
    line = (i - i.min()) * (j.max() - j.min() + 1) + (j - j.min())
    low, high = depth.min(), depth.max()
    order = np.argsort(line + 0.999 * (depth - low) / max(high - low, 1e-300))
    line, depth = line[order], depth[order]
    step_a = np.concatenate([a.step, np.zeros_like(b.step)])[order]
    step_b = np.concatenate([np.zeros_like(a.step), b.step])[order]
    last = np.append(np.diff(line) != 0, True)  # of its line
    # Between a crossing and the next; the sums run on over the lines, for on a closed mesh they end every line at 0.
    # Should rounding next to a vertex break that on some line, the line is left out.
    winding_a, winding_b = np.cumsum(step_a), np.cumsum(step_b)
    if winding_a[last].any() or winding_b[last].any():
        count = np.diff(np.flatnonzero(last), prepend=-1)
        starts = np.cumsum(count) - count
        sound = (np.add.reduceat(step_a, starts) == 0) & (np.add.reduceat(step_b, starts) == 0)
        kept = np.repeat(sound, count)
        depth, last = depth[kept], last[kept]
        winding_a, winding_b = np.cumsum(step_a[kept]), np.cumsum(step_b[kept])
        if not kept.any():
            return 0.0
    length = np.where(last, 0.0, np.diff(depth, append=depth[-1]))
    inside_a, inside_b = winding_a >= 1, winding_b >= 1
    either = length[inside_a | inside_b].sum()
    return float(length[inside_a & inside_b].sum() / either) if either > 0 else 0.0


def box_of(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """The two corners (2, 3) of the box around the vertices that faces use."""
    used = np.asarray(mesh.vertices, dtype=np.float64)[np.unique(mesh.faces)]
    return np.stack([used.min(axis=0), used.max(axis=0)])
