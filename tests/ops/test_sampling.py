"""The samplers against literals, their reference twins, grid_sample and finite differences."""

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck
from torch.nn.functional import grid_sample

from tests.ops.common import LAYOUTS, awkward_points, points_off_faces, random_points
from touchnet import ops, reference

SAMPLERS = ["trilinear_sample", "addition_sample", "cubic_sample"]
TOLERANCE = {torch.float32: 2e-6, torch.float64: 1e-14}


def by_grid_sample(volume: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """(B, M, C) through torch's own sampler, which wants (z, y, x)."""
    grid = points.flip(-1)[:, :, None, None, :]
    sampled = grid_sample(volume, grid, mode="bilinear", padding_mode="border", align_corners=True)
    return sampled[..., 0, 0].transpose(1, 2)


def test_corner_numbers(device, dtype):
    volume = torch.arange(8.0, dtype=dtype, device=device).view(1, 1, 2, 2, 2)
    points = torch.tensor([[[-0.5, 0.0, 0.5]]], dtype=dtype, device=device)
    assert ops.cubic_sample(volume, points).flatten().tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert ops.addition_sample(volume, points).item() == 28
    assert ops.trilinear_sample(volume, points).item() == 0.25 * 4 + 0.5 * 2 + 0.75


@pytest.mark.parametrize("name", SAMPLERS)
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("channels", [1, 7, 16, 37])
def test_equals_reference(name, layout, channels, device, dtype, generator):
    volume = torch.randn(2, channels, 4, 6, 5, generator=generator, dtype=dtype)
    volume = LAYOUTS[layout](volume.to(device)).detach().requires_grad_()
    points = torch.cat([random_points(generator, 2, 150, dtype=dtype), awkward_points(dtype).expand(2, -1, -1)], 1)
    points = points.to(device).requires_grad_()
    got, expected = getattr(ops, name)(volume, points), getattr(reference, name)(volume, points)
    torch.testing.assert_close(got, expected, rtol=TOLERANCE[dtype], atol=TOLERANCE[dtype], equal_nan=True)
    assert got.isnan().flatten(2).all(-1).sum() == 8 and got.isnan().flatten(2).any(-1).sum() == 8
    grad = torch.randn(got.shape, generator=generator, dtype=dtype).to(device)
    grads = torch.autograd.grad(got, (volume, points), grad, allow_unused=True)
    expected_grads = torch.autograd.grad(expected, (volume, points), grad, allow_unused=True)
    for a, b in zip(grads, expected_grads, strict=True):
        if name != "trilinear_sample" and a is None:
            continue  # the points only choose the cell
        torch.testing.assert_close(a, b, rtol=TOLERANCE[dtype] * 10, atol=TOLERANCE[dtype] * 100)


@pytest.mark.parametrize("name", SAMPLERS)
@pytest.mark.parametrize("layout", ["contiguous", "channels_last", "expanded"])
def test_gradient_has_the_memory_format_of_the_volume(name, layout, device, generator):
    volume = LAYOUTS[layout](torch.randn(2, 3, 4, 5, 6, generator=generator).to(device)).detach().requires_grad_()
    getattr(ops, name)(volume, random_points(generator, 2, 9).to(device)).sum().backward()
    last = layout == "channels_last"
    assert volume.grad.is_contiguous(memory_format=torch.channels_last_3d if last else torch.contiguous_format)


def test_errors_no_larger_than_twice_those_of_grid_sample(device, generator):
    volume = torch.randn(1, 8, 33, 20, 64, generator=generator).to(device)
    points = random_points(generator, 1, 5000).to(device)
    volume.requires_grad_()
    points.requires_grad_()

    def measured(function):
        out = function(volume, points)
        grad = torch.linspace(-1, 1, out.numel(), device=device).view(out.shape)
        exact_inputs = [x.detach().double().requires_grad_() for x in (volume, points)]
        exact = by_grid_sample(*exact_inputs)
        pairs = [(out, exact)]
        pairs += zip(
            torch.autograd.grad(out, (volume, points), grad),
            torch.autograd.grad(exact, exact_inputs, grad.double()),
            strict=True,
        )
        return [(a.double() - b).abs() for a, b in pairs]

    for ours, theirs in zip(measured(ops.trilinear_sample), measured(by_grid_sample), strict=True):
        assert ours.mean() <= 2 * theirs.mean()
        assert ours.max() <= 2 * theirs.max()


@pytest.mark.parametrize("size", [(2, 2, 2), (5, 6, 7), (64, 33, 100)])
@pytest.mark.parametrize("how", ["formula", "linspace"])
def test_vertices_read_back_exactly(size, how, device, dtype, generator):
    axes = [
        -1 + 2 * torch.arange(n, dtype=dtype) / (n - 1) if how == "formula" else torch.linspace(-1, 1, n, dtype=dtype)
        for n in size
    ]
    points = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).view(1, -1, 3).to(device)
    volume = torch.randn(1, 3, *size, generator=generator, dtype=dtype).to(device)
    assert torch.equal(ops.trilinear_sample(volume, points), volume.flatten(2).transpose(1, 2))


