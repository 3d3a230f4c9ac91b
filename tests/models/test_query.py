"""The buffered query of volumes and head against the plain formula."""

from itertools import pairwise

import pytest
import torch
from torch import nn

from touchnet import ops
from touchnet.models.query import HeadQuery
from touchnet.ops import octree_marching_cubes
from touchnet.ops.head import CompiledHead


def make(channels=(16, 8, 4), sizes=(8, 5, 3), seed=0):
    generator = torch.Generator().manual_seed(seed)
    volumes = [
        torch.randn(1, c, s, s, s, generator=generator).contiguous(memory_format=torch.channels_last_3d)
        for c, s in zip(channels, sizes, strict=True)
    ]
    widths = [sum(channels), 64, 128, 32, 1]
    layers = []
    for n, m in pairwise(widths):
        layer = nn.Linear(n, m)
        with torch.no_grad():
            layer.weight.normal_(0, n**-0.5, generator=generator)
            layer.bias.normal_(0, 0.1, generator=generator)
        layers += [layer, nn.ReLU()]
    return volumes, nn.Sequential(*layers[:-1])


@pytest.mark.parametrize("count", [0, 1, 99, 100, 101, 250])
@pytest.mark.parametrize("sample", [ops.trilinear_sample, ops.addition_sample], ids=["FI", "FA"])
@pytest.mark.parametrize("compiled", [True, False])
def test_equals_the_plain_formula(count, sample, compiled):
    volumes, head = make()
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) * 2.2 - 1.1
    with torch.no_grad():
        expected = head(torch.cat([sample(volume, points[None]) for volume in volumes], 2))[0, :, 0]
    logits = HeadQuery(volumes, head, sample=sample, sigmoid=False, chunk=100, compiled=compiled)(points)
    largest = expected.abs().max().item() if count else 0
    torch.testing.assert_close(logits, expected, rtol=0, atol=2e-6 * largest + 1e-12)
    occupancy = HeadQuery(volumes, head, sample=sample, compiled=compiled)(points)
    torch.testing.assert_close(occupancy, expected.sigmoid(), rtol=0, atol=2e-6)


@pytest.mark.skipif(not CompiledHead.is_supported(), reason="no AVX2")
@pytest.mark.parametrize("widths", [(3, 1), (1, 5, 1), (7, 130, 6, 1)])
def test_compiled_widths_that_do_not_fill_a_register_block(widths):
    generator = torch.Generator().manual_seed(0)
    volume = torch.randn(1, 5, 4, 3, 6, generator=generator)  # channels first, not a cube
    sizes = (5, *widths)
    head = nn.Sequential(*[m for n, k in pairwise(sizes) for m in (nn.Linear(n, k), nn.ReLU())][:-1])
    points = torch.rand(101, 3, generator=generator) * 2.2 - 1.1
    with torch.no_grad():
        expected = head(ops.trilinear_sample(volume, points[None]))[0, :, 0]
    found = HeadQuery([volume], head, sigmoid=False)(points)
    torch.testing.assert_close(found, expected, rtol=0, atol=2e-6 * expected.abs().max().item())


@pytest.mark.skipif(not CompiledHead.is_supported(), reason="no AVX2")
def test_both_instruction_sets_give_the_same_bits():
    volumes, head = make()
    layers = [layer for layer in head if isinstance(layer, nn.Linear)]
    weights, biases = ([getattr(layer, name).detach() for layer in layers] for name in ("weight", "bias"))
    points = torch.rand(1000, 3, generator=torch.Generator().manual_seed(1)) * 2.2 - 1.1
    points[7] = torch.nan
    narrow, wide = (CompiledHead(volumes, weights, biases, trilinear=True, wide=wide)(points) for wide in (False, True))
    assert torch.equal(narrow.isnan(), wide.isnan()) and narrow.isnan().sum() == 1
    assert torch.equal(narrow.nan_to_num(), wide.nan_to_num())


@pytest.mark.skipif(not CompiledHead.is_supported(), reason="no AVX2")
def test_compiled_values_depend_on_the_point_alone():
    query = HeadQuery(*make(), sigmoid=False)
    points = torch.rand(20_000, 3, generator=torch.Generator().manual_seed(2)) * 2 - 1
    values = query(points)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        assert torch.equal(query(points), values)
    finally:
        torch.set_num_threads(threads)
    assert torch.equal(query(points[1234:1301]), values[1234:1301])
    assert torch.equal(query(points.double()[::2]), values[::2])


@pytest.mark.parametrize("compiled", [True, False])
def test_a_point_that_is_not_finite_has_no_value(compiled):
    points = torch.tensor([[0.1, 0.2, 0.3], [0.1, float("nan"), 0.3], [float("inf"), 0.0, 0.0], [0.3, 0.2, 0.1]])
    values = HeadQuery(*make(), compiled=compiled)(points)
    assert values.isnan().tolist() == [False, True, True, False]


@pytest.mark.skipif(not CompiledHead.is_supported(), reason="no AVX2")
def test_compiled_octree_equals_dense_with_a_network():
    query = HeadQuery(*make(), sigmoid=False)
    axis = torch.linspace(-1, 1, 33)
    points = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    volume = query(points).reshape(33, 33, 33)
    level = volume.median().item()
    dense = ops.marching_cubes(volume, level)
    octree = octree_marching_cubes(query, resolution=32, level=level, coarse=32)
    assert sorted(map(tuple, dense[0].tolist())) == sorted(map(tuple, octree[0].tolist()))
    assert len(dense[1]) == len(octree[1])


def test_buffers_are_kept_and_results_are_not():
    query = HeadQuery(*make(), chunk=50, compiled=False)
    points = torch.zeros(120, 3)
    buffers = [t.data_ptr() for t in (*query.compute.samples, *query.compute.hidden)]
    first, second = query(points), query(points + 0.5)
    assert buffers == [t.data_ptr() for t in (*query.compute.samples, *query.compute.hidden)]
    assert torch.equal(first, query(points)) and not torch.equal(first, second)


def test_it_is_a_field_for_the_extraction():
    volumes, head = make()
    query = HeadQuery(volumes, head, sigmoid=False)
    level = query(torch.rand(100, 3) * 2 - 1).median().item()
    assert len(octree_marching_cubes(query, resolution=16, level=level, coarse=8)[1]) > 0


def test_refusals():
    volumes, head = make()
    with pytest.raises(ValueError, match=r"head: expected 24 inputs .* got 28 and 1"):
        HeadQuery(volumes[:2], head)
    with pytest.raises(ValueError, match=r"volumes: expected \(1, C, X, Y, Z\) each, got \[\(2, 28, 3, 3, 3\)\]"):
        HeadQuery([torch.zeros(2, 28, 3, 3, 3)], head)
    with pytest.raises(TypeError, match="head: expected Linear layers with ReLU"):
        HeadQuery(volumes, nn.Sequential(head[0], nn.Sigmoid(), nn.Linear(64, 1)))
    with pytest.raises(ValueError, match="head: expected at least two Linear"):
        HeadQuery(volumes, nn.Sequential(head[0], nn.ReLU()))
    with pytest.raises(ValueError, match=r"points: expected shape \(M, 3\), got \(1, 5, 3\)"):
        HeadQuery(volumes, head)(torch.zeros(1, 5, 3))
