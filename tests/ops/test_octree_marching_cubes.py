"""Octree marching cubes: equal to the dense mesh where it must be, few evaluations, gradients, clear refusals."""

from itertools import product

import pytest
import torch

from tests.ops.surfaces import (
    RANDOM_VOLUMES,
    SURFACES,
    Table,
    assert_closed,
    assert_same_mesh,
    ball,
    crossed_cell_corners,
    euler_number,
    join,
    on_lattice,
    signed_volume,
    small_volumes,
)
from touchnet import reference
from touchnet.ops import marching_cubes, octree_marching_cubes

BOTH = pytest.mark.parametrize(
    "function", [octree_marching_cubes, reference.octree_marching_cubes], ids=["ops", "reference"]
)


class Counted:
    """A field that counts its points and remembers the size of its largest batch."""

    def __init__(self, field):
        self.field, self.points, self.largest = field, 0, 0

    def __call__(self, points):
        self.points += len(points)
        self.largest = max(self.largest, len(points))
        return self.field(points)


# Nothing lost, nothing extra.


@pytest.mark.parametrize("kind", RANDOM_VOLUMES)
def test_equals_the_dense_mesh_where_every_point_is_seen(kind, generator):
    for volume, level in small_volumes(generator, kind, 40):
        table = Table(volume)
        resolution = [n - 1 for n in volume.shape]
        assert_same_mesh(
            octree_marching_cubes(table, resolution=resolution, level=level), marching_cubes(volume, level)
        )
        assert torch.equal(table.asked, torch.ones_like(table.asked))


@pytest.mark.parametrize("kind", RANDOM_VOLUMES)
def test_equals_the_reference_in_mesh_and_in_queries(kind, generator):
    meshes = []
    for n, (volume, level) in enumerate(small_volumes(generator, kind, 12)):
        arguments = {"resolution": [m - 1 for m in volume.shape], "level": level, "coarse": 1 + n % 3}
        if n % 2:
            arguments["seeds"] = 2.4 * torch.rand(2, 3, generator=generator) - 1.2
        ours, expected = Table(volume), Table(volume)
        try:
            mesh = reference.octree_marching_cubes(expected, **arguments)
        except ValueError as error:
            with pytest.raises(ValueError, match="no surface") as caught:
                octree_marching_cubes(ours, **arguments)
            assert str(caught.value) == str(error)
            continue
        meshes.append(octree_marching_cubes(ours, **arguments))
        assert_same_mesh(meshes[-1], mesh)
        assert torch.equal(ours.asked, expected.asked)
        assert ours.asked.max() == 1
    if meshes:
        assert_closed(*join(meshes))


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("resolution", [97, 128])
def test_equals_the_dense_mesh_of_a_surface_with_few_evaluations(name, resolution):
    field = Counted(SURFACES[name])
    mesh = octree_marching_cubes(field, resolution=resolution, level=0.0)
    volume = on_lattice(SURFACES[name], resolution)
    assert_same_mesh(mesh, marching_cubes(volume, 0.0))
    assert_closed(*mesh)
    assert field.points <= 65**3 + 1.3 * crossed_cell_corners(volume)


def test_every_ball_around_a_coarse_point_is_found(generator):
    centres = torch.randint(-6, 7, (12, 3), generator=generator) / 8
    radii = 0.02 + 0.1 * torch.rand(12, generator=generator)

    def field(points):
        return (radii - (points[:, None] - centres).norm(dim=-1)).max(1).values - 0.3 * (points[:, 0] > 0.9)

    mesh = octree_marching_cubes(field, resolution=96, level=0.0, coarse=16)
    volume = on_lattice(lambda p: field(p.reshape(-1, 3)).view(p.shape[:-1]), 96)
    assert_same_mesh(mesh, marching_cubes(volume, 0.0))


