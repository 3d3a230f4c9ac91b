"""Dense marching cubes: the proof of the table, the promise on random fields, gradients, files, and clear refusals."""

import io

import numpy as np
import pytest
import torch
import trimesh
from torch.autograd import gradcheck, gradgradcheck

from tests.ops.surfaces import (
    RANDOM_VOLUMES,
    assert_closed,
    ball,
    euler_number,
    faults,
    join,
    on_lattice,
    signed_volume,
    small_volumes,
)
from touchnet import reference
from touchnet.data.files import write_mesh
from touchnet.ops import marching_cubes
from touchnet.ops._ext import _C
from touchnet.reference.cubes import CORNERS, EDGES, FACE_EDGES, FACES, cube_loops, cube_triangles

# The proof of docs/marching_cubes.md, over all 256 cases.


def sides_of(case: int) -> list[tuple[int, int]]:
    """Directed triangle sides of a cell, as pairs of its edges."""
    return [(t[i], t[(i + 1) % 3]) for t in cube_triangles(case) for i in range(3)]


def test_the_compiled_table_is_the_one_that_the_rules_give():
    assert _C.cube_table() == [[edge for t in cube_triangles(case) for edge in t] for case in range(256)]


def test_inside_a_cell_every_side_has_two_faces_and_no_side_off_its_loop_lies_in_a_cell_face():
    for case in range(256):
        sides = sides_of(case)
        assert len(set(sides)) == len(sides)
        border = {(loop[i], loop[(i + 1) % len(loop)]) for loop in cube_loops(case) for i in range(len(loop))}
        for side in sides:
            in_a_face = any(set(side) <= edges for edges in FACE_EDGES)
            assert in_a_face == (side in border)
            assert in_a_face != (side[::-1] in sides)


def test_a_cell_has_a_vertex_on_exactly_its_crossed_edges_and_one_fan_at_each():
    for case in range(256):
        crossed = {e for e, (a, b) in EDGES.items() if (case >> a ^ case >> b) & 1}
        assert {edge for t in cube_triangles(case) for edge in t} == crossed
        for edge in crossed:
            # Each triangle at the vertex leads from one side to the next; a fan is one unbroken chain of them.
            step = {t[(i + 1) % 3]: t[i - 1] for t in cube_triangles(case) for i in range(3) if t[i] == edge}
            (at,) = step.keys() - step.values()
            length = 0
            while at in step:
                at, length = step[at], length + 1
            assert length == len(step)


def test_two_cells_draw_the_same_segments_on_their_face_in_opposite_directions():
    for axis in range(3):
        near, far = FACES[2 * axis + 1], FACES[2 * axis]  # the shared face, as seen from the lower and the upper cell
        step = 4 >> axis
        rename = {e: e for e in EDGES} | {
            upper: lower
            for upper in FACE_EDGES[2 * axis]
            for lower in FACE_EDGES[2 * axis + 1]
            if {c | step for c in EDGES[upper]} == set(EDGES[lower])
        }
        assert {c | step for c in far} == set(near)
        for case in range(256):
            drawn = {s for s in sides_of(case) if set(s) <= FACE_EDGES[2 * axis + 1]}
            shared = sum((case >> c & 1) << (c ^ step) for c in near)
            for rest in range(16):
                neighbour = shared + sum((rest >> n & 1) << c for n, c in enumerate(near))
                seen = {s for s in sides_of(neighbour) if set(s) <= FACE_EDGES[2 * axis]}
                assert {(rename[b], rename[a]) for a, b in seen} == drawn


def test_segments_on_a_face_depend_on_its_four_signs_alone():
    for face, edges in zip(FACES, FACE_EDGES, strict=True):
        drawn: dict[tuple[int, ...], set] = {}
        for case in range(256):
            signs = tuple(case >> c & 1 for c in face)
            assert drawn.setdefault(signs, segments := {s for s in sides_of(case) if set(s) <= edges}) == segments


