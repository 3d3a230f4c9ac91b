"""The session, with the ball of test_reconstruction in place of a network."""

import numpy as np
import pytest
import torch

import touchnet
from tests.test_reconstruction import Ball, sphere
from touchnet import places
from touchnet.explorer import Explorer
from touchnet.meshes import distances_to


class UnitBall(Ball):
    """The unit ball whatever was touched, in a cube that the contacts' box fills."""

    def encode(self, touches, normals=None):
        self.encoded.append((touches, normals))
        return torch.zeros(3, dtype=torch.float64), torch.tensor(0.9, dtype=torch.float64)


def explorer(points, **options):
    return Explorer(points, **{"weights": UnitBall(), "resolution": 32, **options})


def most(count=120):
    """The unit sphere touched all over but for a cap around +x, and at the six ends of the axes."""
    points = sphere(count)
    return np.vstack([points[points[:, 0] < 0.4], np.eye(3), -np.eye(3)])


def test_it_is_public():
    assert touchnet.Explorer is Explorer


def test_the_untouched_side_comes_first_from_outside_and_spread():
    suggested = explorer(most()).next(4)
    assert (np.linalg.norm(suggested.positions[:, 1:], axis=1) < 0.98).all()
    assert (suggested.positions[:2, 0] > 0.3).all()
    assert np.linalg.norm(suggested.positions, axis=1) == pytest.approx(1, abs=0.05)
    inwards = -suggested.positions / np.linalg.norm(suggested.positions, axis=1, keepdims=True)
    assert (suggested.directions * inwards).sum(axis=1).min() > 0.95
    apart = np.linalg.norm(suggested.positions[:, None] - suggested.positions, axis=2)
    assert apart[~np.eye(4, dtype=bool)].min() > 0.2
    assert (np.diff(suggested.gains) <= 1e-9).all()
    assert 0 < suggested.gains.sum() <= 1
    assert (suggested.expected_errors > 0).all()


def test_what_was_suggested_and_touched_is_not_suggested_again():
    session = explorer(most())
    first = session.next(3)
    session.add(first.positions)
    second = session.next(3, refit=False)
    apart = np.linalg.norm(first.positions[:, None] - second.positions, axis=2)
    assert apart.min() > 0.1
    # One by one or as a batch, the same places: conditioning on a suggestion is what touching it does.
    assert len(session.model.encoded) == 1
    again = explorer(most())
    again.add(again.next(1).positions)
    assert again.next(1, refit=False).positions == pytest.approx(first.positions[1:2])


def test_what_was_missed_is_not_suggested_again():
    session = explorer(most())
    first = session.next(3)
    session.add_misses(first.positions)
    second = session.next(3)
    assert np.linalg.norm(first.positions[:, None] - second.positions, axis=2).min() > 0.1
    assert len(session) == len(most())
    assert len(session.model.encoded) == 1


def test_the_covariance_is_that_of_the_gaussian_process_however_the_contacts_came():
    points = most()
    session = explorer(points)
    session.next()
    for part in np.array_split(sphere(40, seed=3), 3):
        session.add(part)
        session.next(2, refit=False)
    field, process = session._places, session._gp
    assert field.covariance.diagonal() == pytest.approx(process.gp.variance(field.unit), abs=1e-9)
    # Off the diagonal: V(x given contacts and y) = V(x) - C(x, y)² / (V(y) + noise²).
    other = session._gp.gp.variance(field.unit)
    drop = field.covariance[:, 5] ** 2 / (other[5] + places.NOISE**2)
    process.gp.add(field.unit[5])
    assert process.gp.variance(field.unit) == pytest.approx(other - drop, abs=1e-9)


def test_the_mesh_is_fitted_when_asked_for_and_kept():
    session = explorer(most())
    mesh = session.mesh()
    assert session.mesh() is mesh
    session.next(2)
    assert len(session.model.encoded) == 1
    session.add(sphere(1, seed=5))
    session.next(2)  # one more on the surface: it is not worth a fit
    assert len(session.model.encoded) == 1
    assert session.mesh() is not mesh
    expected = touchnet.reconstruct_mesh(session.points, weights=UnitBall(), resolution=32)
    assert (session.mesh().vertices == expected.vertices).all()
    assert session.mesh(16).metadata["cell"] == pytest.approx(2 * expected.metadata["cell"])


def test_contacts_that_contradict_the_surface_or_are_many_call_for_a_fit():
    session = explorer(most())
    session.next()
    session.add([[0.6, 0.0, 0.0]])
    session.next()
    assert len(session.model.encoded) == 2
    session.add(sphere(60, seed=6))
    session.next(refit=False)
    assert len(session.model.encoded) == 2
    session.next()
    assert len(session.model.encoded) == 3