def test_several_crossings_of_one_coarse_edge_are_all_followed():
    # Three shells, one inside the other, between two neighbouring coarse points.
    def field(points):
        radius = points.norm(dim=-1)
        return torch.minimum(0.3 - radius, torch.maximum(0.1 - radius, radius - 0.2))

    mesh = octree_marching_cubes(field, resolution=64, level=0.0, coarse=2)
    assert_same_mesh(mesh, marching_cubes(on_lattice(field, 64), 0.0))
    assert euler_number(*mesh) == 6


def test_the_mesh_does_not_depend_on_chunk_threads_or_coarse(generator):
    field = SURFACES["bottle"]
    seeds = octree_marching_cubes(field, resolution=20, level=0.0)[0][:50]
    wanted = octree_marching_cubes(field, resolution=80, level=0.0)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(3)
        for arguments in ({"chunk": 1000}, {"coarse": 20}, {"coarse": 100}, {"seeds": seeds}):
            counted = Counted(field)
            mesh = octree_marching_cubes(counted, resolution=80, level=0.0, **arguments)
            assert torch.equal(mesh[0], wanted[0]) and torch.equal(mesh[1], wanted[1])
            assert counted.largest <= arguments.get("chunk", 1 << 20)
    finally:
        torch.set_num_threads(threads)


def test_a_solid_that_meets_the_border_is_closed_there():
    for resolution in (7, 16, 33):
        mesh = octree_marching_cubes(lambda points: points[:, 0] + 0.3, resolution=resolution, level=0.0, coarse=4)
        assert_same_mesh(mesh, marching_cubes(on_lattice(lambda points: points[..., 0] + 0.3, resolution), 0.0))
        assert_closed(*mesh)
        assert euler_number(*mesh) == 2
    mesh = octree_marching_cubes(lambda points: torch.ones(len(points)), resolution=12, coarse=3)
    assert_closed(*mesh)
    assert signed_volume(*mesh).item() == pytest.approx(8, rel=1e-2)


# Resolutions and boxes.


@pytest.mark.parametrize("resolution", [33, 50, 64, 65, 100])
def test_i13_any_resolution(resolution):
    centre = torch.tensor([0.05, -0.1, 0.02], dtype=torch.float64)
    mesh = octree_marching_cubes(ball(tuple(centre.tolist()), 0.6), resolution=resolution, level=0.0)
    assert signed_volume(*mesh).item() == pytest.approx(4 / 3 * torch.pi * 0.6**3, rel=0.01)
    assert (mesh[0].mean(0) - centre).abs().max() < 0.5 * 2 / resolution


def test_boxes_of_any_proportions():
    for dtype, box in product(
        (torch.float32, torch.float64), (((-1, -0.7, -0.9), (1.2, 0.8, 2)), ((-2, -1, -1), (1, 1, 1)))
    ):
        mesh = octree_marching_cubes(ball((0, 0, 0), 0.5), resolution=60, level=0.0, box=box, dtype=dtype)
        assert_closed(*mesh)
        assert signed_volume(*mesh).item() == pytest.approx(4 / 3 * torch.pi * 0.5**3, rel=0.01)


def test_a_single_resolution_gives_cubic_cells():
    asked = []

    def field(points):
        asked.append(points)
        return 1 - points.norm(dim=1)

    octree_marching_cubes(field, resolution=6, box=((0, 0, 0), (3, 1, 2)))
    assert [len(torch.cat(asked)[:, d].unique()) for d in range(3)] == [7, 3, 5]


def test_far_from_the_origin_points_are_asked_in_float64():
    box = torch.tensor([[5e6, 5e6, 5e6], [5e6 + 1, 5e6 + 1, 5e6 + 1]], dtype=torch.float64)
    field = ball(tuple(box.mean(0).tolist()), 0.4)
    with pytest.raises(ValueError, match=r"box: .* too far from the origin for coordinates in torch\.float32"):
        octree_marching_cubes(field, resolution=40, level=0.0, box=box)
    mesh = octree_marching_cubes(field, resolution=40, level=0.0, box=box, dtype=torch.float64)
    assert_closed(*mesh)
    assert signed_volume(*mesh).item() == pytest.approx(4 / 3 * torch.pi * 0.4**3, rel=0.01)