def test_three_vertices_of_a_triangle_are_never_on_one_line():
    # Three points on three different edges of a cube are on one line only if that line lies in one edge.
    for case in range(256):
        assert all(len(set(t)) == 3 for t in cube_triangles(case))
    ends = torch.tensor([[1e-3] * 3, [1 - 1e-3] * 3, [0.5] * 3, [1e-3, 0.5, 1 - 1e-3], [1 - 1e-3, 1e-3, 0.5]])
    smallest = min(
        torch.linalg.cross(b - a, c - a).norm().item()
        for case in range(256)
        for triangle in cube_triangles(case)
        for t in ends.double()
        for a, b, c in [
            [
                torch.tensor(CORNERS[EDGES[e][0]], dtype=torch.float64) + s * torch.eye(3, dtype=torch.float64)[e // 4]
                for e, s in zip(triangle, t, strict=True)
            ]
        ]
    )
    assert smallest > 1e-6


@pytest.mark.parametrize("axis", range(3))
def test_every_sign_field_of_two_neighbouring_cells_is_closed(axis):
    shape = [2, 2, 2]
    shape[axis] = 3
    fields = [torch.tensor([signs >> n & 1 for n in range(12)], dtype=torch.float32) for signs in range(1, 4096)]
    assert_closed(*join(marching_cubes(field.view(shape)) for field in fields))


# The promise.


@pytest.mark.parametrize("kind", RANDOM_VOLUMES)
def test_the_mesh_of_every_finite_field_is_closed(kind, generator):
    meshes = [marching_cubes(volume, level) for volume, level in small_volumes(generator, kind, 150)]
    assert all(signed_volume(*mesh) > 0 for mesh in meshes)
    assert_closed(*join(meshes))


def test_faults_are_seen():
    vertices, faces = marching_cubes(torch.ones(2, 2, 2))
    assert faults(vertices, faces[1:])["sides without a partner"] == 3
    turned = torch.cat([faces[1:], faces[:1].flip(1)])
    assert faults(vertices, turned)["sides used twice"] == 3
    assert faults(vertices, torch.where(faces == 1, 0, faces))["flat faces"] > 0
    two = torch.cat([vertices, vertices]), torch.cat([faces, faces + len(vertices)])
    pinched = torch.where(two[1] == len(vertices), 0, two[1])
    assert faults(two[0], pinched)["pinched vertices"] == 1
    assert signed_volume(vertices, faces.flip(1)) < 0


@pytest.mark.parametrize("kind", RANDOM_VOLUMES)
def test_equals_the_reference(kind, generator):
    for volume, level in small_volumes(generator, kind, 8):
        ours, expected = marching_cubes(volume, level), reference.marching_cubes(volume, level)
        assert torch.equal(ours[0], expected[0]) and torch.equal(ours[1], expected[1])
        assert ours[0].dtype == torch.float64 and ours[1].dtype == torch.int64


def test_rows_longer_than_a_word_equal_the_reference(generator):
    for depth in (62, 63, 64, 65, 129):
        volume = torch.randn(2, 2, depth, generator=generator)
        for ours, expected in zip(marching_cubes(volume, 0.0), reference.marching_cubes(volume, 0.0), strict=True):
            assert torch.equal(ours, expected)


def test_one_inside_corner_has_six_vertices_and_eight_faces():
    volume = torch.zeros(2, 2, 2)
    volume[0, 0, 0] = 1
    vertices, faces = marching_cubes(volume)
    assert vertices.shape == (6, 3) and faces.shape == (8, 3)
    assert sorted(vertices[:, 0].tolist()) == [-1.002, -1, -1, -1, -1, 0]


def test_an_all_inside_volume_is_the_closed_box():
    vertices, faces = marching_cubes(torch.ones(3, 4, 5), box=((0, 0, 0), (2, 3, 4)))
    assert_closed(vertices, faces)
    assert euler_number(vertices, faces) == 2
    assert vertices.min(0).values.tolist() == pytest.approx([-0.001] * 3)
    assert vertices.max(0).values.tolist() == pytest.approx([2.001, 3.001, 4.001])


def test_vertices_are_where_the_field_meets_the_level():
    volume = torch.zeros(3, 3, 3)
    volume[1, 1, 1] = 4
    vertices, faces = marching_cubes(volume, 1.0, box=((10, 20, 30), (12, 22, 32)))
    assert sorted(vertices.tolist()) == [
        [10.25, 21, 31], [11, 20.25, 31], [11, 21, 30.25], [11, 21, 31.75], [11, 21.75, 31], [11.75, 21, 31],
    ]  # fmt: skip
    assert len(faces) == 8 and signed_volume(vertices, faces) > 0


def test_a_value_at_the_level_is_inside_and_its_vertices_keep_their_distance():
    volume = torch.zeros(3, 3, 3)
    volume[1, 1, 1] = 1
    vertices, _ = marching_cubes(volume, 1.0)
    assert vertices.abs().amax().item() == pytest.approx(1e-3)


def test_diagonal_inside_corners_of_a_face_stay_joined():
    volume = torch.zeros(3, 4, 4)
    volume[1, 1, 1] = volume[1, 2, 2] = 1
    vertices, faces = marching_cubes(volume)
    assert euler_number(vertices, faces) == 2  # one piece


def test_a_level_between_two_float32_numbers_is_compared_in_float64():
    below, above = torch.tensor([0.1, 0.1]).double().tolist()[0], 0.1
    volume = torch.full((2, 2, 2), 0.1)  # float32(0.1) > 0.1
    assert below > above
    marching_cubes(volume, 0.1)
    with pytest.raises(ValueError, match="no surface"):
        marching_cubes(volume, 0.10000001)
    with pytest.raises(ValueError, match="no surface"):
        marching_cubes(volume, 1e39)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_result_does_not_depend_on_threads_or_layout(dtype, generator):
    volume = torch.randn(48, 50, 70, generator=generator).to(dtype)
    threads = torch.get_num_threads()
    try:
        found = []
        for n in (1, 2, 5):
            torch.set_num_threads(n)
            found.append(marching_cubes(volume, 0.3))
    finally:
        torch.set_num_threads(threads)
    found.append(marching_cubes(volume.permute(2, 1, 0).contiguous().permute(2, 1, 0), 0.3))
    assert_closed(*found[0])
    for other in found[1:]:
        assert torch.equal(found[0][0], other[0]) and torch.equal(found[0][1], other[1])


# Gradients.


def decided(generator: torch.Generator, *shape: int) -> torch.Tensor:
    """Values at least 0.5 from level 0, so that no sign changes and no crossing is clamped under a small step."""
    value = torch.rand(shape, generator=generator, dtype=torch.float64) + 0.5
    return torch.where(torch.rand(shape, generator=generator) < 0.5, -value, value)


def test_gradcheck_and_gradgradcheck(generator):
    volume = decided(generator, 3, 3, 4).requires_grad_()
    box = ((0, 0, 0), (1, 2, 5))
    assert gradcheck(lambda v: marching_cubes(v, 0.0, box=box)[0], volume)
    assert gradgradcheck(lambda v: marching_cubes(v, 0.0, box=box)[0], volume)
    assert gradcheck(lambda v: marching_cubes(v.transpose(0, 2), 0.0, box=box)[0], volume)


def test_gradient_equals_the_reference_and_is_zero_where_clamped(generator):
    for kind in ("white noise", "small integers", "border"):
        for volume, level in small_volumes(generator, kind, 5):
            grads = []
            for function in (marching_cubes, reference.marching_cubes):
                leaf = volume.double().clone().requires_grad_()
                vertices, _ = function(leaf, level)
                weights = torch.linspace(1, 2, vertices.numel(), dtype=torch.float64).view_as(vertices)
                grads.append(torch.autograd.grad((weights * vertices).sum(), leaf)[0])
            torch.testing.assert_close(grads[0], grads[1], rtol=1e-9, atol=1e-12)
    plateau = torch.zeros(3, 3, 3)
    plateau[1, 1, 1] = 1
    vertices, _ = marching_cubes(plateau.requires_grad_(), 1.0)
    vertices.sum().backward()
    assert plateau.grad is not None and plateau.grad.abs().max() == 0


def test_a_ball_is_fitted_through_its_mesh():
    points = torch.stack(torch.meshgrid(*[torch.linspace(-1, 1, 24)] * 3, indexing="ij"), -1)
    centre, radius = torch.tensor([0.2, -0.1, 0.1], requires_grad=True), torch.tensor(0.4, requires_grad=True)
    wanted_centre, wanted_radius = torch.tensor([-0.15, 0.1, 0.05], dtype=torch.float64), 0.6
    optimiser = torch.optim.Adam([centre, radius], lr=0.03)
    for _ in range(80):
        vertices, _ = marching_cubes(radius - (points - centre).norm(dim=-1), 0.0)
        loss = ((vertices - wanted_centre).norm(dim=1) - wanted_radius).square().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert centre.tolist() == pytest.approx(wanted_centre.tolist(), abs=0.01)
    assert radius.item() == pytest.approx(wanted_radius, abs=0.01)


# Normals.


def test_normals_of_a_ball_point_away_from_its_centre():
    centre = torch.tensor([0.1, 0.0, -0.05], dtype=torch.float64)
    volume = on_lattice(ball(tuple(centre.tolist()), 0.6), 32, torch.float64)
    for function in (marching_cubes, reference.marching_cubes):
        vertices, _, normals = function(volume, 0.0, normals=True)
        outwards = torch.nn.functional.normalize(vertices - centre, dim=1)
        assert (normals * outwards).sum(1).min() > 0.999
        assert normals.norm(dim=1).tolist() == pytest.approx([1.0] * len(normals))


def test_normals_exist_without_a_gradient_and_beyond_the_box():
    vertices, _, normals = marching_cubes(torch.ones(3, 3, 3), normals=True)
    axis = vertices.abs().argmax(1)
    assert torch.equal(normals, torch.eye(3, dtype=torch.float64)[axis] * vertices.gather(1, axis[:, None]).sign())
    flat = torch.zeros(5, 5, 5)
    flat[2, 2, 2] = 1e-45
    normals = marching_cubes(flat, 1e-45, normals=True)[2]
    assert normals.norm(dim=1).tolist() == pytest.approx([1.0] * len(normals))


# Known cases of other packages (CASES.md, group C).


def case(shared_data, name: str) -> torch.Tensor:
    return torch.from_numpy(np.load(shared_data / "cases" / name))


def test_i01_plateau_at_the_level(shared_data):
    vertices, faces = marching_cubes(case(shared_data, "I01_plateau_at_level_0.5.npy"))
    assert_closed(vertices, faces)
    assert euler_number(vertices, faces) == 2


def test_i03_no_surface_says_the_range(shared_data):
    with pytest.raises(ValueError, match=r"no surface: .* level 0.5 \(minimum 0.02, maximum 0.02\)"):
        marching_cubes(case(shared_data, "I03_all_outside.npy"))


def test_i05_solid_at_the_border(shared_data):
    vertices, faces = marching_cubes(case(shared_data, "I05_solid_touches_boundary.npy"))
    assert_closed(vertices, faces)
    assert euler_number(vertices, faces) == 2


def test_i07_values_that_are_not_finite_are_counted(shared_data):
    volume = case(shared_data, "I07_one_nan_inside_level_0.npy")
    with pytest.raises(ValueError, match="volume: expected finite values, got 1 NaN or infinite ones of 4913"):
        marching_cubes(volume, 0.0)
    volume[0, 0, :2] = torch.tensor([torch.inf, -torch.inf])
    with pytest.raises(ValueError, match="got 3 NaN or infinite"):
        marching_cubes(volume, 0.0)


def test_i11_scattered_values_at_the_level(shared_data):
    volume = case(shared_data, "I11_values_equal_level_0.npy")
    volume = volume if volume.is_floating_point() else volume.double()
    assert_closed(*marching_cubes(volume, 0.0))


# Files.


@pytest.mark.parametrize("offset", [0.0, 1e3, 5e6])
@pytest.mark.parametrize("size", [0.005, 1.0, 100.0])
def test_files_read_back_closed(tmp_path, generator, size, offset):
    # Ties and noise make vertices as close to each other as they can be.
    volume = torch.randint(-1, 2, (20, 20, 20), generator=generator).float()
    box = ((offset,) * 3, (offset + size,) * 3)
    vertices, faces = marching_cubes(volume, 0.0, box=box)
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
    for name in ("mesh.ply", "mesh.obj", "mesh.stl"):
        path = tmp_path / name
        try:
            write_mesh(path, mesh, cell=size / 19)
        except ValueError as error:
            assert name == "mesh.stl" and 1e-3 * size / 19 < 8 * np.spacing(np.float32(offset + size)), error
            continue
        back = trimesh.load_mesh(path)
        assert back.is_watertight and back.is_winding_consistent and back.volume > 0
        assert len(back.vertices) == len(vertices) and len(back.faces) == len(faces)
        assert_closed(torch.tensor(back.vertices), torch.tensor(back.faces))


def test_i17_volume_is_positive_in_every_format():
    vertices, faces = marching_cubes(on_lattice(ball((0, 0, 0), 0.7), 24), 0.0)
    mesh = trimesh.Trimesh(vertices.numpy(), faces.numpy(), process=False)
    for kind in ("ply", "obj", "stl", "glb"):
        written = io.BytesIO()
        write_mesh(written, mesh, kind=kind, cell=2 / 24)
        back = trimesh.load_mesh(io.BytesIO(written.getvalue()), file_type=kind)
        assert back.volume == pytest.approx(4 / 3 * np.pi * 0.7**3, rel=0.01)


# Refusals.


@pytest.mark.parametrize(
    ("volume", "arguments", "error", "message"),
    [
        (torch.zeros(3, 3), {}, ValueError, r"volume: expected shape \(X, Y, Z\), got \(3, 3\)"),
        (torch.zeros(3, 1, 3), {}, ValueError, r"volume: expected .* got \(3, 1, 3\)"),
        (torch.zeros(3, 3, 3).half(), {}, TypeError, r"\(3, 3, 3\): expected dtype float32 or float64, got float16"),
        (torch.zeros(3, 3, 4).int(), {}, TypeError, r"\(3, 3, 4\): expected dtype float32 or float64, got int32"),
        (np.zeros((3, 3, 3)), {}, TypeError, r"volume: expected a tensor .* got ndarray"),
        (torch.ones(3, 3, 3), {"level": float("nan")}, ValueError, "level: expected a finite number, got nan"),
        (torch.ones(3, 3, 3), {"box": ((0, 0), (1, 1))}, ValueError, r"box: .* got shape \(2, 2\)"),
        (torch.ones(3, 3, 3), {"box": ((0, 0, 0), (1, 0, 1))}, ValueError, "box: expected .* lower < upper"),
        (torch.ones(3, 3, 3), {"box": ((1e9,) * 3, (1e9 + 1e-4,) * 3)}, ValueError, "box: .* too far from the origin"),
    ],
)
@pytest.mark.parametrize("function", [marching_cubes, reference.marching_cubes], ids=["ops", "reference"])
def test_refusals(function, volume, arguments, error, message):
    with pytest.raises(error, match=message):
        function(volume, **arguments)
