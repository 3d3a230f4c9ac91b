"""The pictures show what they should: shape, side, order in depth, light from above."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.ndimage import label

from touchnet.data import Touches
from touchnet.figures import View, draw_mesh, draw_touches, save_exploration, save_gallery


def ball(radius: float, centre: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    mesh.apply_translation(centre)
    return mesh


def drawn(picture: np.ndarray) -> np.ndarray:
    return (picture < 250).any(axis=2)


FRONT = {"azimuth": 0.0, "elevation": 0.0, "margin": 1.0}  # seen along -z: x to the right, y up
SQUARE = np.array([[-1, -1, 0], [1, 1, 0]])


def test_a_sphere_covers_a_disc_lit_from_above() -> None:
    picture = draw_mesh(ball(0.5), size=60, view=View.of(SQUARE / 2, **FRONT))
    assert picture.shape == (60, 60, 3) and picture.dtype == np.uint8
    assert drawn(picture).mean() == pytest.approx(np.pi / 4, abs=0.02)
    brightness = picture.mean(axis=2)
    assert brightness[15, 22] > brightness[45, 38] + 20
    assert (picture[0, 0] == 255).all()


def test_y_is_up_and_x_is_right() -> None:
    view = View.of(SQUARE, **FRONT)
    top = drawn(draw_mesh(ball(0.2, (0, 0.7, 0)), size=40, view=view))
    assert top[:14].any() and not top[14:].any()
    right = drawn(draw_touches([[0.7, 0, 0]], size=40, view=view))
    assert right[:, 26:].any() and not right[:, :26].any()
    # From azimuth 90 degrees the viewer stands on +x, and -z is on the right.
    side = View.of(SQUARE, azimuth=90, elevation=0, margin=1.0)
    assert side.turn[2] == pytest.approx([1, 0, 0], abs=1e-12)
    assert side.turn[0] == pytest.approx([0, 0, -1], abs=1e-12)
    # The camera is raised: it sees the top.
    assert View.of(SQUARE, elevation=30).turn[2, 1] == pytest.approx(0.5)


def test_the_nearer_surface_hides_the_farther_whatever_the_order() -> None:
    near, far = ball(0.3, (0, 0, 0.5)), ball(0.5, (0, 0, -0.5))
    pictures = []
    for first, second, values in ((near, far, (1, 0)), (far, near, (0, 1))):
        both = trimesh.util.concatenate([first, second])
        shades = np.repeat(values, [len(first.vertices), len(second.vertices)])
        pictures.append(draw_mesh(both, size=48, view=View.of(SQUARE, **FRONT), values=shades, limits=(0, 1)))
    np.testing.assert_array_equal(pictures[0], pictures[1])
    middle, edge = pictures[0][24, 24].astype(int), pictures[0][24, 34].astype(int)
    assert middle[0] > middle[2] + 50  # yellow in front
    assert edge[2] > edge[1]  # violet behind


def test_a_hole_shows_the_inside_in_another_colour() -> None:
    cube = trimesh.creation.box((1, 1, 1))
    view = View.of(SQUARE / 2, **FRONT)
    closed = draw_mesh(cube, size=30, view=view)[15, 15].astype(int)
    front = cube.face_normals[:, 2] > 0.5
    opened = trimesh.Trimesh(cube.vertices, cube.faces[~front], process=False)
    through = draw_mesh(opened, size=30, view=view)[15, 15].astype(int)
    assert closed[2] > closed[0] and through[0] > through[2]


def test_every_touch_is_one_ball_and_nan_rows_are_left_out() -> None:
    touches = np.array([[-0.6, 0, 0], [0, 0.6, 0], [np.nan, 0, 0], [0.6, -0.4, 0]])
    picture = draw_touches(touches, size=64, view=View.of(SQUARE, **FRONT), radius=3)
    blobs = drawn(picture)
    assert label(blobs, np.ones((3, 3)))[1] == 3
    assert blobs.sum() == pytest.approx(3 * np.pi * 9, rel=0.25)


def test_touches_behind_the_mesh_are_hidden() -> None:
    view = View.of(SQUARE, **FRONT)
    alone = draw_touches(np.zeros((0, 3)), mesh=ball(0.5), size=40, view=view, radius=3)
    behind = draw_touches([[0, 0, -0.9]], mesh=ball(0.5), size=40, view=view, radius=3)
    before = draw_touches([[0, 0, 0.9]], mesh=ball(0.5), size=40, view=view, radius=3)
    assert (np.abs(behind[15:25, 15:25].astype(int) - alone[15:25, 15:25]) < 40).all()
    assert int(before[20, 20, 0]) > int(before[20, 20, 2]) + 60


def test_values_colour_the_touches() -> None:
    picture = draw_touches(
        [[-0.6, 0, 0], [0.6, 0, 0]], size=64, view=View.of(SQUARE, **FRONT), radius=5, values=[0, 1]
    ).astype(int)
    first, last = picture[32, 12], picture[32, 51]
    assert first[2] > first[1] and last[1] > last[2]  # blue to yellow
    with pytest.raises(ValueError, match=r"values must have shape \(2,\), one for each point, got \(3,\)"):
        draw_touches([[0, 0, 0], [1, 0, 0]], values=[0, 1, 2])
    with pytest.raises(ValueError, match=r"points must have shape \(N, 3\), got \(3,\)"):
        draw_touches([0, 0, 0])


@pytest.mark.parametrize("touches", [np.zeros((0, 3)), np.zeros((1, 3)), np.full((2, 3), np.nan), np.ones((5, 3))])
def test_no_touch_or_a_single_place_gives_a_picture(touches: np.ndarray) -> None:
    picture = draw_touches(touches, size=32)
    assert drawn(picture).any() == bool(np.isfinite(touches).any())


def test_a_gallery_has_a_tile_for_everything(tmp_path: Path) -> None:
    file = tmp_path / "gallery.png"
    red = np.zeros((10, 10, 3), dtype=np.uint8) + np.array([255, 0, 0], dtype=np.uint8)
    touches = np.array(ball(0.4).vertices)
    save_gallery(file, [("first", touches, ball(0.4), ball(0.5)), (touches, None, red)], size=64)
    picture = np.asarray(Image.open(file).convert("RGB"))
    assert picture.shape[1] == 2 + 3 * 66
    tile = picture[-66:-2, -66:-2]
    assert (tile == [255, 0, 0]).all()
    # The row's view is the truth's: the smaller ball looks smaller.
    first = picture[40:110]
    assert 0.5 < drawn(first[:, 68:132]).sum() / drawn(first[:, 134:198]).sum() < 0.75
    assert sorted(p.name for p in tmp_path.iterdir()) == ["gallery.png"]
    save_gallery(file, [(ball(0.4),)], size=32)  # replaces it; one column needs no titles
    assert np.asarray(Image.open(file)).shape[1] == 2 + 34


def test_a_gallery_that_fails_leaves_nothing(tmp_path: Path) -> None:
    file = tmp_path / "gallery.png"
    with pytest.raises(ValueError, match="at least one tile"):
        save_gallery(file, [])
    with pytest.raises(ValueError, match="titles must name the 1 columns, got 2"):
        save_gallery(file, [(ball(0.4),)], titles=("a", "b"), size=16)
    with pytest.raises(ValueError, match=r"a tile must be .* got float64 of shape \(4, 2\)"):
        save_gallery(file, [(np.zeros((4, 2)),)], size=16)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(FileNotFoundError, match="does not exist"):
        save_gallery(tmp_path / "missing" / "gallery.png", [(ball(0.4),)], size=16)


def test_an_exploration_leaves_its_trace_and_makes_the_surface_known(tmp_path: Path) -> None:
    mesh = ball(0.5)
    points = np.array(mesh.vertices)[::10][:64]  # all around
    touches = Touches(points, points / 0.5, np.arange(64) // 16, np.ones(64))
    file = tmp_path / "exploration.png"
    save_exploration(file, mesh, touches, counts=(1, 64), size=64)
    picture = np.asarray(Image.open(file)).astype(int)
    assert picture.shape[1] == 2 + 2 * 66
    unknown, known = picture[-66:-2, 2:66], picture[-66:-2, 68:132]
    # viridis: yellow (red > blue) where nothing is known, violet (blue > red) where all is.
    yellow = [(tile[..., 0] > tile[..., 2] + 20).mean() for tile in (unknown, known)]
    assert yellow[0] > 1.15 * yellow[1]
    with pytest.raises(ValueError, match=r"counts must ascend from at least 1 to at most 64, got \[8, 8\]"):
        save_exploration(file, mesh, touches, counts=(8, 8))
    with pytest.raises(ValueError, match="at least one contact"):
        save_exploration(file, mesh, Touches(points[:0], points[:0], np.zeros(0, dtype=int), np.zeros(0)))
