import numpy as np
import pytest
import trimesh

from touchnet.data.files import read_points
from touchnet.frames import Frame, find_outliers


def sphere(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def test_longest_side_becomes_1_8():
    frame = Frame.fit(np.array([[0.0, 0, 0], [4, 2, 1]]))
    assert np.allclose(frame.centre, [2, 1, 0.5])
    assert np.allclose(frame.to_cube([[0, 0, 0], [4, 2, 1]]), [[-0.9, -0.45, -0.225], [0.9, 0.45, 0.225]])


def test_round_trip_in_millimetres_far_away():
    points = sphere(200) * 48 + [61, -22.5, 4e6]
    frame = Frame.fit(points)
    assert np.abs(frame.to_cube(points)).max() <= 0.9 + 1e-9
    assert np.abs(frame.from_cube(frame.to_cube(points)) - points).max() < 1e-8
    assert frame.from_cube(np.zeros((0, 3))).shape == (0, 3)


def test_float32_points_are_mapped_in_float64():
    points = (sphere(50) + 1000).astype(np.float32)
    assert Frame.fit(points).to_cube(points).dtype == np.float64


@pytest.mark.parametrize("count", [1, 3])
def test_no_extent_counts_as_one(count):
    frame = Frame.fit(np.tile([0.1, -0.2, 0.3], (count, 1)))
    assert frame.scale == pytest.approx(1 / 1.8)
    assert np.allclose(frame.to_cube([[0.1, -0.2, 0.3]]), 0)


@pytest.mark.parametrize("size", [1e-290, 1e290])
def test_extreme_sizes_stay_finite(size):
    frame = Frame.fit(sphere(20) * size)
    assert np.isfinite(frame.to_cube(sphere(20) * size)).all()


def test_rows_that_are_not_finite_are_passed_over():
    points = sphere(20)
    assert Frame.fit(np.vstack([points, [[np.nan, 0, 0]], [[np.inf, 0, 0]]])).scale == Frame.fit(points).scale


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((3, 2)), r"shape \(N, 3\), got \(3, 2\)"),
        (np.zeros(3), r"shape \(N, 3\), got \(3,\)"),
        (np.zeros((0, 3)), "at least one finite row"),
        (np.full((2, 3), np.nan), "at least one finite row"),
    ],
)
def test_errors(points, message):
    with pytest.raises(ValueError, match=message):
        Frame.fit(points)


def test_enlarged():
    frame = Frame.fit(sphere(20)).enlarged(1.25)
    assert np.ptp(frame.to_cube(sphere(20)), axis=0).max() == pytest.approx(1.8 / 1.25)


def test_order_does_not_matter():
    points = np.vstack([sphere(300), [[9.0, 0, 0]]])
    shuffled = points[np.random.default_rng(1).permutation(len(points))]
    a, b = Frame.fit(points), Frame.fit(shuffled)
    assert a.scale == b.scale
    assert (a.centre == b.centre).all()


@pytest.mark.parametrize("stray", [[[2.5, 0, 0]], [[40, 1, 2]], [[3, 3, 3], [-4, 0, 0], [0, -1e6, 0]]])
def test_stray_contacts_are_outliers(stray):
    points = np.vstack([sphere(300), np.array(stray, dtype=float)])
    assert np.flatnonzero(find_outliers(points)).tolist() == list(range(300, 300 + len(stray)))
    assert Frame.fit(points).scale == Frame.fit(sphere(300)).scale
    assert Frame.fit(points, reject_outliers=False).scale > Frame.fit(sphere(300)).scale


def test_a_group_of_stray_contacts_is_an_outlier_while_small():
    body = sphere(400)
    blob = sphere(15) * 0.05 + [5, 0, 0]
    assert find_outliers(np.vstack([body, blob])).sum() == 15
    blob = sphere(60) * 0.05 + [5, 0, 0]
    assert find_outliers(np.vstack([body, blob])).sum() == 0, "60 of 460 contacts are a part"


def test_an_antenna_stays():
    body = sphere(2000) * [2, 0.6, 1]
    tip_only = [[1.0, 1.9, 0.0]]
    assert not find_outliers(np.vstack([body, tip_only])).any()
    few = np.array([[1.0, height, 0.0] for height in (1.6, 2.9, 4.1)])
    assert not find_outliers(np.vstack([body, few])).any()


def test_a_trail_that_leaves_the_surface_stays():
    trail = np.stack([np.linspace(1, 8, 40), np.zeros(40), np.zeros(40)], axis=1)
    assert not find_outliers(np.vstack([sphere(2000), trail])).any()


@pytest.mark.parametrize("count", [100, 256, 2048])
@pytest.mark.parametrize("seed", range(3))
def test_a_glider_keeps_its_wing_tips(count, seed):
    parts = [trimesh.creation.box(size) for size in ([8, 1, 1], [0.3, 0.03, 14])]
    plane = trimesh.util.concatenate(parts)
    points = trimesh.sample.sample_surface(plane, count, seed=seed)[0]
    assert not find_outliers(points).any()


def test_few_contacts_are_all_kept():
    assert not find_outliers(np.vstack([sphere(98), [[50.0, 0, 0]]])).any()


def test_many_equal_contacts_are_no_reason_to_drop_the_rest():
    assert not find_outliers(np.vstack([np.zeros((500, 3)), sphere(20)])).any()


def test_head_recording(shared_data):
    points = read_points(shared_data / "data/touches/head-digitization/headA.csv").points
    frame = Frame.fit(points)
    # The recording starts with a stroke that leaves the scalp (below the face). It is continuous, so it stays; the
    # frame hardly notices.
    without = Frame.fit(points[60:])
    assert frame.scale == pytest.approx(without.scale, rel=0.02)
    assert np.abs(frame.centre - without.centre).max() < 0.1 * frame.scale
    assert np.abs(frame.to_cube(points)).max() <= 0.9 + 1e-12
    # A tracker that loses sight is noticed.
    glitches = np.array([[0.9, 0.1, 0.0], [-3.0, 2.0, 1.0], [0.0, 0.0, 250.0]])
    assert find_outliers(np.vstack([glitches, points])).nonzero()[0].tolist() == [0, 1, 2]