def test_clamped_axis_has_no_gradient(device, dtype, generator):
    volume = torch.randn(1, 2, 4, 4, 4, generator=generator, dtype=dtype).to(device)
    points = torch.tensor([[[1.5, 0.1, 0.2], [0.1, -2.0, 5.0], [1.0, 0.3, -1.0]]], dtype=dtype, device=device)
    points.requires_grad_()
    out = ops.trilinear_sample(volume, points)
    assert torch.equal(out, ops.trilinear_sample(volume, points.detach().clamp(-1, 1)))
    (grad,) = torch.autograd.grad(out.sum(), points)
    assert (grad[0] == 0).tolist() == [[True, False, False], [False, True, True], [False, False, False]]


@pytest.mark.parametrize("name", SAMPLERS)
@pytest.mark.parametrize(("batch", "m"), [(0, 4), (2, 0), (1, 1)])
def test_empty_and_single(name, batch, m, device, dtype):
    volume = torch.ones(batch, 3, 2, 3, 4, dtype=dtype, device=device, requires_grad=True)
    points = torch.zeros(batch, m, 3, dtype=dtype, device=device, requires_grad=True)
    out = getattr(ops, name)(volume, points)
    assert out.shape == ((batch, m, 8, 3) if name == "cubic_sample" else (batch, m, 3))
    out.sum().backward()
    assert volume.grad.shape == volume.shape
    assert volume.grad.sum().item() == out.sum().item()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_gradcheck_trilinear(layout, device, generator):
    volume = torch.randn(2, 2, 3, 2, 4, generator=generator, dtype=torch.float64).to(device).requires_grad_()
    points = points_off_faces(generator, 2, 3, (3, 2, 4)).to(device).requires_grad_()
    nondet = 0.0 if device.type == "cpu" else 1e-12

    def function(volume, points):
        return ops.trilinear_sample(LAYOUTS[layout](volume), points)

    assert gradcheck(function, (volume, points), nondet_tol=nondet)
    assert gradgradcheck(function, (volume, points), nondet_tol=nondet)


