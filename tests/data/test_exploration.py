"""Simulated touches: where they lie, what steers them, what the options change, how much they cover."""

import logging

import numpy as np
import point_cloud_utils as pcu
import pytest
import trimesh

from touchnet.data import ClosestPoints, GaussianProcess, Surface, coverage, simulate_touches
from touchnet.data.exploration import surface as surface_module
from touchnet.data.exploration.strokes import Starts, UpTheVariance
from touchnet.data.exploration.vectors import in_plane

STEP = 0.05


@pytest.fixture(scope="module")
def sphere() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=0.5)


@pytest.fixture(scope="module")
def bottle() -> trimesh.Trimesh:
    """A closed solid of revolution with a neck, 0.5 wide and 1 high."""
    profile = [[0, 0], [0.25, 0], [0.25, 0.55], [0.08, 0.75], [0.08, 1], [0, 1]]
    return trimesh.creation.revolve(profile, sections=64)


@pytest.fixture(scope="module")
def slotted() -> trimesh.Trimesh:
    """A unit block with a slot 0.2 wide (x from 0.4 to 0.6) and 0.7 deep from the top (z = 1), along y."""
    outline = np.array([[0, 0], [1, 0], [1, 1], [0.6, 1], [0.6, 0.3], [0.4, 0.3], [0.4, 1], [0, 1]], dtype=float)
    front = np.insert(outline, 1, 0.0, axis=1)
    vertices = np.concatenate([front, front + np.array([0, 1, 0])])
    cap = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [0, 4, 5], [0, 5, 7], [5, 6, 7]])
    sides = [[i, i + 8, (i + 1) % 8] for i in range(8)] + [[(i + 1) % 8, i + 8, (i + 1) % 8 + 8] for i in range(8)]
    mesh = trimesh.Trimesh(vertices, np.concatenate([cap, cap[:, ::-1] + 8, sides]), process=False)
    mesh.fix_normals()
    assert mesh.is_watertight and mesh.volume == pytest.approx(1 - 0.2 * 0.7)
    return mesh


def inside(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    faces = np.asarray(mesh.faces, dtype=np.int32)
    return pcu.triangle_soup_fast_winding_number(np.asarray(mesh.vertices), faces, np.ascontiguousarray(points)) > 0.5


def distances(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    return ClosestPoints(mesh.vertices, mesh.faces)(points)[2]


# -- closest points ----------------------------------------------------------------------------------------------------


def test_closest_point_by_hand():
    square = ClosestPoints([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0]], [[0, 1, 2], [0, 2, 3]])
    points, faces, distance = square([[1.5, 0.5, 3], [3, -1, 0], [-1, 1, 0], [1, 1, 0]])
    assert points.tolist() == [[1.5, 0.5, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0]]
    assert faces.tolist() == [0, 0, 1, 0]  # the last lies on the common edge: the lower index
    np.testing.assert_allclose(distance, [3, np.sqrt(2), 1, 0])
    assert square.of_one((1.5, 0.5, 3.0)) == ((1.5, 0.5, 0.0), 0, 3.0)


@pytest.mark.parametrize("n", [1, 3, 4, 5, 200, 3000])
def test_closest_points_equal_the_library_on_a_soup(n):
    rng = np.random.default_rng(n)
    corners = rng.uniform(-1, 1, (n, 1, 3)) + 0.2 * rng.standard_normal((n, 3, 3))
    vertices, faces = corners.reshape(-1, 3), np.arange(3 * n).reshape(-1, 3)
    x = rng.uniform(-1.5, 1.5, (400, 3))
    points, found, distance = ClosestPoints(vertices, faces)(x)
    expected, _, _ = pcu.closest_points_on_mesh(x, vertices, faces.astype(np.int32))
    np.testing.assert_allclose(distance, expected, rtol=1e-5, atol=1e-6)  # the library computes in float32
    np.testing.assert_allclose(np.linalg.norm(points - x, axis=1), distance, atol=1e-12)
    # barycentric coordinates: the point lies in its triangle
    weights = trimesh.triangles.points_to_barycentric(corners[found], points)
    assert weights.min() > -1e-6
    np.testing.assert_allclose((weights[:, :, None] * corners[found]).sum(1), points, atol=1e-6)


def test_closest_point_on_triangles_without_area():
    needle = ClosestPoints([[0, 0, 0], [1, 0, 0], [3, 0, 0], [5, 5, 5]], [[0, 1, 2], [3, 3, 3]])
    points, _, distance = needle([[2, 1, 0], [9, 0, 0], [5, 5, 6]])
    assert points.tolist() == [[2, 0, 0], [3, 0, 0], [5, 5, 5]]
    assert distance.tolist() == [1, 6, 1]


@pytest.mark.parametrize(
    ("vertices", "faces", "words"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], r"vertices should have shape \(V, 3\), got \(3, 2\)"),
        (np.zeros((3, 3)), np.zeros((0, 3)), r"faces should have shape \(F, 3\) with F ≥ 1, got \(0, 3\)"),
        (np.zeros((3, 3)), [[0, 1, 3]], "faces should index the 3 vertices, got 0 to 3"),
        (np.full((3, 3), np.nan), [[0, 1, 2]], "vertices should be finite"),
    ],
)
def test_closest_points_errors(vertices, faces, words):
    with pytest.raises(ValueError, match=words):
        ClosestPoints(vertices, faces)


