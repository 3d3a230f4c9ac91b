import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import Delaunay
from torch.utils.data import DataLoader

from touchnet.config import PAPER_SAMPLES, SampleConfig
from touchnet.data.samples import TrainingSamples, contact_rows, validation_sample

STILL = dataclasses.replace(
    SampleConfig(), uniform_contacts=0, one_side=0, no_normals=0, noise=0, stretch=0, rotate_up=0, rotate_free=0
)


class Wedge:
    """A convex shape without any symmetry, in the form of a ShapeFile; labels by its planes."""

    def __init__(self, *, trajectories=2, contacts=2048, seed=0):
        rng = np.random.default_rng(seed)
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 0.7, 0], [0, 0, 0.4], [0.9, 0.1, 0.3], [0.1, 0.6, 0.2]])
        corners = corners - (corners.min(0) + corners.max(0)) / 2
        hull = trimesh.convex.convex_hull(corners)
        self.planes, self.origins = hull.face_normals, hull.triangles_center

        def surface(n):
            points, faces = trimesh.sample.sample_surface(hull, n, seed=int(rng.integers(1 << 31)))
            return np.asarray(points, np.float32), hull.face_normals[faces].astype(np.float16)

        self.stored = {"vertices": np.asarray(hull.vertices, np.float32)}
        touches = [surface(contacts) for _ in range(trajectories)]
        self.stored["touches"] = np.array([t for t, _ in touches], np.float32).reshape(trajectories, contacts, 3)
        self.stored["touch_normals"] = np.array([n for _, n in touches], np.float16).reshape(trajectories, contacts, 3)
        self.stored["surface"], self.stored["surface_normals"] = surface(4000)
        near, _ = surface(20000)
        near = near + rng.normal(size=near.shape) * np.repeat([0.01, 0.05], 10000)[:, None]
        self.stored["near"] = near.astype(np.float16)
        self.stored["box"] = ((rng.random((9000, 3)) - 0.5) * np.ptp(hull.vertices, axis=0)).astype(np.float16)

    def array(self, name):
        return self.stored[name]

    def rows(self, name, start, stop):
        return self.stored[name][start:stop]

    def inside(self, name):
        points = self.stored[name].astype(np.float64)
        return np.all([(points - o) @ n <= 0 for n, o in zip(self.planes, self.origins, strict=True)], axis=0)


class Shapes:
    def __init__(self, *shapes):
        self.shapes, self.records = shapes, [SimpleNamespace(id=f"wedge/{i}") for i in range(len(shapes))]

    def __len__(self):
        return len(self.shapes)

    def shape(self, index):
        return self.shapes[index]


def draw(config, *, epoch=0, item=0, seed=0, shapes=None):
    return TrainingSamples(shapes or Shapes(Wedge()), config, seed=seed)[epoch, item]


def contacts_of(sample):
    return sample.touches[np.isfinite(sample.touches).all(axis=1)].astype(np.float64)


@pytest.mark.parametrize("epoch", range(6))
@pytest.mark.parametrize(
    "change",
    [
        {},
        {"stretch": 1},
        {"rotate_up": 1},
        {"rotate_free": 1},
        {"stretch": 1, "rotate_free": 1},
        {"uniform_contacts": 1},
    ],
)
def test_touches_normals_and_labels_move_together(change, epoch):
    sample = draw(dataclasses.replace(STILL, min_contacts=1500, **change), epoch=epoch)
    contacts, queries = contacts_of(sample), sample.queries.astype(np.float64)
    # The shape is convex: what is inside the hull of the contacts is inside the shape, and hardly anything else is.
    in_hull = Delaunay(contacts).find_simplex(queries) >= 0
    assert np.mean(in_hull == (sample.inside > 0.5)) > 0.97
    assert sample.inside[in_hull].mean() > 0.99
    normals = sample.normals[: len(contacts)].astype(np.float64)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-3)
    # Every contact is the farthest one along its own normal.
    reach = (contacts @ normals.T).max(axis=0) - (contacts * normals).sum(axis=1)
    assert reach.max() < 0.02


@pytest.mark.parametrize("config", [SampleConfig(), PAPER_SAMPLES])
@pytest.mark.parametrize("epoch", range(10))
def test_sizes_are_fixed_and_values_in_range(config, epoch):
    sample = draw(config, epoch=epoch)
    assert sample.touches.shape == sample.normals.shape == (2048, 3)
    assert sample.queries.shape == (config.queries, 3) and sample.inside.shape == (config.queries,)
    assert np.abs(sample.queries).max() <= 1 and np.isin(sample.inside, [0, 1]).all()
    contacts = contacts_of(sample)
    assert np.isfinite(sample.normals).all() and len(contacts) >= 0.7 * config.min_contacts
    assert np.ptp(contacts, axis=0).max() == pytest.approx(1.8, abs=0.2)
    assert 0.05 < sample.inside.mean() < 0.7


def test_samples_repeat_for_a_key_and_differ_between_keys():
    a, b = draw(SampleConfig(), epoch=3), draw(SampleConfig(), epoch=3)
    assert all(np.array_equal(x, y, equal_nan=True) for x, y in zip(a[:4], b[:4], strict=True))
    others = [
        draw(SampleConfig(), epoch=4),
        draw(SampleConfig(), epoch=3, item=1),
        draw(SampleConfig(), epoch=3, seed=1),
    ]
    assert not any(np.array_equal(a.queries, other.queries) for other in others)


