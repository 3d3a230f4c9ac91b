"""Fields to extract surfaces from, and what makes a mesh closed; shared by tests, benchmarks and the long fuzz run."""

from collections.abc import Callable, Iterable, Iterator

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

# Fields: points (M,3) -> values (M,), high inside, level 0, within [-1,1]^3.


def torus(points: Tensor) -> Tensor:
    x, y, z = points.unbind(-1)
    return 0.25 - ((x.square() + y.square()).sqrt().sub(0.6).square() + z.square()).sqrt()


def bottle(points: Tensor) -> Tensor:
    """A bottle of revolution about y, open at the neck, with a wall 0.03 thick."""
    x, y, z = points.unbind(-1)
    radius = (x.square() + z.square()).sqrt()
    profile = 0.45 - 0.3 * (y - 0.2).div(0.4).clamp(0, 1)
    wall = torch.minimum(0.015 - (radius - profile).abs(), torch.minimum(y + 0.9, 0.9 - y))
    bottom = torch.minimum(0.015 - (y + 0.885).abs(), 0.465 - radius)
    return torch.maximum(wall, bottom)


def gyroid(points: Tensor) -> Tensor:
    x, y, z = (4.3 * points).unbind(-1)
    return x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()


SURFACES: dict[str, Callable[[Tensor], Tensor]] = {"torus": torus, "bottle": bottle, "gyroid": gyroid}


def ball(centre: tuple[float, float, float], radius: float) -> Callable[[Tensor], Tensor]:
    """Distance inside a ball: level 0 at its surface."""
    return lambda points: radius - (points - torch.tensor(centre, dtype=points.dtype)).norm(dim=-1)


def on_lattice(field: Callable[[Tensor], Tensor], resolution: int, dtype: torch.dtype = torch.float32) -> Tensor:
    """The field's values (R+1,R+1,R+1) at exactly the points where the octree asks for them, over [-1,1]^3."""
    axis = (-1 + torch.arange(resolution + 1, dtype=torch.float64) * (2 / resolution)).to(dtype)
    volume = torch.empty((resolution + 1,) * 3, dtype=dtype)
    y, z = torch.meshgrid(axis, axis, indexing="ij")
    for i, x in enumerate(axis):
        volume[i] = field(torch.stack([x.expand_as(y), y, z], -1))
    return volume


class Table:
    """A volume (X,Y,Z) over [-1,1]^3 as a field that is known at its lattice points only; counts what it is asked."""

    def __init__(self, volume: Tensor) -> None:
        self.volume, self.asked = volume, torch.zeros(volume.shape, dtype=torch.long)

    def __call__(self, points: Tensor) -> Tensor:
        index = (points.double() + 1) / 2 * (torch.tensor(self.volume.shape) - 1)
        assert (index - index.round()).abs().max() < 1e-3
        at = tuple(index.round().long().unbind(1))
        self.asked.index_put_(at, torch.ones(len(points), dtype=torch.long), accumulate=True)
        return self.volume[at]


# Small random volumes.


def small_volumes(generator: torch.Generator, kind: str, count: int) -> Iterator[tuple[Tensor, float]]:
    """`count` volumes of 2 to 5 values a side with a level that some value reaches."""
    while count > 0:
        shape = torch.randint(2, 6, (3,), generator=generator).tolist()
        volume, level = RANDOM_VOLUMES[kind](generator, shape)
        if (volume.double() >= level).any():
            yield volume, level
            count -= 1


def _noise(generator: torch.Generator, shape: list[int]) -> Tensor:
    return torch.randn(shape, generator=generator, dtype=torch.float64)


def _smooth(generator: torch.Generator, shape: list[int]) -> Tensor:
    return torch.nn.functional.avg_pool3d(_noise(generator, [n + 1 for n in shape])[None, None], 2, 1)[0, 0]


def _sheet(generator: torch.Generator, shape: list[int]) -> Tensor:
    """A plane of about one cell, in a random direction."""
    normal = _noise(generator, [3])
    grid = torch.stack(torch.meshgrid(*[torch.arange(n, dtype=torch.float64) for n in shape], indexing="ij"), -1)
    return 0.4 - ((grid - torch.tensor(shape) / 2) @ (normal / normal.norm()) + 0.3).abs()


def _border(generator: torch.Generator, shape: list[int]) -> Tensor:
    volume = _noise(generator, shape)
    volume[tuple(slice(None) if torch.rand((), generator=generator) < 0.5 else -1 for _ in shape)] = 1.0
    return volume


def _integers(generator: torch.Generator, shape: list[int], reach: int = 2) -> Tensor:
    return torch.randint(-reach, reach + 1, shape, generator=generator).double()