# -- what every trajectory keeps ---------------------------------------------------------------------------------------


def test_contacts_lie_on_the_surface_with_its_outward_normals(bottle):
    touches = simulate_touches(bottle, 400, seed=3)
    assert touches.points.shape == touches.normals.shape == (400, 3)
    assert touches.points.dtype == touches.normals.dtype == touches.variance.dtype == np.float64
    assert touches.strokes.shape == touches.variance.shape == (400,) and touches.strokes.dtype == np.int64
    assert distances(bottle, touches.points).max() < 1e-12
    np.testing.assert_allclose(np.linalg.norm(touches.normals, axis=1), 1, atol=1e-12)
    assert not inside(bottle, touches.points + 1e-4 * touches.normals).any()
    below = inside(bottle, touches.points - 1e-4 * touches.normals)
    assert below.mean() > 0.9  # all but those on an edge, where the face's normal points along the other face


def test_strokes_are_counted_in_order_and_step_by_step(bottle):
    touches = simulate_touches(bottle, 500, seed=1, step=STEP, stroke_length=20)
    assert touches.strokes[0] == 0 and set(np.diff(touches.strokes)) == {0, 1}
    assert np.bincount(touches.strokes).max() == 20
    step = np.linalg.norm(np.diff(touches.points, axis=0), axis=1)[np.diff(touches.strokes) == 0]
    assert step.max() < 1.5 * STEP and step.min() > 0.5 * STEP
    assert np.median(step) == pytest.approx(STEP, rel=0.05)


def test_variance_is_the_process_s_before_each_touch(bottle):
    touches = simulate_touches(bottle, 300)
    assert touches.variance[0] == 1
    assert (touches.variance >= 0).all() and (touches.variance <= 1).all()
    first = np.flatnonzero(np.diff(touches.strokes)) + 1
    # a start is the best known place, so later starts are never better than earlier ones, and beat the slide before
    assert (np.diff(touches.variance[first]) <= 1e-12).all()
    assert (touches.variance[first] > touches.variance[first - 1]).all()


def test_same_seed_same_bytes_other_seed_other_start(sphere):
    a, b, c = (simulate_touches(sphere, 100, seed=seed) for seed in (5, 5, 6))
    for left, right in zip(a, b, strict=True):
        assert left.tobytes() == right.tobytes()
    assert np.linalg.norm(a.points[0] - c.points[0]) > 0.01


def test_the_mesh_s_own_frame_and_units(sphere):
    moved = sphere.copy()
    moved.apply_scale(250.0)
    moved.apply_translation([1e4, -300.0, 7.0])
    here, there = simulate_touches(sphere, 40, seed=2), simulate_touches(moved, 40, seed=2)
    np.testing.assert_allclose(there.points, here.points * 250 + [1e4, -300, 7], atol=1e-3)
    np.testing.assert_allclose(there.variance, here.variance, atol=1e-6)