@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_workers_see_the_same_samples_as_the_parent(method):
    samples = TrainingSamples(Shapes(Wedge(), Wedge(seed=1)), SampleConfig(queries=64), seed=5)
    keys = [[(epoch, item)] for epoch in range(2) for item in range(4)]
    loader = DataLoader(samples, batch_sampler=keys, num_workers=2, multiprocessing_context=method)
    loaded = [batch.queries[0] for batch in loader]
    direct = [torch.from_numpy(samples[key[0]].queries) for key in keys]
    assert all(torch.equal(x, y) for x, y in zip(loaded, direct, strict=True))
    assert len({x.numpy().tobytes() for x in loaded}) == len(keys)


def test_number_of_contacts_varies_between_its_bounds():
    config = dataclasses.replace(STILL, min_contacts=64, max_contacts=512)
    counts = [len(contacts_of(draw(config, epoch=epoch))) for epoch in range(40)]
    assert 64 <= min(counts) < 100 and 300 < max(counts) <= 512


def test_one_side_is_left_out():
    whole = contacts_of(draw(dataclasses.replace(STILL, min_contacts=2048)))
    cut = contacts_of(draw(dataclasses.replace(STILL, min_contacts=2048, one_side=1)))
    assert len(whole) == 2048 and 0.7 * 2048 < len(cut) < 0.97 * 2048


def test_noise_is_small_as_a_rule_and_bounded():
    config = dataclasses.replace(STILL, min_contacts=1500, noise=1, noise_sigma=0.02, no_normals=1)
    exact = dataclasses.replace(config, noise=0)
    ratios = []
    for epoch in range(60):
        noisy, still = (contacts_of(draw(one, epoch=epoch)) for one in (config, exact))
        # The noise enlarges the box that the frame fits into the cube; undo that before comparing.
        noisy, still = noisy - noisy.mean(axis=0), still - still.mean(axis=0)
        scale = (noisy * still).sum() / (noisy**2).sum()
        ratios.append((scale * noisy - still).std() / np.ptp(still, axis=0).max())
    assert 0.01 < max(ratios) < 0.0205
    assert np.quantile(ratios, 0.2) < 0.0025 and np.median(ratios) < 0.008


def test_shapes_without_trajectories_are_touched_on_their_surface():
    sample = draw(STILL, shapes=Shapes(Wedge(trajectories=0)))
    assert len(contacts_of(sample)) >= 64


def test_queries_are_complete_where_the_touches_see_a_corner_only():
    wedge = Wedge()
    wedge.stored["touches"] = wedge.stored["touches"][:, :64] * 0.02 + np.float32(0.3)
    wedge.stored["touch_normals"] = wedge.stored["touch_normals"][:, :64]
    sample = draw(STILL, shapes=Shapes(wedge))
    assert sample.queries.shape == (8192, 3) and np.abs(sample.queries).max() <= 1


def test_a_touch_that_is_not_finite_is_named():
    wedge = Wedge()
    wedge.stored["touches"][0, 3, 1] = np.nan
    with pytest.raises(ValueError, match="shape wedge/0: its touches hold values that are not finite"):
        draw(dataclasses.replace(STILL, min_contacts=2048), shapes=Shapes(wedge))


def test_weights_balance_categories():
    shapes = Shapes(Wedge(), Wedge(), Wedge(), Wedge(trajectories=4))
    for record, category in zip(shapes.records, "aabb", strict=True):
        record.category = category
    samples = TrainingSamples(shapes, SampleConfig())
    assert samples.weights(0).tolist() == [1] * 10
    assert samples.weights(1) == pytest.approx([1 / 4] * 4 + [1 / 6] * 6)
    assert samples.weights(0.5) == pytest.approx([1 / 2] * 4 + [6**-0.5] * 6)


def test_no_shapes_is_an_error():
    with pytest.raises(ValueError, match="no shape to train on"):
        TrainingSamples(Shapes(), SampleConfig())


def test_which_contacts_are_taken():
    assert contact_rows(8, 4, "spread").tolist() == [0, 2, 4, 6]
    assert contact_rows(8, 3, "spread").tolist() == [0, 2, 5]
    assert contact_rows(8, 3, "first").tolist() == [0, 1, 2]
    for take in ("spread", "first"):
        assert contact_rows(3, 8, take).tolist() == [0, 1, 2]


def test_validation_sample_is_spread_over_the_first_trajectory():
    wedge = Wedge()
    sample = validation_sample(wedge, 128, normals=False, queries=1000)
    assert sample.touches.shape == (128, 3) and not sample.normals.any()
    assert np.ptp(sample.touches, axis=0).max() == pytest.approx(1.8, abs=1e-5)
    some = wedge.stored["touches"][0, ::16]
    back = sample.touches * (np.ptp(some, axis=0).max() / 1.8)
    assert np.allclose(back - back[0], some - some[0], atol=1e-5)
    assert np.array_equal(sample.inside > 0.5, wedge.inside("box")[:1000])
    assert validation_sample(wedge, 128, normals=True).normals.any()
