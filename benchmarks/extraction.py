"""Extraction against scikit-image, vtk's FlyingEdges and the published octree; evaluations, memory and the head."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import torch
from skimage import measure as skimage_measure
from torch import Tensor, nn

from benchmarks.cases import Case, benchmark
from tests.ops.surfaces import SURFACES, bottle, on_lattice
from touchnet import ops
from touchnet.models.query import HeadQuery
from touchnet.ops import marching_cubes, octree_marching_cubes


def flying_edges(volume: Tensor) -> Callable[[], object] | None:
    """vtk's FlyingEdges at level 0 on one thread, vertices and faces only; None where vtk is not installed."""
    try:
        import vtk
        from vtk.util.numpy_support import numpy_to_vtk
    except ImportError:
        return None
    vtk.vtkSMPTools.SetBackend("Sequential")
    image = vtk.vtkImageData()
    image.SetDimensions(*reversed(volume.shape))
    image.GetPointData().SetScalars(numpy_to_vtk(volume.numpy().ravel()))

    def run() -> object:
        contour = vtk.vtkFlyingEdges3D()
        contour.SetInputData(image)
        contour.SetValue(0, 0.0)
        contour.ComputeNormalsOff()
        contour.ComputeGradientsOff()
        contour.ComputeScalarsOff()
        contour.Update()
        return contour.GetOutput()

    return run


@benchmark
def dense_extraction() -> Iterator[Case]:
    """256^3 values; level 0."""
    alone = torch.get_num_threads() == 1
    for name, field in SURFACES.items():
        volume = on_lattice(field, 255)
        array = volume.numpy()
        yield Case(
            f"marching_cubes 256^3 {name}",
            ours=lambda volume=volume: marching_cubes(volume, 0.0),
            peer=lambda array=array: skimage_measure.marching_cubes(array, 0.0),
            peer_name="scikit-image",
            target=5,
            limit=volume.max,
            limit_name="one read",
            repeats=5,
        )
        peer = flying_edges(volume)
        if peer is not None:
            yield Case(
                f"marching_cubes 256^3 {name}, {'1 thread' if alone else 'all threads'}",
                ours=lambda volume=volume: marching_cubes(volume, 0.0),
                peer=peer,
                peer_name="FlyingEdges, 1 thread",
                target=1 / 1.5 if alone else 1,
                repeats=10,
            )


class Recorded:
    """A field that answers the same calls again from memory: what is left is the work of the extraction itself."""

    def __init__(self, field: Callable[[Tensor], Tensor]) -> None:
        self.field, self.answers, self.points, self.next = field, [], 0, 0

    def record(self, points: Tensor) -> Tensor:
        self.answers.append(self.field(points))
        self.points += len(points)
        return self.answers[-1]

    def __call__(self, points: Tensor) -> Tensor:
        answer = self.answers[self.next]
        self.next = (self.next + 1) % len(self.answers)
        return answer


def crossed_corners(field: Callable[[Tensor], Tensor], resolution: int) -> int:
    """Lattice points that are a corner of a crossed cell, slice by slice."""
    axis = (-1 + torch.arange(resolution + 1, dtype=torch.float64) * (2 / resolution)).float()
    y, z = torch.meshgrid(axis, axis, indexing="ij")
    total = 0
    before = touched = None
    for x in axis:
        inside = (field(torch.stack([x.expand_as(y), y, z], -1)) >= 0).numpy()
        if before is not None:
            both = np.stack([before, inside])
            some, every = both.any(0), both.all(0)
            for d in range(2):
                first, second = (slice(None, -1), slice(1, None))
                low = tuple(first if e == d else slice(None) for e in range(2))
                high = tuple(second if e == d else slice(None) for e in range(2))
                some, every = some[low] | some[high], every[low] & every[high]
            crossed = np.pad(some & ~every, 1)
            corners = crossed[:-1, :-1] | crossed[1:, :-1] | crossed[:-1, 1:] | crossed[1:, 1:]
            total += int((touched | corners).sum())
            touched = corners
        else:
            touched = np.zeros_like(inside)
        before = inside
    return total + int(touched.sum())