@pytest.mark.slow
def test_i15_many_vertices():
    field = ball((0, 0, 0), 0.9)
    mesh = octree_marching_cubes(field, resolution=299, level=0.0)
    assert_closed(*mesh)
    assert euler_number(*mesh) == 2
    assert_same_mesh(mesh, marching_cubes(on_lattice(field, 299), 0.0))


# Seeds.


@BOTH
def test_i09_a_part_between_the_coarse_points_is_found_by_a_seed_and_otherwise_not_at_all(function):
    box = ((-0.5,) * 3, (0.5,) * 3)
    big, small = ball((-0.1, 0, 0), 0.25), ball((0.34375, 0.03125, 0.03125), 0.02)

    def field(points):
        return torch.maximum(big(points), small(points))

    arguments = {"resolution": 128 if function is octree_marching_cubes else 48, "level": 0.0, "coarse": 16, "box": box}
    without = function(field, **arguments)
    assert_closed(*without)
    assert euler_number(*without) == 2
    for distance in (0.0, 0.01, -0.01):  # the seed need not lie on the surface
        seeds = torch.tensor([[0.34375 + 0.02 + distance, 0.03125, 0.03125], [torch.nan, 0, 0]])
        mesh = function(field, seeds=seeds, **arguments)
        assert_closed(*mesh)
        assert euler_number(*mesh) == 4
    if function is octree_marching_cubes:
        axis = torch.arange(129, dtype=torch.float64) / 128 - 0.5
        points = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).float().view(-1, 3)
        assert_same_mesh(mesh, marching_cubes(field(points).view(129, 129, 129), 0.0, box=box))


def test_seeds_anywhere_change_nothing_where_there_is_no_surface():
    wanted = octree_marching_cubes(ball((0, 0, 0), 0.5), resolution=40, level=0.0)
    seeds = torch.tensor([[3.0, 0, 0], [-1, -1, -1], [1, 1, 1], [0, 0, 0]])
    mesh = octree_marching_cubes(ball((0, 0, 0), 0.5), resolution=40, level=0.0, seeds=seeds)
    assert torch.equal(mesh[0], wanted[0]) and torch.equal(mesh[1], wanted[1])


# Gradients and normals.


class Ball(torch.nn.Module):
    def __init__(self, centre, radius):
        super().__init__()
        self.centre, self.radius = (torch.nn.Parameter(torch.tensor(x, dtype=torch.float64)) for x in (centre, radius))

    def forward(self, points):
        return self.radius - (points - self.centre).norm(dim=-1)


@BOTH
def test_gradients_equal_those_of_the_dense_mesh(function):
    grads = []
    for n in range(2):
        model = Ball([0.1, -0.05, 0.2], 0.55)
        if n == 0:
            vertices, faces = function(model, resolution=16, level=0.0, dtype=torch.float64, differentiable=True)
            plain = function(model, resolution=16, level=0.0, dtype=torch.float64)
            assert torch.equal(plain[0], vertices) and torch.equal(plain[1], faces) and not plain[0].requires_grad
        else:
            vertices, _ = marching_cubes(on_lattice(model, 16, torch.float64), 0.0)
            model = Ball([0.1, -0.05, 0.2], 0.55)
            axis = -1 + torch.arange(17, dtype=torch.float64) * 2 / 16
            points = torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1)
            vertices, _ = marching_cubes(model(points), 0.0)
        (vertices.sin().sum() + vertices.square().sum()).backward()
        grads.append((model.centre.grad, model.radius.grad))
    torch.testing.assert_close(grads[0], grads[1], rtol=1e-9, atol=1e-9)