def test_every_component_and_every_side_is_touched():
    parts = [trimesh.creation.box(extents=(0.3, 0.3, 0.3)).apply_translation([x, 0, 0]) for x in (0, 0.5, 1.0)]
    touches = simulate_touches(trimesh.util.concatenate(parts), 512)
    part = np.round(touches.points[:, 0] / 0.5).astype(int)
    assert set(part[:128]) == {0, 1, 2}
    for index in range(3):
        sides = {tuple(row) for row in np.round(touches.normals[part == index]).astype(int)}
        assert len(sides) == 6
    # one stroke goes over edges: a finger is not held by one face
    over = [len({tuple(row) for row in np.round(touches.normals[touches.strokes == s])}) for s in range(8)]
    assert max(over) > 1


def test_faces_without_area_and_unused_vertices_are_harmless(sphere):
    vertices = np.concatenate([sphere.vertices, [[50.0, 0, 0]]])
    faces = np.concatenate([sphere.faces, [[0, 0, 1], [3, 3, 3]]])
    touches = simulate_touches(trimesh.Trimesh(vertices, faces, process=False), 50)
    np.testing.assert_allclose(touches.points, simulate_touches(sphere, 50).points, atol=1e-12)


@pytest.mark.parametrize(
    ("kernel", "length_scale"), [("rbf", 0.1), ("matern32", 0.15), ("matern52", 0.1), ("thin_plate", 2.0)]
)
@pytest.mark.parametrize("noise", [1e-1, 1e-4])
def test_any_kernel_and_noise_explores(sphere, kernel, length_scale, noise):
    touches = simulate_touches(sphere, 300, kernel=kernel, length_scale=length_scale, noise=noise)
    assert np.isfinite(touches.points).all() and np.isfinite(touches.variance).all()
    assert coverage(sphere, touches.points, radius=0.15, samples=5000) > 0.75


# -- direction and restart ---------------------------------------------------------------------------------------------


def test_zero_gradient_falls_back_to_a_random_tangent(caplog):
    """G05: normalising a zero gradient must not give NaN."""
    steer = UpTheVariance(0.15, np.random.default_rng(0))

    class Record:
        def __init__(self, gradient):
            self.gradient = lambda: np.array(gradient)

    contact = ((0.0, 0.0, 0.5), (0.0, 0.0, 1.0))
    with caplog.at_level(logging.DEBUG, logger="touchnet"):
        directions = np.array([steer(Record(g), contact, 1.0) for g in ([0.0, 0, 0], [0.0, 0, -3], [1e-9, 0, 2])])
    assert len(caplog.records) == 3 and "random direction" in caplog.text
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    np.testing.assert_allclose(directions[:, 2], 0)
    assert np.abs(directions[0] - directions[1]).max() > 0.01
    # a small but certain gradient counts: where the variance is 1e-8, so is its slope
    assert steer(Record([0.0, 1e-8, 5.0]), contact, 1e-8) == (0.0, 1.0, 0.0)


def test_first_step_from_a_pole_goes_somewhere(sphere):
    """G05 on the whole: one touch at the pole of a sphere has no tangential gradient by symmetry."""
    starts = [simulate_touches(sphere, 2, seed=seed, start=[0, 0, 0.5]) for seed in range(4)]
    for touches in starts:
        np.testing.assert_allclose(touches.points[0], [0, 0, 0.5], atol=1e-12)
        assert np.linalg.norm(touches.points[1] - touches.points[0]) == pytest.approx(0.1, rel=0.1)
    assert np.ptp([touches.points[1, 0] for touches in starts]) > 0.01


