"""Dense marching cubes: equal to the reference, and what can be counted by hand."""

import torch

from touchnet import reference
from touchnet.ops import marching_cubes


def test_one_inside_corner_has_six_vertices_and_eight_faces():
    volume = torch.zeros(2, 2, 2)
    volume[0, 0, 0] = 1
    vertices, faces = marching_cubes(volume)
    assert vertices.shape == (6, 3) and faces.shape == (8, 3)
    assert sorted(vertices[:, 0].tolist()) == [-1.002, -1, -1, -1, -1, 0]


def test_equals_the_reference():
    generator = torch.Generator().manual_seed(0)
    for n in range(100):
        shape = torch.randint(2, 6, (3,), generator=generator).tolist()
        volume = torch.randint(-1, 2, shape, generator=generator).double()
        if n % 2:
            volume = torch.randn(shape, generator=generator, dtype=torch.float64)
        if (volume >= 0).any():
            for ours, expected in zip(marching_cubes(volume, 0.0), reference.marching_cubes(volume, 0.0), strict=True):
                assert torch.equal(ours, expected)