@pytest.mark.parametrize("name", ["addition_sample", "cubic_sample"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_gradcheck_of_the_linear_samplers(name, layout, device, generator):
    volume = torch.randn(2, 2, 3, 2, 4, generator=generator, dtype=torch.float64).to(device).requires_grad_()
    points = points_off_faces(generator, 2, 3, (3, 2, 4)).to(device)
    nondet = 0.0 if device.type == "cpu" else 1e-12

    def function(volume):
        return getattr(ops, name)(LAYOUTS[layout](volume), points)

    assert gradcheck(function, (volume,), nondet_tol=nondet)
    assert gradgradcheck(function, (volume,), nondet_tol=nondet)


def test_recorded_gradient_equals_the_kernel(device, generator):
    volume = torch.randn(2, 5, 4, 4, 4, generator=generator, dtype=torch.float64).to(device).requires_grad_()
    points = random_points(generator, 2, 30, dtype=torch.float64).to(device).requires_grad_()
    mixed = torch.tanh(points) * 0.5  # points that depend on what the volume depends on
    out = ops.trilinear_sample(volume * points.mean(), mixed)
    plain = torch.autograd.grad(out.square().sum(), (volume, points), retain_graph=True)
    recorded = torch.autograd.grad(out.square().sum(), (volume, points), create_graph=True)
    for a, b in zip(plain, recorded, strict=True):
        torch.testing.assert_close(a, b)


def test_out_is_written_and_returned(device, dtype, generator):
    volume = torch.randn(2, 5, 4, 4, 4, generator=generator, dtype=dtype).to(device)
    points = random_points(generator, 2, 30, dtype=dtype).to(device)
    out = torch.empty(2, 30, 5, dtype=dtype, device=device)
    for module in (ops, reference):
        out.fill_(-1)
        assert module.trilinear_sample(volume, points, out=out) is out
        assert torch.equal(out, ops.trilinear_sample(volume, points))


@pytest.mark.parametrize("module", [ops, reference], ids=["ops", "reference"])
def test_out_is_refused(module, generator):
    volume, points = torch.zeros(1, 2, 3, 3, 3), torch.zeros(1, 4, 3)
    with pytest.raises(ValueError, match=r"out: expected a contiguous torch.float32 tensor of shape \(1, 4, 2\)"):
        module.trilinear_sample(volume, points, out=torch.zeros(1, 4, 3))
    with pytest.raises(ValueError, match="not contiguous"):
        module.trilinear_sample(volume, points, out=torch.zeros(1, 2, 4).transpose(1, 2))
    with pytest.raises(ValueError, match="out: cannot be used where a gradient is recorded"):
        module.trilinear_sample(volume.requires_grad_(), points, out=torch.zeros(1, 4, 2))


V, P = torch.zeros(2, 1, 3, 3, 3), torch.zeros(2, 4, 3)


@pytest.mark.parametrize(
    ("volume", "points", "error", "words"),
    [
        (V[0], P, ValueError, r"volume: expected shape \(B, C, X, Y, Z\), got \(1, 3, 3, 3\)"),
        (V, P[0], ValueError, r"points: expected shape \(B, M, 3\), got \(4, 3\)"),
        (V, P[..., :2], ValueError, r"points: expected shape \(B, M, 3\), got \(2, 4, 2\)"),
        (V, torch.zeros(3, 4, 3), ValueError, "points: expected the batch size of volume, 2, got 3"),
        (V[..., :1], P, ValueError, "volume: expected C >= 1 and at least 2 vertices"),
        (V[:, :, :0], P, ValueError, "volume: expected C >= 1 and at least 2 vertices"),
        (V[:, :0], P, ValueError, "volume: expected C >= 1 and at least 2 vertices"),
        (V, P.double(), TypeError, "volume and points: expected one dtype, got float32 and float64"),
        (V.half(), P.half(), TypeError, "volume: expected dtype float32 or float64, got float16"),
        (V.bfloat16(), P, TypeError, "volume: expected dtype float32 or float64, got bfloat16"),
        (V, P.int(), TypeError, "points: expected dtype float32 or float64, got int32"),
        (V, P.to("meta"), ValueError, "points: expected the device of volume, cpu, got meta"),
        (V.numpy(), P, TypeError, "volume: expected a tensor of shape"),
    ],
)
@pytest.mark.parametrize("name", SAMPLERS)
@pytest.mark.parametrize("module", [ops, reference], ids=["ops", "reference"])
def test_errors(volume, points, error, words, name, module):
    with pytest.raises(error, match=words):
        getattr(module, name)(volume, points)


@pytest.mark.parametrize("channels", [37, 40])
def test_volumes_too_large_for_a_cache(channels, device, generator):
    # More than csrc/cpu/stream.h's 24 MB: what is written past the caches has to be there all the same, rows of any
    # alignment, on memory that held something else.
    volume = torch.randn(2, channels, 44, 45, 46, generator=generator).to(device)
    volume = volume.contiguous(memory_format=torch.channels_last_3d).requires_grad_()
    points = random_points(generator, 2, 600).to(device)
    for name in SAMPLERS:
        torch.empty_like(volume).fill_(float("nan"))
        got, expected = getattr(ops, name)(volume, points), getattr(reference, name)(volume, points)
        grad = torch.randn(got.shape, generator=generator).to(device)
        (ours,), (theirs,) = (torch.autograd.grad(each, volume, grad) for each in (got, expected))
        torch.testing.assert_close(ours, theirs, rtol=2e-5, atol=2e-5)


@pytest.mark.parametrize("channels", [64, 67])
def test_rows_too_many_for_a_cache(channels, device, generator):
    volume = torch.randn(1, channels, 5, 6, 7, generator=generator).to(device)
    volume = volume.contiguous(memory_format=torch.channels_last_3d)
    points = random_points(generator, 1, 13_000).to(device)
    assert torch.equal(ops.cubic_sample(volume, points), reference.cubic_sample(volume, points))


def test_more_elements_than_32_bits_count(device, generator):
    """A volume of 2**31 + elements that takes no memory: expanded along channels, sampled where offsets are largest."""
    plane = torch.randn(1, 1, 8, 8, 8, generator=generator).to(device)
    volume = plane.expand(1, 5_000_000, 8, 8, 8)
    assert volume.numel() > 2**31
    points = torch.ones(1, 1, 3, device=device)
    out = ops.trilinear_sample(volume, points)
    assert torch.equal(out, plane[0, 0, 7, 7, 7].expand(1, 1, 5_000_000))


def test_index_above_24_bits(device):
    """Vertex numbers that float32 cannot tell apart."""
    volume = torch.zeros(1, 1, 260, 260, 260, device=device)  # 17.6 million vertices
    volume[0, 0, 259, 259, 258] = 1
    z = -1 + 2 * 258 / 259
    out = ops.trilinear_sample(volume, torch.tensor([[[1.0, 1.0, z], [1.0, 1.0, 1.0]]], device=device))
    assert out.flatten().tolist() == [1.0, 0.0]
