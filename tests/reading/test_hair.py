"""Hair as prisms: as wide as the strands from all sides, one curve at a time."""

import numpy as np
import pytest

from hulldown.reading.scenery import hair
from hulldown.reading.scenery.hair import MAX_AXIS_RADII, hair_mesh


def strand(*points, radius=0.1, straight=True):
    radii = np.broadcast_to(np.asarray(radius, dtype=float), len(points)).copy()
    return hair_mesh(np.array(points, dtype=float), radii, np.array([0]), np.array([straight]), "grass")


def widths(mesh, along):
    """Width of the projection across `along`, from all sides."""
    across = np.linalg.svd(np.asarray(along, dtype=float)[None])[2][1:]
    turn = np.linspace(0, np.pi, 720, endpoint=False)
    sides = np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
    return np.ptp(mesh.vertices @ sides.T, axis=0)


@pytest.mark.parametrize("along", [(0, 0, 1), (0, 0, -2), (1, 0, 0), (1e-9, 0, 3), (1, -2, 0.5)])
def test_a_strand_has_the_width_of_its_drawing(along):
    seen = widths(strand((5, 5, 5), np.add(5, along)), along)
    assert seen.mean() == pytest.approx(0.2, rel=1e-5)
    assert seen.min() > 0.155
    assert seen.max() < 0.225


def test_a_lawn_has_the_same_density_from_all_sides():
    n = 200
    points = np.stack([[k, 0, z] for k in range(n) for z in (0, 1)]).astype(float)
    lawn = hair_mesh(points, np.full(2 * n, 0.1), 2 * np.arange(n), np.ones(n, dtype=bool), "lawn")
    blades = lawn.vertices.reshape(n, -1, 3)
    for turn in np.linspace(0, np.pi, 12):
        widths = np.ptp(blades @ [np.cos(turn), np.sin(turn), 0], axis=1)
        assert widths.mean() == pytest.approx(0.2, rel=0.01)


def test_a_strand_ends_at_its_last_point():
    mesh = strand((0, 0, 0), (0, 0, 1), (0, 0.5, 2))
    assert mesh.faces.shape == (16, 3)
    assert mesh.bounds[0, 2] == 0.0
    assert mesh.bounds[1, 2] == pytest.approx(2.0, abs=0.1)


def test_a_strand_tapers():
    mesh = strand((0, 0, 0), (0, 0, 1), radius=[0.1, 0.0])
    assert np.ptp(mesh.vertices[mesh.vertices[:, 2] == 1.0], axis=0).tolist() == [0.0, 0.0, 0.0]


def test_separate_curves_stay_separate():
    points = np.array([[0, 0, 0], [0, 0, 1], [9, 0, 0], [9, 0, 1], [9, 0, 2], [20, 0, 0]], dtype=float)
    mesh = hair_mesh(points, np.full(6, 0.1), np.array([0, 2, 5]), np.array([True, False, True]), "grass")
    assert len(mesh.faces) == 3 * 8
    assert not ((mesh.vertices[:, 0] > 1) & (mesh.vertices[:, 0] < 8)).any()
    assert mesh.bounds[1, 0] < 10


def test_segments_without_length_or_thickness_are_left_out():
    assert len(strand((0, 0, 0), (0, 0, 0), (0, 0, 1)).faces) == 8
    assert strand((1, 1, 1), (1, 1, 1)) is None
    assert strand((0, 0, 0), (0, 0, 1), radius=0.0) is None
    assert strand((0, 0, 0)) is None
    none = np.empty(0)
    assert hair_mesh(np.empty((0, 3)), none, none.astype(int), none.astype(bool), "grass") is None


def test_nan_coordinates_are_refused():
    with pytest.raises(ValueError, match="vertex"):
        strand((0, 0, 0), (0, np.nan, 1))


def test_a_sample_of_much_fur_covers_as_much(monkeypatch):
    rng = np.random.default_rng(1)
    points = np.cumsum(rng.uniform(0, 1, (1000, 6, 3)), axis=1).reshape(-1, 3)
    fur = points, rng.uniform(0.01, 0.02, 6000), np.arange(0, 6000, 6), np.ones(1000, dtype=bool), "fur"
    every = hair_mesh(*fur)
    monkeypatch.setattr(hair, "MAX_STRETCHES", 900)
    some = hair_mesh(*fur)
    assert len(every.faces) == 8 * 5000
    assert len(some.faces) == 8 * 833
    assert surface(some) == pytest.approx(surface(every), rel=0.03)


def surface(mesh):
    a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def test_a_bent_strand_follows_the_spline_through_its_points():
    """On a circle: halfway between points 30 degrees apart, the spline is (9 cos 15 - cos 45) / 8 from the center."""
    turn = np.linspace(-np.pi / 2, np.pi, 10)
    points = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    bent, chords = (strand(*points, radius=0.005, straight=straight) for straight in (False, True))
    off = [np.abs(np.linalg.norm(axis_points(mesh), axis=1) - 1.0) for mesh in (bent, chords)]
    inner = np.abs(np.arctan2(*axis_points(bent)[:, 1::-1].T) - np.pi / 4) < np.pi / 2
    assert off[0][inner].max() < 0.0017 + MAX_AXIS_RADII * 0.005
    assert off[1].max() > 0.03


def axis_points(mesh):
    """Centers of all prisms."""
    return mesh.vertices.reshape(-1, 8, 3).mean(axis=1)