def test_normals_are_kept_with_their_contacts():
    session = explorer(most(), normals=None)
    assert session.normals is None
    session.add([1.0, 0, 0], [3.0, 0, 0])
    assert session.points.shape == session.normals.shape == (len(most()) + 1, 3)
    assert session.normals[-1].tolist() == [1, 0, 0]
    assert not session.normals[:-1].any()


@pytest.mark.parametrize(("scale", "offset"), [(1000.0, 0.0), (0.001, 50.0)])
def test_any_unit_and_offset(scale, offset):
    here = explorer(most()).next(3)
    there = explorer(most() * scale + offset).next(3)
    # Rounding decides between places that are all but as good: the same gains, not always the same places.
    assert there.gains == pytest.approx(here.gains, rel=0.05)
    positions = (there.positions - offset) / scale
    assert np.linalg.norm(positions, axis=1) == pytest.approx(1, abs=0.05)
    assert (positions[:2, 0] > 0.3).all()
    assert there.expected_errors.mean() == pytest.approx(here.expected_errors.mean() * scale, rel=0.3)
    assert there.clearances == pytest.approx(here.clearances * scale, rel=0.05)


@pytest.mark.filterwarnings("ignore:half of the contacts")
def test_contacts_that_outgrow_the_first_ones():
    session = explorer(0.2 * most())
    session.next()
    session.add(most())
    suggested = session.next(2, refit=True)
    assert session._gp.side == pytest.approx(2)
    assert (np.linalg.norm(suggested.positions, axis=1) > 0.9).all()


# where the robot can go.


def test_so_many_contacts_are_thinned_evenly(monkeypatch):
    monkeypatch.setattr(places, "MOST_KNOWN", 200)
    session = explorer(most(500))
    session.next(1)
    assert 80 < len(session._gp.gp) <= 100
    assert session.next(2).positions[0, 0] > 0.3
    session.add(most(90)[::3])  # these are added one by one
    session.next(1, refit=False)
    assert 110 < len(session._gp.gp) <= 130
    session.add(most(150))  # with these it would be full
    suggested = session.next(2, refit=False)
    assert len(session._gp.gp) <= 100
    assert suggested.positions[0, 0] > 0.3
    session.add(suggested.positions)
    session.next(1, refit=False)
    assert len(session._gp.gp) <= 102


def test_only_above_the_table():
    session = explorer(most(), up="z", floor=-0.3)
    suggested = session.next(30)
    assert suggested.positions[:, 2].min() > -0.3
    # The approach, too, stays above: 0.1 of free path outwards.
    assert (suggested.positions[:, 2] - 0.1 * suggested.directions[:, 2]).min() > -0.3


def test_only_from_where_the_tool_hangs():
    suggested = explorer(most(), approach=(0, 5, 0), cone=60).next(20)
    assert (-suggested.directions[:, 1]).min() >= 0.5 - 1e-9
    assert (explorer(most(), approach=(0, 5, 0), cone=180).next(20).directions[:, 1] > 0).any()


def test_only_where_the_caller_says():
    asked = []

    def reachable(positions, directions):
        asked.append((positions, directions))
        return positions[:, 1] > 0.5

    suggested = explorer(most(), reachable=reachable).next(10)
    assert suggested.positions[:, 1].min() > 0.5
    positions, directions = asked[0]
    assert np.linalg.norm(positions, axis=1) == pytest.approx(1, abs=0.05)
    assert (positions * directions).sum(axis=1).max() < 0


class Bowl(Ball):
    """A ball with a narrow well in it, open at the top."""

    def decode(self, features, queries):
        q = queries.double()
        solid = 0.9 - q.norm(dim=2)
        well = torch.maximum(q[..., [0, 2]].norm(dim=2) - 0.2, -0.5 - q[..., 1])
        return torch.sigmoid(40 * torch.minimum(solid, well))


def test_a_straight_path_of_the_standoff_is_free():
    inside_well = lambda points: np.linalg.norm(points[:, [0, 2]], axis=1) < 0.3  # noqa: E731
    free = explorer(most(), weights=Bowl(), standoff=0.0).next(100).positions
    blocked = explorer(most(), weights=Bowl(), standoff=0.8).next(100).positions
    walls = lambda points: inside_well(points) & (np.abs(points[:, 1]) < 0.3)  # noqa: E731
    assert walls(free).sum() > 3
    assert walls(blocked).sum() == 0


def test_the_clearance_is_the_free_path_before_a_contact():
    suggested = explorer(most(), weights=Bowl(), standoff=0.0).next(100)
    assert suggested.clearances.max() == pytest.approx(2)  # the longest side
    walls = (np.linalg.norm(suggested.positions[:, [0, 2]], axis=1) < 0.3) & (np.abs(suggested.positions[:, 1]) < 0.3)
    assert 0 < suggested.clearances[walls].min()
    assert suggested.clearances[walls].max() < 0.5
    outside = np.linalg.norm(suggested.positions, axis=1) > 0.97
    assert suggested.clearances[outside & (suggested.positions[:, 1] < 0)].min() == pytest.approx(2)