RANDOM_VOLUMES: dict[str, Callable[[torch.Generator, list[int]], tuple[Tensor, float]]] = {
    "white noise": lambda g, shape: (_noise(g, shape), 0.1),
    "smoothed noise": lambda g, shape: (_smooth(g, shape).float(), 0.0),
    "plateau at the level": lambda g, shape: (_integers(g, shape, 1) / 2 + 0.5, 0.5),
    "small integers": lambda g, shape: (_integers(g, shape).float(), 0.0),
    "sheet": lambda g, shape: (_sheet(g, shape), 0.0),
    "border": lambda g, shape: (_border(g, shape).float(), 0.5),
    "inside everywhere": lambda g, shape: (_noise(g, shape).abs() + 1, 1.0),
    "1e-30": lambda g, shape: (_noise(g, shape).float() * 1e-30, 0.0),
    "subnormal": lambda g, shape: (_integers(g, shape).float() * 1e-45, 0.0),
    "1e30": lambda g, shape: (_noise(g, shape).float() * 1e30, 0.5),
    "3e38": lambda g, shape: (_noise(g, shape).sign().float() * 3e38, 0.0),
    "1.7e308": lambda g, shape: (_noise(g, shape).sign() * 1.7e308, -1e300),
}


# What is wrong with a mesh.


def faults(vertices: Tensor, faces: Tensor) -> dict[str, int]:
    """Counts of everything the promise excludes; all zero for a closed, oriented 2-manifold without flat faces."""
    v, f = vertices.detach().numpy(), faces.numpy()
    sides = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    code, reverse = (side[:, 0] * (f.max() + 1) + side[:, 1] for side in (sides, sides[:, ::-1]))
    order = np.argsort(code)
    repeated = int((np.diff(code[order]) == 0).sum())
    place = np.searchsorted(code, reverse, sorter=order).clip(max=len(code) - 1)
    paired = code[order[place]] == reverse
    # Two corners of faces at one vertex belong to one fan if the faces share a side there.
    corner = np.arange(3 * len(f)).reshape(3, len(f))  # of side s: its start; its end is the start of side s + 1
    start, end = corner.ravel(), corner[[1, 2, 0]].ravel()
    other = order[place]
    links = np.concatenate([np.stack([start, end[other]], 1), np.stack([end, start[other]], 1)])[np.tile(paired, 2)]
    graph = coo_matrix((np.ones(len(links), dtype=np.int8), links.T), shape=(len(start),) * 2)
    fans = connected_components(graph, directed=False)[0]
    used = len(np.unique(f))
    a, b, c = (v[f[:, n]] for n in range(3))
    # Scaled before squaring, so that the area of a face of 1e-100 does not underflow.
    size = np.maximum(np.abs(b - a).max(1), np.abs(c - a).max(1))[:, None]
    size[size == 0] = 1
    areas = np.linalg.norm(np.cross((b - a) / size, (c - a) / size), axis=1)
    return {
        "not finite": int((~np.isfinite(v)).sum()),
        "unused vertices": len(v) - used,
        "sides used twice": repeated,
        "sides without a partner": int((~paired).sum()),
        "pinched vertices": fans - used,
        "flat faces": int((~(areas > 0)).sum()),
    }


def join(meshes: Iterable[tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
    """Many meshes as one."""
    vertices, faces, count = [], [], 0
    for v, f in meshes:
        vertices.append(v)
        faces.append(f + count)
        count += len(v)
    return torch.cat(vertices), torch.cat(faces)


def assert_closed(vertices: Tensor, faces: Tensor) -> None:
    assert not any((found := faults(vertices, faces)).values()), found


def signed_volume(vertices: Tensor, faces: Tensor) -> Tensor:
    """Positive where the faces wind counter-clockwise seen from outside."""
    a, b, c = (vertices[faces] - vertices.detach().mean(0)).unbind(1)
    return (a * torch.linalg.cross(b, c)).sum() / 6


def euler_number(vertices: Tensor, faces: Tensor) -> int:
    return len(vertices) - 3 * len(faces) // 2 + len(faces)


def canonical(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """The same mesh with vertices sorted by coordinates, faces turned to start at their lowest vertex and sorted."""
    v, f = vertices.detach().numpy(), faces.numpy()
    order = np.lexsort(v.T[::-1])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    f = rank[f]
    first = f.argmin(1)[:, None]
    f = np.take_along_axis(f, (first + np.arange(3)) % 3, 1)
    return torch.from_numpy(v[order]), torch.from_numpy(f[np.lexsort(f.T[::-1])])


def assert_same_mesh(ours: tuple[Tensor, ...], expected: tuple[Tensor, ...]) -> None:
    """Equal bit for bit, up to the order of vertices and faces."""
    for a, b in zip(canonical(*ours[:2]), canonical(*expected[:2]), strict=True):
        assert torch.equal(a, b)


def crossed_cell_corners(volume: Tensor, level: float = 0.0) -> int:
    """How many lattice points are a corner of a cell that the surface crosses."""
    inside = (volume >= level)[None, None].float()
    crossed = torch.nn.functional.max_pool3d(inside, 2, 1) != -torch.nn.functional.max_pool3d(-inside, 2, 1)
    padded = torch.nn.functional.pad(crossed.float(), (1,) * 6)
    return int(torch.nn.functional.max_pool3d(padded, 2, 1).sum())
