"""Questions to a mesh with answers by hand."""

import numpy as np
import pytest
import trimesh

from tests.solids import box
from touchnet.metrics import is_closed, point_to_mesh, sample_surface


def test_closed_means_two_faces_an_edge_in_opposite_directions() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    assert is_closed(cube.faces)
    assert not is_closed(cube.faces[1:])
    flipped = np.array(cube.faces)
    flipped[0] = flipped[0, ::-1]
    assert not is_closed(flipped)
    assert not is_closed(np.concatenate([cube.faces, cube.faces]))  # four faces an edge
    assert not is_closed([[0, 0, 1], [0, 1, 0]])
    assert is_closed(np.zeros((0, 3), dtype=int))


def test_distance_to_a_face_an_edge_and_a_corner() -> None:
    cube = box((0, 0, 0), (1, 1, 1))
    distance, face = point_to_mesh([(0.5, 0.5, 1.25), (2, 0.5, 2), (-1, -1, -1), (0.5, 0.5, 0.5)], cube)
    np.testing.assert_allclose(distance, [0.25, 2**0.5, 3**0.5, 0.5], atol=1e-12)
    assert np.abs(cube.face_normals[face[0]] @ [0, 0, 1]) == pytest.approx(1)
    assert point_to_mesh(np.zeros((0, 3)), cube)[0].shape == (0,)
    with pytest.raises(ValueError, match="mesh must have at least one face"):
        point_to_mesh([(0, 0, 0)], trimesh.Trimesh())
    with pytest.raises(ValueError, match=r"points must have shape \(N, 3\), got \(3,\)"):
        point_to_mesh((0, 0, 0), cube)


def test_surface_samples_are_even_by_area_and_on_their_face() -> None:
    plate = box((0, 0, 0), (1, 2, 0.5))  # areas 2+2, 1+1, 0.5+0.5 of 7
    samples, face = sample_surface(plate, 7000, generator=np.random.default_rng(0))
    share = np.bincount(face, minlength=len(plate.faces)) / 7000
    np.testing.assert_allclose(share, plate.area_faces / plate.area, atol=2e-3)
    assert point_to_mesh(samples, plate)[0].max() < 1e-12
    top = samples[np.abs(samples[:, 2] - 0.5) < 1e-12]
    np.testing.assert_allclose(top.mean(axis=0), [0.5, 1, 0.5], atol=0.02)
    again, _ = sample_surface(plate, 7000, generator=np.random.default_rng(0))
    np.testing.assert_array_equal(samples, again)
    with pytest.raises(ValueError, match="area above 0"):
        sample_surface(
            trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False), 5, generator=np.random.default_rng()
        )