@benchmark
def octree_evaluations() -> Iterator[Case]:
    """Bookkeeping and triangulation alone; the name says how many evaluations a crossed corner took (1.3 allowed)."""
    for name, field in SURFACES.items():
        for resolution in (128, 256, 512):
            recorded = Recorded(field)
            octree_marching_cubes(recorded.record, resolution=resolution, level=0.0)
            share = (recorded.points - 65**3) / crossed_corners(field, resolution)
            yield Case(
                f"octree {resolution}^3 {name}: {recorded.points} evaluations, {share:.2f} <= 1.3",
                ours=lambda recorded=recorded, n=resolution: octree_marching_cubes(recorded, resolution=n, level=0.0),
                limit=0.15 if (name, resolution) == ("bottle", 512) else None,
                limit_name="of 0.15 s" if (name, resolution) == ("bottle", 512) else "",
                repeats=5,
            )


def published_octree(query: Callable[[Tensor], Tensor], resolution: int, start: int = 64) -> tuple[np.ndarray, ...]:
    """The published extraction, from its description: dense at `start`; a cell is refined where its corners differ by
    at least 0.01 and filled with their mean elsewhere, one Python step a cell; scikit-image on the dense volume.
    """
    values = np.zeros((resolution,) * 3, dtype=np.float32)
    unknown = np.ones((resolution,) * 3, dtype=bool)
    axis = torch.linspace(-1, 1, resolution)
    step = resolution // start
    while step > 0:
        lattice = np.zeros_like(unknown)
        lattice[::step, ::step, ::step] = True
        wanted = np.nonzero(lattice & unknown)
        points = torch.stack([axis[torch.from_numpy(w)] for w in wanted], 1)
        values[wanted] = torch.cat([query(part) for part in points.split(10000)]).numpy()
        unknown[wanted] = False
        if step == 1:
            break
        for i in range(0, resolution - step, step):
            for j in range(0, resolution - step, step):
                for k in range(0, resolution - step, step):
                    if not unknown[i + step // 2, j + step // 2, k + step // 2]:
                        continue
                    corners = values[i : i + step + 1 : step, j : j + step + 1 : step, k : k + step + 1 : step]
                    low, high = corners.min(), corners.max()
                    if high - low < 0.01:
                        values[i : i + step, j : j + step, k : k + step] = (low + high) / 2
                        unknown[i : i + step, j : j + step, k : k + step] = False
        step //= 2
    return skimage_measure.marching_cubes(values, 0.5)


def bottle_network() -> tuple[Tensor, nn.Sequential]:
    """A feature volume of 16 channels and a head 16-64-128-32-1 whose occupancy is that of the bottle."""
    volume = torch.zeros(1, 16, 64, 64, 64).contiguous(memory_format=torch.channels_last_3d)
    volume[0, 0] = on_lattice(bottle, 63)
    widths = [16, 64, 128, 32, 1]
    head: list[nn.Module] = []
    with torch.no_grad():
        for n, (before, after) in enumerate(pairwise(widths)):
            layer = nn.Linear(before, after)
            layer.weight.zero_()
            layer.bias.zero_()
            # The distance travels as its positive and its negative part, and leaves as the difference.
            if n == 0:
                layer.weight[0, 0], layer.weight[1, 0] = 30, -30
            elif after > 1:
                layer.weight[0, 0] = layer.weight[1, 1] = 1
            else:
                layer.weight[0, 0], layer.weight[0, 1] = 1, -1
            head += [layer, nn.ReLU()]
    return volume, nn.Sequential(*head[:-1])


@benchmark
def whole_extraction() -> Iterator[Case]:
    """The bottle through sampling and the head; the published algorithm, through torch's sampler, is timed once."""
    volume, head = bottle_network()
    query = HeadQuery([volume], head)
    channels_first = volume.contiguous()

    def plain(points: Tensor) -> Tensor:
        with torch.no_grad():
            grid = points.flip(1)[None, :, None, None]
            features = nn.functional.grid_sample(channels_first, grid, align_corners=True, padding_mode="border")
            return head(features[0, :, :, 0, 0].t())[:, 0].sigmoid()

    for resolution, times in ((256, 30), (512, 60)):
        start = time.perf_counter()
        published_octree(plain, resolution)
        published = time.perf_counter() - start
        yield Case(
            f"bottle {resolution}^3 with the head (published {published:.1f} s)",
            ours=lambda n=resolution: octree_marching_cubes(query, resolution=n),
            limit=published / times,
            limit_name=f"of 1/{times} of the published",
            repeats=5,
        )


def peak_memory(resolution: int) -> float:
    """Megabytes by which extracting the bottle raises a fresh process above what it holds before (Linux)."""
    code = (
        "from pathlib import Path\n"
        "from tests.ops.surfaces import bottle, torus\n"
        "from touchnet.ops import octree_marching_cubes\n"
        "def status(key):\n"
        "    return next(int(x.split()[1]) for x in Path('/proc/self/status').read_text().splitlines() if key in x)\n"
        "octree_marching_cubes(torus, resolution=8, level=0.0)\n"
        "Path('/proc/self/clear_refs').write_text('5')\n"  # forget the peak of importing torch
        "before = status('VmRSS')\n"
        f"octree_marching_cubes(bottle, resolution={resolution}, level=0.0, chunk=1 << 18)\n"
        "print((status('VmHWM') - before) / 1024)\n"
    )
    return float(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout)


@benchmark
def octree_memory() -> Iterator[Case]:
    """The name says how far the memory of a process rises above its start."""
    for resolution in (128, 256, 512, 1024):
        megabytes = peak_memory(resolution)
        yield Case(
            f"octree {resolution}^3 bottle: {megabytes:.0f} MB",
            ours=lambda n=resolution: octree_marching_cubes(bottle, resolution=n, level=0.0, chunk=1 << 18),
            repeats=3,
        )


@benchmark
def head_queries() -> Iterator[Case]:
    """A million points: trilinear sampling and the MLP, in chunks on both sides."""
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(1_000_000, 3, generator=generator) * 2 - 1
    for channels in ((16,), (16, 32)):
        volumes = [
            torch.randn(1, c, s, s, s, generator=generator).contiguous(memory_format=torch.channels_last_3d)
            for c, s in zip(channels, (64, 32), strict=False)
        ]
        widths = [sum(channels), 64, 128, 32, 1]
        layers = [nn.Linear(n, m) for n, m in pairwise(widths)]
        head = nn.Sequential(*[m for layer in layers for m in (layer, nn.ReLU())][:-1])

        def plain(head=head, volumes=volumes, dtype=torch.float32) -> Tensor:
            found = []
            with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=dtype == torch.bfloat16):
                for part in points.split(16384):
                    features = torch.cat([ops.trilinear_sample(volume, part[None]) for volume in volumes], 2)
                    found.append(head(features)[0, :, 0].float().sigmoid())
            return torch.cat(found)

        def convolved(layers=layers, volumes=volumes) -> Tensor:
            found = []
            with torch.no_grad():
                for part in points.split(4096):
                    state = torch.cat([ops.trilinear_sample(volume, part[None]) for volume in volumes], 2)
                    state = state[:, None].permute(0, 3, 1, 2)  # (1,C,1,M), channels last
                    for n, layer in enumerate(layers):
                        state = torch.conv2d(state, layer.weight[:, :, None, None], layer.bias)
                        state = state.relu_() if n < len(layers) - 1 else state
                    found.append(state[0, 0, 0].sigmoid())
            return torch.cat(found)

        query = HeadQuery(volumes, head)
        buffered = HeadQuery(volumes, head, compiled=False)
        sides = (
            ("torch in buffers", lambda buffered=buffered: buffered(points)),
            ("nn.Linear", plain),
            ("convolutions of size 1", convolved),
            ("bfloat16", lambda plain=plain: plain(dtype=torch.bfloat16)),
        )
        for name, peer in sides:
            yield Case(
                f"head {'-'.join(map(str, widths))}, {len(channels)} volume(s), 1M points",
                ours=lambda query=query: query(points),
                peer=peer,
                peer_name=name,
                limit=0.2,
                limit_name="of 0.2 s",
                repeats=3,
            )