def test_nothing_reachable():
    with pytest.raises(ValueError, match="no place on the surface is reachable"):
        explorer(most(), reachable=lambda p, d: np.zeros(len(p), dtype=bool)).next()


# bad input.


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"up": "Z"}, 'up should be "x", "y", "z" or None'),
        ({"floor": 0.0}, "floor needs up"),
        ({"floor": np.nan, "up": "z"}, "floor should be a finite height"),
        ({"cone": 0}, r"cone should be a half angle in \(0, 180\] degrees, got 0"),
        ({"standoff": -1.0}, "standoff should be a length"),
        ({"approach": (0, 0, 0)}, "approach should be a direction"),
        ({"approach": (0, 1)}, "approach should be a direction"),
        ({"device": "tpu"}, "device should be"),
        ({"resolution": 0}, "resolution should be at least 1"),
        ({"normals": np.zeros((2, 3))}, "normals should have the shape of points"),
    ],
)
def test_options_that_do_not_fit(options, message):
    with pytest.raises(ValueError, match=message):
        explorer(most(), **options).mesh()


def test_bad_contacts_are_refused_whole():
    session = explorer(most())
    for points, message in [
        (np.zeros((3, 2)), r"shape \(N, 3\)"),
        ([[0, 0, np.nan]], "points should be finite"),
    ]:
        with pytest.raises(ValueError, match=message):
            session.add(points)
        with pytest.raises(ValueError, match=message):
            session.add_misses(points)
    assert len(session) == len(most())
    with pytest.raises(ValueError, match="normals without points"):
        Explorer(normals=np.eye(3), weights=UnitBall())
    with pytest.raises(ValueError, match="k should be at least 1, got 0"):
        session.next(0)
    with pytest.raises(ValueError, match=r"reachable should return 1024 bools, got float64"):
        explorer(most(), reachable=lambda p, d: p[:, 0]).next()


@pytest.mark.filterwarnings("ignore:half of the contacts")
def test_too_few_contacts():
    session = Explorer(weights=UnitBall())
    for count in range(4):
        with pytest.raises(ValueError, match=f"at least 4 distinct contacts, got {count}"):
            session.next()
        session.add(sphere(4)[count])
    assert len(session.next(2).positions) == 2


def test_gains_are_what_conditioning_on_the_touch_takes_away():
    session = explorer(most())
    suggested = session.next(3)
    places, process = session._places, session._gp
    before = float(places.weights @ process.gp.variance(places.unit))
    whole = before
    for position, gain in zip(suggested.positions, suggested.gains, strict=True):
        process.gp.add(process.to_unit(position[None]))
        after = float(places.weights @ process.gp.variance(places.unit))
        assert gain == pytest.approx((before - after) / whole, rel=1e-6)
        before = after


def test_estimated_normals_begin_with_those_of_the_last_surface(monkeypatch):
    model = touchnet.load_model("default")
    passes, encode = [], model._encode
    monkeypatch.setattr(model, "_encode", lambda *touches: passes.append(1) or encode(*touches))
    contacts = sphere(400) * [1.0, 0.7, 0.5]
    session = Explorer(contacts[:384], weights=model, resolution=48)
    session.mesh()
    assert len(passes) > 2
    passes.clear()
    session.add(contacts[384:])
    mesh = session.mesh()
    assert len(passes) == 1
    expected = touchnet.reconstruct_mesh(contacts, weights=model, resolution=48)
    assert distances_to(expected, mesh.vertices).mean() < 0.05 * mesh.metadata["cell"]

    # With a quarter more contacts the estimates of the few are forgotten.
    session.add(sphere(100, seed=1) * [1.0, 0.7, 0.5])
    passes.clear()
    session.mesh()
    assert len(passes) > 2


def test_known_normals_are_not_guessed_again(monkeypatch):
    model = touchnet.load_model("default")
    seen, encode = [], model._encode
    monkeypatch.setattr(model, "_encode", lambda touches, normals: seen.append(normals) or encode(touches, normals))
    contacts = np.vstack([np.eye(3), -np.eye(3), sphere(154)])
    session = Explorer(contacts[:150], contacts[:150], up="z", weights=model, resolution=32)
    session.mesh()
    session.add(contacts[150:160])
    session.mesh()
    known, estimated = seen[-1][0, :150].numpy(), seen[-1][0, 150:].numpy()
    turned = contacts[:, [0, 2, 1]] * [1, 1, -1]  # z up to y up
    assert known == pytest.approx(turned[:150], abs=1e-6)
    assert (np.linalg.norm(estimated, axis=1) <= 0.5 + 1e-6).all()
    assert ((estimated * turned[150:160]).sum(axis=1) > 0.4).all()