@pytest.mark.parametrize(("kernel", "noise"), [("matern32", 1e-3), ("rbf", 0.0)])
def test_next_start_has_the_highest_variance_of_all_candidates(kernel, noise):
    """The lazy search equals asking every candidate, also after the jitter was raised and the factor built anew."""
    rng = np.random.default_rng(0)
    candidates = rng.uniform(-0.5, 0.5, (203, 3))
    gp = GaussianProcess(kernel, length_scale=0.3, noise=noise)
    starts = Starts(gp, candidates, np.zeros_like(candidates), 400)
    for added in (1, 1, 2, 10, 50, 3, 120):
        where = candidates[rng.integers(203)]
        gp.add(where + np.linspace(0, 0.01, added)[:, None])
        (point, _), highest = starts.next(rng)
        expected = gp.variance(candidates)
        assert highest == pytest.approx(expected.max(), abs=1e-9)
        assert gp.variance(np.array([point]))[0] == pytest.approx(expected.max(), abs=1e-9)
    assert (gp.jitter > 0) == (noise == 0)


def test_vector_in_plane():
    assert in_plane((3.0, 4.0, 7.0), (0.0, 0.0, 1.0)) == (0.6, 0.8, 0.0)
    assert in_plane((0.0, 0.0, 7.0), (0.0, 0.0, 1.0)) is None


@pytest.mark.parametrize("seed", [0, 1])
def test_exploration_is_not_trapped_on_a_sphere(sphere, seed):
    """G07: 512 steps reach more than 80 % of 200 equal-area patches, and more than a random walk does."""
    k = np.arange(200) + 0.5
    polar, turn = np.arccos(1 - k / 100), np.pi * (1 + 5**0.5) * k
    centres = 0.5 * np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], 1)

    def reached(points: np.ndarray) -> float:
        return len(set(np.linalg.norm(points[:, None] - centres, axis=-1).argmin(1))) / 200

    touches = simulate_touches(sphere, 512, seed=seed)
    assert reached(touches.points) > 0.85
    assert reached(touches.points[:128]) > 0.35
    walk = simulate_touches(sphere, 512, seed=seed, strategy="random_walk", stroke_length=512)
    assert reached(walk.points) < reached(touches.points) - 0.05


def test_stroke_ends_where_nothing_is_left_to_learn(sphere):
    patient = simulate_touches(sphere, 600, stop=0.0, stroke_length=1000)
    eager = simulate_touches(sphere, 600, stop=0.6, stroke_length=1000)
    assert eager.strokes[-1] > patient.strokes[-1]


# -- coverage ----------------------------------------------------------------------------------------------------------


def test_coverage_of_a_cap_by_hand(sphere):
    # a sphere of diameter 1 around a point of it with radius r holds a cap of area π r², of π in all
    for radius in (0.1, 0.3, 0.7):
        share = coverage(sphere, [[0, 0, 0.5]], radius=radius, samples=40_000)
        assert share == pytest.approx(radius**2, abs=0.01)
    assert coverage(sphere, np.zeros((0, 3)), radius=0.1) == 0
    doubled = sphere.copy().apply_scale(2)
    assert coverage(doubled, [[0, 0, 1.0]], radius=0.3, samples=40_000) == pytest.approx(0.09, abs=0.01)


@pytest.mark.slow
def test_the_process_covers_more_than_the_ways_to_compare_with(bottle):
    slab = trimesh.creation.box(extents=(1, 0.6, 0.2)).subdivide().subdivide()
    torus = trimesh.creation.torus(0.35, 0.15, major_sections=48, minor_sections=24)
    shares: dict[str, list[float]] = {"gp": [], "random_walk": [], "scan_lines": []}
    early: dict[str, list[float]] = {name: [] for name in shares}
    for mesh in (bottle, slab, torus):
        for strategy in shares:
            points = simulate_touches(mesh, 700, seed=1, strategy=strategy).points
            shares[strategy].append(coverage(mesh, points, radius=0.06, samples=20_000))
            early[strategy].append(coverage(mesh, points[:175], radius=0.12, samples=20_000))
    mean = {name: np.mean(values) for name, values in shares.items()}
    assert mean["gp"] > mean["random_walk"] + 0.05
    assert mean["gp"] > mean["scan_lines"] - 0.01
    assert np.mean(early["gp"]) > max(np.mean(early["random_walk"]), np.mean(early["scan_lines"])) + 0.03


