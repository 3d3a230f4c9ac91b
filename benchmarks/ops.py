"""Gridding and the samplers against the best formulations in torch (sizes of the published networks)."""

import statistics
import time
from collections.abc import Iterator
from functools import cache

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag, grid_sample

from benchmarks.cases import Case, benchmark
from tests.ops.common import random_points
from touchnet import ops, reference


@cache
def bandwidth(size: int) -> float:
    """Bytes per second, read and written, of copying a tensor of `size` bytes within memory already mapped."""
    source = torch.ones(size // 4)
    target = torch.empty_like(source)
    times = []
    for _ in range(20):
        start = time.perf_counter()
        target.copy_(source)
        times.append(time.perf_counter() - start)
    return 2 * size / statistics.median(times[5:])


def least_seconds(read: int, written: int) -> float:
    """Time to move these bytes at the bandwidth of a copy of as many."""
    return (read + written) / bandwidth(max(1 << 16, (read + written) // 2))


def generator() -> torch.Generator:
    return torch.Generator().manual_seed(1)


# Peers. Each is the fastest way found to say the same in torch; points are inside the cube, so none checks bounds.


def cell_of(points: Tensor, n: int) -> tuple[Tensor, Tensor]:
    """Lower vertex (B, M, 3) int64 and fraction (B, M, 3)."""
    position = (points + 1) * ((n - 1) / 2)
    lower = position.detach().floor().clamp_max(n - 2)
    return lower.long(), position - lower


def corners_of(points: Tensor, n: int) -> tuple[Tensor, Tensor]:
    """Flat vertex numbers through all batch items (B, M, 8), and weights (B, M, 8)."""
    lower, t = cell_of(points, n)
    batch = torch.arange(points.shape[0])[:, None] * n
    base = ((batch + lower[..., 0]) * n + lower[..., 1]) * n + lower[..., 2]
    offsets = torch.tensor([(di * n + dj) * n + dk for di in (0, 1) for dj in (0, 1) for dk in (0, 1)])
    w = torch.stack([1 - t, t], -1)  # (B, M, 3, 2)
    weights = (w[..., 0, :, None, None] * w[..., 1, None, :, None] * w[..., 2, None, None, :]).flatten(2)
    return base[..., None] + offsets, weights


def gridding_by_index_add(points: Tensor, n: int) -> Tensor:
    vertices, weights = corners_of(points, n)
    volume = torch.zeros(points.shape[0] * n**3)
    return volume.index_add(0, vertices.flatten(), weights.flatten()).view(-1, 1, n, n, n)


def gridding_by_bincount(points: Tensor, n: int) -> Tensor:
    vertices, weights = corners_of(points, n)
    return vertices.flatten().bincount(weights.flatten(), points.shape[0] * n**3).view(-1, 1, n, n, n)


def sample_by_grid_sample(volume: Tensor, points: Tensor) -> Tensor:
    grid = points.flip(-1)[:, :, None, None, :]
    return grid_sample(volume, grid, padding_mode="border", align_corners=True)[..., 0, 0].transpose(1, 2)


def rows_of(volume: Tensor) -> Tensor:
    """(B X Y Z, C) of a channels-last volume, without a copy."""
    return volume.permute(0, 2, 3, 4, 1).reshape(-1, volume.shape[1])


def sample_by_embedding_bag(volume: Tensor, points: Tensor) -> Tensor:
    vertices, weights = corners_of(points, volume.shape[2])
    sums = embedding_bag(vertices.view(-1, 8), rows_of(volume), per_sample_weights=weights.view(-1, 8), mode="sum")
    return sums.view(*points.shape[:2], -1)


def sample_by_gather(volume: Tensor, points: Tensor) -> Tensor:
    vertices, weights = corners_of(points, volume.shape[2])
    features = rows_of(volume).index_select(0, vertices.flatten()).view(*vertices.shape, -1)
    return (weights[:, :, None, :] @ features)[:, :, 0]


def cubic_by_index_select(volume: Tensor, points: Tensor) -> Tensor:
    n = volume.shape[2]
    lower, _ = cell_of(points, n)
    batch = torch.arange(points.shape[0])[:, None] * n
    base = ((batch + lower[..., 0]) * n + lower[..., 1]) * n + lower[..., 2]
    offsets = torch.tensor([(di * n + dj) * n + dk for di in (0, 1) for dj in (0, 1) for dk in (0, 1)])
    rows = rows_of(volume).index_select(0, (base[..., None] + offsets).flatten())
    return rows.view(*points.shape[:2], 8, -1)


def cubic_by_gather(volume: Tensor, points: Tensor) -> Tensor:
    """On a channels-first volume, as GRNet keeps it."""
    n = volume.shape[2]
    lower, _ = cell_of(points, n)
    base = (lower[..., 0] * n + lower[..., 1]) * n + lower[..., 2]
    offsets = torch.tensor([(di * n + dj) * n + dk for di in (0, 1) for dj in (0, 1) for dk in (0, 1)])
    vertices = (base[..., None] + offsets).flatten(1)[:, None].expand(-1, volume.shape[1], -1)
    rows = volume.flatten(2).gather(2, vertices).transpose(1, 2)
    return rows.reshape(*points.shape[:2], 8, -1)


def gradient(function, inputs: tuple[Tensor, ...], wanted: Tensor):
    """An action that runs only the backward pass of a recorded call."""
    out = function(*inputs)
    grad = torch.randn(out.shape, generator=generator())
    return lambda: torch.autograd.grad(out, wanted, grad, retain_graph=True)


def there_and_back(function, points: Tensor, *arguments):
    """An action that runs a call and its gradient to the points."""
    grad = torch.randn(function(points, *arguments).shape, generator=generator())
    return lambda: torch.autograd.grad(function(points, *arguments), points, grad)


@benchmark
def gridding() -> Iterator[Case]:
    for n, target in ((2048, (10, 12)), (16384, (None, None))):
        points = random_points(generator(), 4, n)
        size = f"B4 N{n} R64"
        written = 4 * 64**3 * 4
        limit = least_seconds(points.numel() * 4, written)
        for peer_name, peer in (("index_add", gridding_by_index_add), ("bincount", gridding_by_bincount)):
            yield Case(
                f"gridding forward {size}",
                lambda points=points: ops.gridding(points, 64),
                lambda points=points, peer=peer: peer(points, 64),
                peer_name,
                target[0],
                limit,
                "moving the bytes",
                repeats=100,
            )
        moving = points.clone().requires_grad_()
        yield Case(
            f"gridding forward + backward {size}",
            there_and_back(ops.gridding, moving, 64),
            there_and_back(gridding_by_index_add, moving, 64),
            "index_add",
            target[1],
            2 * limit,
            "moving the bytes",
            repeats=100,
        )


def sampling_bytes(points: Tensor, channels: int) -> tuple[int, int]:
    """Read (each corner's row once a point) and written."""
    count = points.shape[0] * points.shape[1]
    return count * (8 * channels + 3) * 4, count * channels * 4


@benchmark
def trilinear_forward() -> Iterator[Case]:
    for batch, m, targets in ((4, 4000, (15, 3)), (1, 1_000_000, (5, None))):
        volume = torch.randn(batch, 16, 64, 64, 64, generator=generator())
        last = volume.contiguous(memory_format=torch.channels_last_3d)
        points = random_points(generator(), batch, m)
        size = f"B{batch} C16 R64 M{m}"
        limit = least_seconds(*sampling_bytes(points, 16))
        repeats = 50 if m < 100_000 else 20

        def ours(volume=last, points=points):
            return ops.trilinear_sample(volume, points)

        peers = [
            ("grid_sample", lambda volume=volume, points=points: sample_by_grid_sample(volume, points), targets[0]),
            ("grid_sample, channels last", lambda last=last, points=points: sample_by_grid_sample(last, points), None),
            ("embedding_bag", lambda last=last, points=points: sample_by_embedding_bag(last, points), targets[1]),
        ]
        for name, peer, target in peers:
            yield Case(f"trilinear {size}", ours, peer, name, target, limit, "moving the bytes", repeats=repeats)
        yield Case(
            f"trilinear {size}, channels first",
            lambda volume=volume, points=points: ops.trilinear_sample(volume, points),
            peers[0][1],
            "grid_sample",
            1,
            repeats=repeats,
        )
        if batch == 1:
            out = torch.empty(batch, m, 16)
            yield Case(
                f"trilinear {size}, into out=",
                lambda: ops.trilinear_sample(last, points, out=out),  # noqa: B023  (timed before the loop goes on)
                peers[0][1],
                "grid_sample",
                15,
                limit,
                "moving the bytes",
            )


@benchmark
def trilinear_backward() -> Iterator[Case]:
    for batch, m in ((4, 4000), (1, 1_000_000)):
        volume = torch.randn(batch, 16, 64, 64, 64, generator=generator())
        last = volume.contiguous(memory_format=torch.channels_last_3d)
        points = random_points(generator(), batch, m)
        size = f"B{batch} C16 R64 M{m}"
        repeats = 20
        read, written = sampling_bytes(points, 16)
        for layout, leaf in (("channels last", last), ("channels first", volume)):
            leaf = leaf.clone().requires_grad_()
            theirs = volume.clone().requires_grad_()
            yield Case(
                f"to the volume {size}, {layout}",
                gradient(ops.trilinear_sample, (leaf, points), leaf),
                gradient(sample_by_grid_sample, (theirs, points), theirs),
                "grid_sample",
                8 if layout == "channels last" else 1,
                least_seconds(read + written, read + volume.numel() * 4),
                "moving the bytes",
                repeats,
            )
        moving = points.clone().requires_grad_()
        for name, peer, peer_volume, target in (
            ("grid_sample", sample_by_grid_sample, volume, 10),
            ("gather", sample_by_gather, last, None),
        ):
            yield Case(
                f"to the points {size}",
                gradient(ops.trilinear_sample, (last, moving), moving),
                gradient(peer, (peer_volume, moving), moving),
                name,
                target,
                least_seconds(read + written, points.numel() * 4),
                "moving the bytes",
                repeats,
            )


@benchmark
def other_samplers() -> Iterator[Case]:
    volume = torch.randn(4, 128, 8, 8, 8, generator=generator()).contiguous(memory_format=torch.channels_last_3d)
    points = random_points(generator(), 4, 2048)
    written = 4 * 2048 * 8 * 128 * 4
    first = volume.contiguous()
    for name, peer, theirs, target in (
        ("gather, channels first", cubic_by_gather, first, 4),
        ("index_select", cubic_by_index_select, volume, None),
    ):
        yield Case(
            "cubic B4 N2048 C128 R8",
            lambda: ops.cubic_sample(volume, points),
            lambda peer=peer, theirs=theirs: peer(theirs, points),
            name,
            target,
            least_seconds(written, written),
            "moving the bytes",
        )
    leaf, theirs = (volume.clone().requires_grad_() for _ in range(2))
    yield Case(
        "cubic backward B4 N2048 C128 R8",
        gradient(ops.cubic_sample, (leaf, points), leaf),
        gradient(cubic_by_index_select, (theirs, points), theirs),
        "index_select",
        None,
        least_seconds(written, 0),
        "moving the bytes",
    )
    features = torch.randn(4, 16, 64, 64, 64, generator=generator()).contiguous(memory_format=torch.channels_last_3d)
    many = random_points(generator(), 4, 4000)
    ones = torch.ones(4 * 4000, 8)
    yield Case(
        "addition B4 C16 R64 M4000",
        lambda: ops.addition_sample(features, many),
        lambda: embedding_bag(
            corners_of(many, 64)[0].view(-1, 8), rows_of(features), per_sample_weights=ones, mode="sum"
        ),
        "embedding_bag",
        None,
        least_seconds(*sampling_bytes(many, 16)),
        "moving the bytes",
        repeats=50,
    )


@benchmark
def gridding_reverse() -> Iterator[Case]:
    density = torch.rand(4, 1, 64, 64, 64, generator=generator())
    moved = density.numel() * 4
    yield Case(
        "gridding_reverse B4 R64",
        lambda: ops.gridding_reverse(density),
        lambda: reference.gridding_reverse(density),
        "slices in torch",
        15,
        least_seconds(moved, 3 * moved),
        "moving the bytes",
    )
    leaf, theirs = (density.clone().requires_grad_() for _ in range(2))
    yield Case(
        "gridding_reverse backward B4 R64",
        gradient(ops.gridding_reverse, (leaf,), leaf),
        gradient(reference.gridding_reverse, (theirs,), theirs),
        "slices in torch",
        None,
        least_seconds(4 * moved, moved),
        "moving the bytes",
    )


@benchmark
def threads() -> Iterator[Case]:
    """Two threads against one, a single batch item of a million points."""
    if torch.get_num_threads() < 2:
        return
    points = random_points(generator(), 1, 1_000_000)
    volume = torch.randn(1, 16, 64, 64, 64, generator=generator()).contiguous(memory_format=torch.channels_last_3d)
    out = torch.empty(1, 1_000_000, 16)
    leaf, moving = volume.clone().requires_grad_(), points.clone().requires_grad_()

    def on(count: int, action):
        def run():
            before = torch.get_num_threads()
            torch.set_num_threads(count)
            action()
            torch.set_num_threads(before)

        return run

    actions = [
        ("trilinear forward into out=", lambda: ops.trilinear_sample(volume, points, out=out), 1.7),
        ("trilinear backward to the volume", gradient(ops.trilinear_sample, (leaf, points), leaf), None),
        ("trilinear backward to the points", gradient(ops.trilinear_sample, (volume, moving), moving), 1.7),
        ("gridding", lambda: ops.gridding(points, 64), 1.7),
    ]
    for name, action, target in actions:
        yield Case(f"{name} M1e6, two threads", on(2, action), on(1, action), "one thread", target)
