"""The buffered query of volumes and head against the plain formula."""

from itertools import pairwise

import pytest
import torch
from torch import nn

from touchnet import ops
from touchnet.models.query import HeadQuery
from touchnet.ops import octree_marching_cubes


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
def test_equals_the_plain_formula(count, sample):
    volumes, head = make()
    points = torch.rand(count, 3, generator=torch.Generator().manual_seed(1)) * 2.2 - 1.1
    with torch.no_grad():
        expected = head(torch.cat([sample(volume, points[None]) for volume in volumes], 2))[0, :, 0]
    logits = HeadQuery(volumes, head, sample=sample, sigmoid=False, chunk=100)(points)
    largest = expected.abs().max().item() if count else 0
    torch.testing.assert_close(logits, expected, rtol=0, atol=2e-6 * largest + 1e-12)
    torch.testing.assert_close(HeadQuery(volumes, head, sample=sample)(points), expected.sigmoid(), rtol=0, atol=2e-6)


def test_buffers_are_kept_and_results_are_not():
    query = HeadQuery(*make(), chunk=50)
    points = torch.zeros(120, 3)
    buffers = [t.data_ptr() for t in (*query.samples, *query.hidden)]
    first, second = query(points), query(points + 0.5)
    assert buffers == [t.data_ptr() for t in (*query.samples, *query.hidden)]
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
