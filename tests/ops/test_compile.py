"""torch.compile: no graph break, same results, sound custom operators."""

import pytest
import torch

from tests.ops.common import random_points
from touchnet import ops
from touchnet.ops import sampling, splatting

GENERATOR = torch.Generator().manual_seed(3)
POINTS = random_points(GENERATOR, 2, 7)
VALUES = torch.randn(2, 7, 2, generator=GENERATOR)
VOLUME = torch.randn(2, 3, 4, 5, 6, generator=GENERATOR).contiguous(memory_format=torch.channels_last_3d)
DENSITY = torch.rand(2, 1, 3, 4, 3, generator=GENERATOR) + 0.1

CASES = {
    "gridding": (lambda points: ops.gridding(points, (4, 5, 6)), (POINTS,)),
    "gridding with values": (lambda points, values: ops.gridding(points, 4, values=values), (POINTS, VALUES)),
    "gridding_reverse": (lambda volume: ops.gridding_reverse(volume, fill=0.5), (DENSITY,)),
    "trilinear_sample": (ops.trilinear_sample, (VOLUME, POINTS)),
    "addition_sample": (ops.addition_sample, (VOLUME, POINTS)),
    "cubic_sample": (ops.cubic_sample, (VOLUME, POINTS)),
}


@pytest.fixture(autouse=True)
def fresh_compiler():
    torch.compiler.reset()


@pytest.mark.parametrize("name", CASES)
def test_full_graph_forward_and_backward(name):
    function, inputs = CASES[name]
    inputs = [x.detach().requires_grad_() for x in inputs]
    compiled = torch.compile(function, fullgraph=True, backend="aot_eager")
    got, expected = compiled(*inputs), function(*inputs)
    assert torch.equal(got, expected) and got.stride() == expected.stride()
    grad = torch.linspace(-1, 1, got.numel()).view(got.shape)
    grads = torch.autograd.grad(got, inputs, grad, allow_unused=True)
    expected_grads = torch.autograd.grad(expected, inputs, grad, allow_unused=True)
    for a, b in zip(grads, expected_grads, strict=True):
        assert (a is None) == (b is None)
        assert a is None or (torch.equal(a, b) and a.stride() == b.stride())


OPERATORS = {
    "gridding_forward": (splatting._gridding_forward, (POINTS, VALUES, [4, 5, 6], True)),
    "gridding_forward, no values": (splatting._gridding_forward, (POINTS, None, [4, 4, 4], False)),
    "gridding_backward": (splatting._gridding_backward, (VOLUME, POINTS, VALUES, True, True)),
    "gridding_reverse_forward": (splatting._gridding_reverse_forward, (DENSITY, 0.5)),
    "gridding_reverse_backward": (splatting._gridding_reverse_backward, (torch.ones(2, 36, 3), DENSITY)),
    "sample_forward": (sampling._sample_forward, ("cubic", VOLUME, POINTS)),
    "sample_backward_volume": (
        sampling._sample_backward_volume,
        ("trilinear", torch.ones(2, 7, 3), VOLUME, POINTS),
    ),
    "trilinear_backward_points": (sampling._trilinear_backward_points, (torch.ones(2, 7, 3), VOLUME, POINTS)),
}


@pytest.mark.parametrize("name", OPERATORS)
def test_opcheck(name):
    function, arguments = OPERATORS[name]
    torch.library.opcheck(function.operator, arguments, test_utils=("test_schema", "test_faketensor"))


@pytest.mark.slow
def test_inductor():
    """The default backend, on a function with work before and after the operators."""

    def function(points, volume):
        grid = ops.gridding(points * 0.9, (4, 5, 6))
        return (ops.trilinear_sample(volume * grid, points) * 2).relu().sum()

    points, volume = POINTS.clone().requires_grad_(), VOLUME.clone().requires_grad_()
    compiled = torch.compile(function, fullgraph=True)
    got = torch.autograd.grad(compiled(points, volume), (points, volume))
    expected = torch.autograd.grad(function(points, volume), (points, volume))
    for a, b in zip(got, expected, strict=True):
        torch.testing.assert_close(a, b)
