"""The conventions all operators share: axes, boundary, determinism, and reports from users of other packages."""

import numpy as np
import pytest
import torch

from tests.ops.common import random_points
from touchnet import ops, reference


@pytest.fixture
def threads():
    """Sets the number of threads; puts it back."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("end", [0, 1])
def test_gridding_and_samplers_share_one_axis_order(axis, end, device):
    size = (3, 4, 5)
    point = torch.zeros(1, 1, 3, device=device)
    point[..., axis] = 2 * end - 1
    volume = ops.gridding(point, size)
    where = volume[0, 0].nonzero()[:, axis]
    assert (where == end * (size[axis] - 1)).all()
    assert ops.trilinear_sample(volume, point).item() == (volume**2).sum().item()


def test_one_feature_at_a_corner_is_read_back_there(shared_data, device):
    case = np.load(shared_data / "cases" / "O05_axis_order.npz")
    arrays = {name: torch.from_numpy(case[name]).to(device) for name in case.files}
    feature = next(a for a in arrays.values() if a.dim() == 5).float()
    volume = torch.zeros(1, 1, 4, 4, 4, device=device)
    volume[0, 0, 3, 0, 0] = 1
    assert torch.equal(feature, volume)
    points = torch.tensor([[[1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]]], device=device)
    assert ops.trilinear_sample(feature, points).flatten().tolist() == [1.0, 0.0]
    assert ops.gridding(points[:, :1], 4)[0, 0, 3, 0, 0] == 1


def test_upper_boundary_belongs_to_the_last_cell(shared_data, device, dtype):
    points = torch.from_numpy(np.load(shared_data / "cases" / "O01_upper_boundary.npy")).reshape(1, -1, 3)
    points = points.to(device, dtype)
    for size in (2, 3, 8):
        volume = ops.gridding(points.transpose(0, 1).contiguous(), size)
        assert volume.isfinite().all()
        total = volume.sum((1, 2, 3, 4))
        torch.testing.assert_close(total, torch.ones_like(total), rtol=0, atol=2 * torch.finfo(dtype).eps)
        assert torch.equal(volume, reference.gridding(points.transpose(0, 1).contiguous(), size))
        features = torch.rand(1, 2, size, size, size, dtype=dtype, device=device)
        assert torch.equal(ops.trilinear_sample(features, points), reference.trilinear_sample(features, points))


def test_points_that_are_not_finite_leave_the_others_alone(shared_data, device, dtype, generator):
    points = torch.from_numpy(np.load(shared_data / "cases" / "O03_nan_inf_points.npy")).reshape(1, -1, 3)
    points = points.to(device, dtype)
    finite = points.isfinite().all(-1)[0]
    assert 0 < finite.sum() < len(finite)
    assert torch.equal(ops.gridding(points, 5), ops.gridding(points[:, finite], 5))
    volume = torch.randn(1, 3, 5, 5, 5, generator=generator, dtype=dtype).to(device).requires_grad_()
    for name in ("trilinear_sample", "addition_sample", "cubic_sample"):
        sample = getattr(ops, name)
        out = sample(volume, points)
        assert torch.equal(out[:, finite], sample(volume, points[:, finite]))
        assert out[:, ~finite].isnan().all()
        (with_others,) = torch.autograd.grad(out[:, finite].sum(), volume)
        (alone,) = torch.autograd.grad(sample(volume, points[:, finite]).sum(), volume)
        assert torch.equal(with_others, alone)


@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last_3d], ids=["first", "last"])
def test_same_bits_for_every_number_of_threads(layout, dtype, threads, generator):
    points = random_points(generator, 2, 30_000, dtype=dtype)
    points[1] *= 0.05  # a crowd in few cells beside an even spread
    values = torch.randn(2, 30_000, 3, generator=generator, dtype=dtype)
    volume = torch.randn(2, 16, 12, 13, 14, generator=generator, dtype=dtype).contiguous(memory_format=layout)

    def everything():
        leaves = [x.clone().requires_grad_() for x in (points, values, volume)]
        p, v, features = leaves
        results = [
            ops.gridding(p, (12, 13, 14), values=v, memory_format=layout),
            ops.trilinear_sample(features, p),
            ops.addition_sample(features, p),
            ops.cubic_sample(features[:, :4], p),
            ops.gridding_reverse(features[:, :1].square()),
        ]
        weights = torch.Generator().manual_seed(1)
        for result in results:
            result.backward(torch.randn(result.shape, generator=weights, dtype=dtype))
        return results + [leaf.grad for leaf in leaves]

    threads(1)
    expected = everything()
    for count in (2, 3, 7):
        threads(count)
        for a, b in zip(everything(), expected, strict=True):
            assert torch.equal(a, b)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [(16, 17, 18), (64, 64, 64)])  # divided by points, by rows of the volume
def test_very_many_points_in_a_volume(size, dtype, threads, generator):
    points = 1.1 * random_points(generator, 2, 70_000, dtype=dtype)  # some outside
    points[0, 123] = torch.nan
    threads(1)
    volume = ops.gridding(points, size)
    for count in (2, 3, 7):
        threads(count)
        assert torch.equal(ops.gridding(points, size), volume)
    exact = reference.gridding(points.double(), size)
    error = (volume.double() - exact).abs().max() / exact.max()
    assert error < (5e-6 if dtype == torch.float32 else 1e-14)


def test_backward_is_repeatable_bit_for_bit(threads, generator):
    threads(2)
    points = (0.01 + 0.1 * torch.rand(1, 500, 3, generator=generator)).requires_grad_()  # all in one cell
    volume = torch.randn(1, 4, 4, 4, 4, generator=generator, requires_grad=True)
    grads = [
        torch.autograd.grad(ops.trilinear_sample(volume, points).square().sum(), (volume, points)) for _ in range(10)
    ]
    grids = [torch.autograd.grad(ops.gridding(points, 4).square().sum(), points) for _ in range(10)]
    assert all(torch.equal(a, b) for row in grads for a, b in zip(row, grads[0], strict=True))
    assert all(torch.equal(row[0], grids[0][0]) for row in grids)


def test_deterministic_algorithms_on_cuda(device, generator):
    if device.type == "cpu":
        pytest.skip("the CPU kernels have one order")
    points = random_points(generator, 2, 5000).to(device).requires_grad_()
    volume = torch.randn(2, 5, 8, 8, 8, generator=generator).to(device).requires_grad_()
    torch.use_deterministic_algorithms(True)
    try:
        grids = [ops.gridding(points, 8) for _ in range(5)]
        grads = [torch.autograd.grad(ops.trilinear_sample(volume, points).square().sum(), volume)[0] for _ in range(5)]
    finally:
        torch.use_deterministic_algorithms(False)
    assert all(torch.equal(grid, grids[0]) for grid in grids)
    assert all(torch.equal(grad, grads[0]) for grad in grads)
    torch.testing.assert_close(grids[0].cpu(), ops.gridding(points.cpu(), 8))


@pytest.mark.parametrize("name", ["trilinear_sample", "addition_sample", "cubic_sample"])
def test_autocast_computes_in_float32(name, device, generator):
    volume = torch.randn(1, 4, 4, 4, 4, generator=generator).to(device).bfloat16().requires_grad_()
    points = random_points(generator, 1, 20).to(device)
    with torch.autocast(device.type, dtype=torch.bfloat16):
        out = getattr(ops, name)(volume, points)
        low = getattr(ops, name)(volume, points.bfloat16())
        exact = getattr(ops, name)(volume.double().detach(), points.double())
    assert out.dtype == low.dtype == torch.float32 and exact.dtype == torch.float64
    assert torch.equal(out, getattr(ops, name)(volume.float(), points))
    out.sum().backward()
    assert volume.grad.dtype == torch.bfloat16


def test_autocast_of_gridding(device, generator):
    points = random_points(generator, 1, 20).to(device)
    with torch.autocast(device.type, dtype=torch.bfloat16):
        volume = ops.gridding(points, 4, values=points.bfloat16())
        back = ops.gridding_reverse(volume[:, :1].bfloat16())
    assert volume.dtype == back.dtype == torch.float32
    assert torch.equal(volume, ops.gridding(points, 4, values=points.bfloat16().float()))


def test_half_precision_volume_on_cuda(device, generator):
    if device.type == "cpu":
        pytest.skip("refused on the CPU: test_sampling.py")
    points = random_points(generator, 1, 50).to(device)
    for dtype in (torch.float16, torch.bfloat16):
        volume = torch.randn(1, 8, 4, 4, 4, generator=generator).to(device, dtype).requires_grad_()
        out = ops.trilinear_sample(volume, points)
        assert out.dtype == dtype
        exact = ops.trilinear_sample(volume.float(), points)
        torch.testing.assert_close(out, exact.to(dtype))
        out.float().sum().backward()
        assert volume.grad.dtype == dtype


@pytest.mark.parametrize(
    "call",
    [
        lambda x: ops.gridding(x, 4),
        lambda x: ops.trilinear_sample(torch.zeros(2, 1, 3, 3, 3), x),
        lambda x: ops.addition_sample(torch.zeros(2, 1, 3, 3, 3), x),
        lambda x: ops.cubic_sample(torch.zeros(2, 1, 3, 3, 3), x),
    ],
)
def test_vmap_is_refused_clearly(call):
    with pytest.raises(NotImplementedError, match="fold the mapped axis into the batch"):
        torch.vmap(call)(torch.zeros(3, 2, 5, 3))


def test_a_million_points(generator):
    points = random_points(generator, 1, 1_000_000)
    volume = torch.randn(1, 16, 16, 16, 16, generator=generator).contiguous(memory_format=torch.channels_last_3d)
    out = ops.trilinear_sample(volume, points)
    some = torch.randint(1_000_000, (200,), generator=generator)
    torch.testing.assert_close(out[:, some], reference.trilinear_sample(volume, points[:, some]), rtol=1e-5, atol=1e-5)
    assert ops.gridding(points, 16).sum().item() == pytest.approx(1_000_000, rel=1e-4)
