"""gridding_reverse against literals, its reference twin and finite differences."""

import math

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

from tests.ops.common import LAYOUTS, points_off_faces
from touchnet import ops, reference

TOLERANCE = {torch.float32: 2e-6, torch.float64: 1e-14}


def test_one_point_comes_back(device, dtype):
    points = torch.tensor([[[0.25, -0.5, 0.625]], [[-1.0, 1.0, 0.0]]], dtype=dtype, device=device)
    back = ops.gridding_reverse(ops.gridding(points, 3))
    assert back.shape == (2, 27, 3)
    row = (1 * 3 + 0) * 3 + 1  # the cell of the first point
    assert back[0, row].tolist() == [0.25, -0.5, 0.625]
    # The second point sits on a vertex between two cells along z: both give it back.
    assert back[1, 1 * 3 + 0].tolist() == [-1.0, 1.0, 0.0] and back[1, 1 * 3 + 1].tolist() == [-1.0, 1.0, 0.0]


def test_rows_without_a_point(device, dtype):
    volume = torch.zeros(1, 1, 2, 2, 3, dtype=dtype, device=device)
    volume[..., 0] = 1
    assert torch.equal(ops.gridding_reverse(volume, fill=-7.0)[0, 0].cpu(), torch.tensor([0.0, 0.0, -1.0], dtype=dtype))
    marked = ops.gridding_reverse(volume, fill=math.nan)
    assert marked.isnan().all(-1)[0].tolist() == [False] + [True] * 11  # no weight in the second cell; no other cells
    assert torch.equal(ops.gridding_reverse(-volume), torch.zeros(1, 12, 3, dtype=dtype, device=device))


@pytest.mark.parametrize("size", [(2, 2, 2), (5, 3, 4), (3, 4, 300)])
@pytest.mark.parametrize("fill", [0.0, math.nan])
def test_equals_reference(size, fill, device, dtype, generator):
    volume = torch.rand(2, 1, *size, generator=generator, dtype=dtype)
    volume = torch.where(torch.rand(volume.shape, generator=generator) < 0.6, 0, volume).to(device).requires_grad_()
    got, expected = ops.gridding_reverse(volume, fill=fill), reference.gridding_reverse(volume, fill=fill)
    torch.testing.assert_close(got, expected, rtol=0, atol=TOLERANCE[dtype], equal_nan=True)
    grad = torch.randn(got.shape, generator=generator, dtype=dtype).to(device)
    (a,) = torch.autograd.grad(got, volume, grad)
    (b,) = torch.autograd.grad(expected, volume, grad)
    scale = b.abs().max()
    torch.testing.assert_close(a / scale, b / scale, rtol=TOLERANCE[dtype] * 10, atol=TOLERANCE[dtype])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_gradcheck(layout, device, generator):
    volume = 0.1 + torch.rand(2, 1, 3, 4, 3, generator=generator, dtype=torch.float64)
    volume = volume.to(device).requires_grad_()
    nondet = 0.0 if device.type == "cpu" else 1e-12

    def function(volume):
        return ops.gridding_reverse(LAYOUTS[layout](volume))

    assert gradcheck(function, (volume,), nondet_tol=nondet)
    assert gradgradcheck(function, (volume,), nondet_tol=nondet)


def test_there_and_back_is_differentiable(device, generator):
    points = points_off_faces(generator, 1, 1, (4, 4, 4)).to(device).requires_grad_()

    def there_and_back(points):
        return ops.gridding_reverse(ops.gridding(points, 4), fill=0.0).sum(1)

    jacobian = torch.autograd.functional.jacobian(there_and_back, points).squeeze()
    assert jacobian.shape == (3, 3)
    assert gradcheck(there_and_back, (points,), nondet_tol=0.0 if device.type == "cpu" else 1e-12)


def test_empty_batch(device, dtype):
    volume = torch.zeros(0, 1, 3, 3, 3, dtype=dtype, device=device, requires_grad=True)
    out = ops.gridding_reverse(volume)
    out.sum().backward()
    assert out.shape == (0, 27, 3) and volume.grad.shape == volume.shape


@pytest.mark.parametrize(
    ("volume", "error", "words"),
    [
        (torch.zeros(1, 2, 3, 3, 3), ValueError, r"volume: expected shape \(B, 1, X, Y, Z\), got \(1, 2, 3, 3, 3\)"),
        (torch.zeros(1, 3, 3, 3), ValueError, r"volume: expected shape \(B, C, X, Y, Z\)"),
        (torch.zeros(1, 1, 3, 3, 1), ValueError, "at least 2 vertices"),
        (torch.zeros(1, 1, 3, 3, 3).int(), TypeError, "volume: expected dtype float32 or float64, got int32"),
    ],
)
@pytest.mark.parametrize("module", [ops, reference], ids=["ops", "reference"])
def test_errors(volume, error, words, module):
    with pytest.raises(error, match=words):
        module.gridding_reverse(volume)