# -- options -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("radius", [0.02, 0.05])
def test_finger_rests_only_where_it_fits(slotted, radius):
    touches = simulate_touches(slotted, 300, finger_radius=radius)
    centres = touches.points + radius * touches.normals
    assert distances(slotted, touches.points).max() < 1e-9
    assert distances(slotted, centres).min() > radius * (1 - 2e-3)
    assert not inside(slotted, centres).any()


def test_finger_wider_than_a_slot_leaves_it_untouched(slotted):
    def deep(touches) -> np.ndarray:
        points = touches.points
        return (points[:, 0] > 0.39) & (points[:, 0] < 0.61) & (points[:, 2] > 0.2) & (points[:, 2] < 0.85)

    assert deep(simulate_touches(slotted, 400)).sum() > 10
    wide = simulate_touches(slotted, 400, finger_radius=0.15)
    middle = (wide.points[:, 1] > 0.01) & (wide.points[:, 1] < 0.99)
    assert not (deep(wide) & middle).any()
    # the top edges of the slot are touched by a finger that sinks in a little
    assert coverage(slotted, wide.points, radius=0.2, samples=5000) > 0.6


def test_finger_normals_fan_out_over_a_sharp_edge():
    box = trimesh.creation.box(extents=(1, 1, 1))
    touches = simulate_touches(box, 400, finger_radius=0.1)
    across = np.abs(touches.normals).max(1) < 0.99
    assert across.any()  # between the faces' normals
    edge = np.sort(np.abs(touches.points[across]), axis=1)
    np.testing.assert_allclose(edge[:, 1:], 0.5, atol=1e-9)


def test_unreachable_box_and_function(sphere):
    table = [[-1, -1, -1], [1, 1, -0.2]]
    boxed = simulate_touches(sphere, 200, unreachable=table)
    called = simulate_touches(sphere, 200, unreachable=lambda points: points[:, 2] <= -0.2)
    assert boxed.points[:, 2].min() > -0.2
    assert coverage(sphere, boxed.points, radius=0.2, samples=5000) > 0.65
    np.testing.assert_array_equal(boxed.points, called.points)
    for strategy in ("uniform", "scan_lines", "random_walk"):
        assert simulate_touches(sphere, 100, unreachable=table, strategy=strategy).points[:, 2].min() > -0.2


def test_position_noise_and_normal_noise_are_as_asked(sphere):
    touches = simulate_touches(sphere, 400, position_noise=0.01, normal_noise=5.0, seed=1)
    radial = np.linalg.norm(touches.points, axis=1) - 0.5
    assert np.std(radial) == pytest.approx(0.01, rel=0.15)
    clean = simulate_touches(sphere, 400, normal_noise=5.0, seed=1)
    assert distances(sphere, clean.points).max() < 1e-12
    cosine = (clean.normals * clean.points / np.linalg.norm(clean.points, axis=1, keepdims=True)).sum(1)
    tilt = np.degrees(np.arccos(cosine.clip(-1, 1)))
    assert np.sqrt((tilt**2).mean() / 2) == pytest.approx(5, rel=0.15)  # two axes


def test_dropped_contacts_leave_gaps_but_not_fewer_contacts(sphere):
    touches = simulate_touches(sphere, 300, dropout=0.5, step=STEP)
    assert len(touches.points) == 300
    step = np.linalg.norm(np.diff(touches.points, axis=0), axis=1)[np.diff(touches.strokes) == 0]
    assert (step > 1.5 * STEP).mean() > 0.2
    assert np.bincount(touches.strokes).max() < 32


def test_limited_strokes(sphere):
    touches = simulate_touches(sphere, 200, max_strokes=3, stroke_length=20)
    assert len(touches.points) == 60 and touches.strokes[-1] == 2
    longer = simulate_touches(sphere, 200, max_strokes=2, stop=0.0)  # strokes may be as long as the contacts need
    assert len(longer.points) == 200 and longer.strokes.max() <= 1


def test_varying_step(sphere):
    touches = simulate_touches(sphere, 300, step=(0.02, 0.06))
    step = np.linalg.norm(np.diff(touches.points, axis=0), axis=1)[np.diff(touches.strokes) == 0]
    assert step.min() < 0.025 and step.max() > 0.055 and step.max() < 0.061


