"""gridding against literals, its reference twin and finite differences."""

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

from tests.ops.common import awkward_points, points_off_faces, random_points
from touchnet import ops, reference

TOLERANCE = {torch.float32: 2e-6, torch.float64: 1e-14}


@pytest.mark.parametrize(
    ("point", "vertices"),
    [
        ([-1, -1, -1], {(0, 0, 0): 1.0}),
        ([1, 1, 1], {(2, 2, 2): 1.0}),
        ([1, -1, 0], {(2, 0, 1): 1.0}),
        ([0.5, 0, 0], {(1, 1, 1): 0.5, (2, 1, 1): 0.5}),
        ([-0.75, 0.5, 1], {(0, 1, 2): 0.375, (0, 2, 2): 0.375, (1, 1, 2): 0.125, (1, 2, 2): 0.125}),
    ],
)
def test_weights_of_one_point(point, vertices, device, dtype):
    volume = ops.gridding(torch.tensor([[point]], dtype=dtype, device=device), 3)
    expected = torch.zeros(1, 1, 3, 3, 3, dtype=dtype)
    for vertex, weight in vertices.items():
        expected[0, 0][vertex] = weight
    assert torch.equal(volume.cpu(), expected)


def test_values_are_spread_with_the_density(device, dtype):
    points = torch.tensor([[[0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]], dtype=dtype, device=device)
    values = torch.tensor([[[2.0, -1.0], [4.0, 3.0]]], dtype=dtype, device=device)
    volume = ops.gridding(points, 3, values=values)
    assert volume.shape == (1, 3, 3, 3, 3)
    assert volume[0, :, 1, 1, 1].tolist() == [1.0, 3.0, 1.0]
    assert volume[0, :, 2, 1, 1].tolist() == [1.0, 3.0, 1.0]
    assert volume.sum().item() == 2 * (1 + 3 + 1)


@pytest.mark.parametrize("size", [2, 5, (4, 7, 5)])
@pytest.mark.parametrize("channels", [0, 1, 3])
@pytest.mark.parametrize("memory_format", [torch.contiguous_format, torch.channels_last_3d], ids=["first", "last"])
def test_equals_reference(size, channels, memory_format, device, dtype, generator):
    points = torch.cat([random_points(generator, 2, 200, dtype=dtype), awkward_points(dtype).expand(2, -1, -1)], 1)
    points = points.to(device).requires_grad_()
    values = torch.randn(2, points.shape[1], channels, generator=generator, dtype=dtype).to(device).requires_grad_()
    given = {"values": values} if channels else {}
    got = ops.gridding(points, size, memory_format=memory_format, **given)
    expected = reference.gridding(points, size, memory_format=memory_format, **given)
    assert got.is_contiguous(memory_format=memory_format)
    torch.testing.assert_close(got, expected, rtol=TOLERANCE[dtype], atol=10 * TOLERANCE[dtype])
    grad = torch.randn(got.shape, generator=generator, dtype=dtype).to(device)
    inputs = (points, *given.values())
    for a, b in zip(torch.autograd.grad(got, inputs, grad), torch.autograd.grad(expected, inputs, grad), strict=True):
        torch.testing.assert_close(a, b, rtol=TOLERANCE[dtype] * 10, atol=TOLERANCE[dtype] * 20)


def test_ignored_points_weigh_nothing_and_have_no_gradient(device, dtype):
    points = awkward_points(dtype).to(device).requires_grad_()
    values = torch.ones(1, points.shape[1], 1, dtype=dtype, device=device)
    values[:, 10:] = torch.nan  # padding: never read
    volume = ops.gridding(points, 4, values=values)
    inside = ((points.detach() >= -1) & (points.detach() <= 1)).all(-1)
    assert inside.sum() == 6
    torch.testing.assert_close(volume[0].sum((1, 2, 3)), torch.full((2,), 6.0, dtype=dtype, device=device))
    weights = torch.arange(1.0, 1.0 + volume.numel(), dtype=dtype, device=device).view(volume.shape)
    (grad,) = torch.autograd.grad(volume, points, weights)
    assert torch.equal(grad[~inside], torch.zeros_like(grad[~inside]))
    assert (grad[inside] != 0).all()


def test_weights_of_a_point_sum_to_one(device, dtype, generator):
    points = random_points(generator, 1, 50, dtype=dtype).transpose(0, 1).contiguous().to(device)  # a batch each
    total = ops.gridding(points, (9, 4, 6)).sum((1, 2, 3, 4))
    torch.testing.assert_close(total, torch.ones_like(total), rtol=0, atol=4 * torch.finfo(dtype).eps)


@pytest.mark.parametrize(("batch", "n"), [(0, 5), (2, 0), (1, 1)])
def test_empty_and_single(batch, n, device, dtype):
    points = torch.zeros(batch, n, 3, dtype=dtype, device=device, requires_grad=True)
    values = torch.ones(batch, n, 2, dtype=dtype, device=device, requires_grad=True)
    volume = ops.gridding(points, 3, values=values)
    assert volume.shape == (batch, 3, 3, 3, 3)
    assert volume.sum().item() == 3 * batch * n
    volume.sum().backward()
    assert points.grad.shape == points.shape and values.grad.shape == values.shape


def test_no_value_channels(device):
    points = torch.zeros(1, 2, 3, device=device)
    assert torch.equal(ops.gridding(points, 3, values=points.new_empty(1, 2, 0)), ops.gridding(points, 3))


@pytest.mark.parametrize("case", ["contiguous", "transposed", "expanded"])
def test_gradcheck(case, device, generator):
    points = points_off_faces(generator, 2, 3, (4, 3, 3)).to(device).requires_grad_()
    values = torch.randn(2, 3, 2, generator=generator, dtype=torch.float64).to(device).requires_grad_()
    nondet = 0.0 if device.type == "cpu" else 1e-12

    def laid_out(x):
        if case == "transposed":
            return x.transpose(1, 2).contiguous().transpose(1, 2)
        return x[:1].expand_as(x) if case == "expanded" else x

    def function(points, values):
        return ops.gridding(laid_out(points), (4, 3, 3), values=laid_out(values))

    assert gradcheck(function, (points, values), nondet_tol=nondet)
    assert gradgradcheck(function, (points, values), nondet_tol=nondet)
    assert gradcheck(lambda points: ops.gridding(laid_out(points), 4), (points,), nondet_tol=nondet)


def test_only_the_wanted_gradient(device):
    points = torch.zeros(1, 3, 3, device=device)
    values = torch.ones(1, 3, 2, device=device, requires_grad=True)
    ops.gridding(points, 3, values=values).sum().backward()
    assert points.grad is None
    assert torch.equal(values.grad, torch.ones_like(values))


def test_density_of_noncontiguous_gradient(device, generator):
    points = random_points(generator, 2, 20).to(device).requires_grad_()
    volume = ops.gridding(points, 5)
    grad = torch.randn(volume.shape, generator=generator).to(device)
    (expected,) = torch.autograd.grad(volume, points, grad, retain_graph=True)
    permuted = grad.permute(0, 1, 4, 3, 2).contiguous().permute(0, 1, 4, 3, 2)
    assert torch.equal(torch.autograd.grad(volume, points, permuted)[0], expected)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ((torch.zeros(5, 3), 4), ValueError, r"points: expected shape \(B, N, 3\), got \(5, 3\)"),
        ((torch.zeros(1, 5, 2), 4), ValueError, r"points: expected shape \(B, N, 3\), got \(1, 5, 2\)"),
        (([[0, 0, 0]], 4), TypeError, r"points: expected a tensor of shape \(B, N, 3\), got list"),
        ((torch.zeros(1, 5, 3), 1), ValueError, "size: expected an integer from 2"),
        ((torch.zeros(1, 5, 3), (4, 4)), ValueError, "size: expected an integer from 2"),
        ((torch.zeros(1, 5, 3), 4.0), TypeError, "size: expected an integer or three, got float 4.0"),
        ((torch.zeros(1, 5, 3).half(), 4), TypeError, "points: expected dtype float32 or float64, got float16"),
        ((torch.zeros(1, 5, 3).long(), 4), TypeError, "points: expected dtype float32 or float64, got int64"),
    ],
)
@pytest.mark.parametrize("module", [ops, reference], ids=["ops", "reference"])
def test_errors(arguments, error, words, module):
    with pytest.raises(error, match=words):
        module.gridding(*arguments)


@pytest.mark.parametrize(
    ("values", "error", "words"),
    [
        (
            torch.zeros(1, 4, 2),
            ValueError,
            r"values: expected shape \(B, N, K\) with \(B, N\) = \(1, 5\), got \(1, 4, 2\)",
        ),
        (torch.zeros(1, 5), ValueError, r"values: expected shape \(B, N, K\), got \(1, 5\)"),
        (torch.zeros(1, 5, 2).double(), TypeError, "points and values: expected one dtype, got float32 and float64"),
    ],
)
@pytest.mark.parametrize("module", [ops, reference], ids=["ops", "reference"])
def test_errors_of_values(values, error, words, module):
    with pytest.raises(error, match=words):
        module.gridding(torch.zeros(1, 5, 3), 4, values=values)