def test_a_ball_is_fitted_through_its_mesh():
    model = Ball([0.2, -0.1, 0.1], 0.35)
    wanted_centre, wanted_radius = torch.tensor([-0.15, 0.1, 0.05], dtype=torch.float64), 0.6
    optimiser = torch.optim.Adam(model.parameters(), lr=0.03)
    for _ in range(80):
        vertices, _ = octree_marching_cubes(
            model, resolution=24, level=0.0, coarse=12, dtype=torch.float64, differentiable=True
        )
        loss = ((vertices - wanted_centre).norm(dim=1) - wanted_radius).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert model.centre.tolist() == pytest.approx(wanted_centre.tolist(), abs=0.01)
    assert model.radius.item() == pytest.approx(wanted_radius, abs=0.01)


def test_closing_vertices_have_no_gradient():
    slope = torch.tensor(1.0, requires_grad=True)
    vertices, _ = octree_marching_cubes(lambda p: slope * p[:, 0] + 0.3, resolution=8, level=0.0, differentiable=True)
    closing = (vertices.detach().abs() > 1).any(1)
    (gradient,) = torch.autograd.grad(vertices[closing, 1:].sum(), slope, retain_graph=True)
    assert gradient == 0
    (gradient,) = torch.autograd.grad(vertices[~closing, 0].mean(), slope)
    assert gradient.item() == pytest.approx(0.3, rel=1e-5)  # x = -0.3 / slope


@BOTH
def test_normals_are_those_of_the_field(function):
    model = Ball([0.1, -0.05, 0.2], 0.55)
    vertices, _, normals = function(model, resolution=12, level=0.0, dtype=torch.float64, normals=True)
    assert not normals.requires_grad
    torch.testing.assert_close(normals, torch.nn.functional.normalize(vertices - model.centre.detach(), dim=1))
    with pytest.raises(ValueError, match="normals: expected a field that autograd can follow"):
        function(lambda p: (0.5 - p.norm(dim=1)).detach(), resolution=8, level=0.0, normals=True)


# Refusals.


@BOTH
@pytest.mark.parametrize(
    ("field", "arguments", "error", "message"),
    [
        (lambda p: p, {}, ValueError, r"field: expected values of shape \(125,\) .* got \(125, 3\)"),
        (lambda p: p[:, :1], {}, ValueError, r"field: expected values of shape \(125,\) .* got \(125, 1\)"),
        (lambda p: p[:, 0].half(), {}, TypeError, r"field: .* float32 or float64, got a torch.float16 .* \(125,\)"),
        (lambda p: p[:, 0].long(), {}, TypeError, r"field: .* got a torch.int64"),
        (lambda p: p[:, 0].numpy(), {}, TypeError, "field: expected it to return a tensor .* got ndarray"),
        (lambda p: p[:, 0] / p[:, 0].abs(), {}, ValueError, "field: expected finite values, got 25 NaN or .* of 125"),
        (lambda p: p[:, 0], {"level": 2}, ValueError, r"no surface: .* level 2 \(minimum -1, maximum 1\)"),
        (lambda p: p[:, 0], {"level": float("inf")}, ValueError, "level: expected a finite number"),
        (lambda p: p[:, 0], {"resolution": 0}, ValueError, "resolution: .* got 0"),
        (lambda p: p[:, 0], {"resolution": (4, 4)}, ValueError, r"resolution: .* got \(4, 4\)"),
        (lambda p: p[:, 0], {"coarse": 0}, ValueError, "coarse: expected at least 1, got 0"),
        (lambda p: p[:, 0], {"chunk": 0}, ValueError, "chunk: expected at least 1, got 0"),
        (lambda p: p[:, 0], {"dtype": torch.float16}, TypeError, "dtype: expected float32 or float64"),
        (lambda p: p[:, 0], {"seeds": torch.zeros(3)}, ValueError, r"seeds: expected shape \(N, 3\), got \(3,\)"),
        (lambda p: p[:, 0], {"seeds": [[0, 0, 0]]}, TypeError, "seeds: expected a tensor"),
        (lambda p: p[:, 0], {"box": ((0, 0, 0), (1, 1, torch.inf))}, ValueError, "box: expected finite corners"),
    ],
)
def test_refusals(function, field, arguments, error, message):
    with pytest.raises(error, match=message):
        function(field, **{"resolution": 4, "level": 0.0} | arguments)