def test_start_is_next_to_the_point_given(bottle):
    touches = simulate_touches(bottle, 3, start=[5.0, 0.0, 0.3])
    np.testing.assert_allclose(touches.points[0], [0.25, 0, 0.3], atol=1e-6)


def test_uniform_touches_are_independent_and_spread_by_area():
    box = trimesh.creation.box(extents=(1, 1, 1))
    touches = simulate_touches(box, 1200, strategy="uniform")
    assert touches.strokes.tolist() == list(range(1200))
    sides = np.unique(np.round(touches.normals), axis=0, return_counts=True)[1]
    assert len(sides) == 6 and sides.min() > 150 and sides.max() < 250


def test_scan_lines_follow_parallel_planes(bottle):
    touches = simulate_touches(bottle, 300, strategy="scan_lines")
    assert len(touches.points) == 300
    for stroke in range(touches.strokes[-1] + 1):
        assert np.ptp(touches.points[touches.strokes == stroke, 2]) < 1e-9
    height = [touches.points[touches.strokes == s, 2].mean() for s in range(touches.strokes[-1] + 1)]
    np.testing.assert_allclose(np.diff(height), np.diff(height)[0], rtol=1e-6)


def test_random_walk_turns_gently(sphere):
    touches = simulate_touches(sphere, 200, strategy="random_walk", seed=2, step=STEP)
    assert np.bincount(touches.strokes)[:-1].tolist() == [32] * touches.strokes[-1]
    heading = np.diff(touches.points[:32], axis=0)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    assert (heading[1:] * heading[:-1]).sum(1).min() > 0.3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"n": 0}, "n should be at least 1, got 0"),
        ({"step": 0.0}, r"step should be in \(0, 1\].* got 0"),
        ({"step": (0.05, 0.02)}, "step should be"),
        ({"strategy": "spiral"}, "strategy should be one of gp, random_walk, scan_lines, uniform, got spiral"),
        ({"dropout": 1.0}, r"dropout should be in \[0, 1\), got 1"),
        ({"finger_radius": -1}, r"finger_radius should be in \[0, 1\], got -1"),
        ({"normal_noise": 90}, "normal_noise should be in .* degrees, got 90"),
        ({"max_strokes": 0}, "max_strokes should be None or at least 1, got 0"),
        ({"start": [0, 0]}, r"start should be a finite point of shape \(3,\)"),
        ({"unreachable": [0, 1]}, r"unreachable should be a function or a box"),
        ({"unreachable": [[-9, -9, -9], [9, 9, 9]]}, "no contact is reachable: .* and the unreachable region"),
        ({"kernel": "cubic"}, "kernel should be one of"),
    ],
)
def test_errors_name_the_argument(sphere, options, words):
    with pytest.raises(ValueError, match=words):
        simulate_touches(sphere, **{"n": 10, **options})


def test_a_surface_serves_many_trajectories(bottle, monkeypatch):
    expected = [simulate_touches(bottle, 40, seed=seed) for seed in (0, 1)]
    surface = Surface(bottle)
    trees = []
    monkeypatch.setattr(surface_module, "ClosestPoints", lambda *mesh: trees.append(mesh) or ClosestPoints(*mesh))
    for seed in (0, 1):
        for ours, theirs in zip(simulate_touches(surface, 40, seed=seed), expected[seed], strict=True):
            np.testing.assert_array_equal(ours, theirs)
    assert len(trees) == 1
    assert coverage(bottle, expected[0].points, radius=0.1) > 0.2 and len(trees) == 1


def test_meshes_that_cannot_be_touched():
    with pytest.raises(TypeError, match=r"mesh should be a trimesh\.Trimesh, got list"):
        simulate_touches([], 10)
    with pytest.raises(ValueError, match="mesh should have faces with finite corners"):
        simulate_touches(trimesh.Trimesh(), 10)
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False)
    with pytest.raises(ValueError, match="mesh should have a face with an area"):
        simulate_touches(flat, 10)
    point = trimesh.Trimesh([[1, 1, 1]] * 3, [[0, 1, 2]], process=False)
    with pytest.raises(ValueError, match="mesh should have an extent"):
        simulate_touches(point, 10)
