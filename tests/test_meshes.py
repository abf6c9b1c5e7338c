import numpy as np
import pytest

from hulldown.geometry.meshes import Mesh, first_alike, merge

SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 2.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((4, 2)), FACES, r"mesh 'hill': vertices: expected numbers of shape \(v, 3\), got float64 \(4, 2\)"),
        (np.array([["a"] * 3] * 4), FACES, r"mesh 'hill': vertices: expected numbers"),
        (SQUARE, FACES[:, :2], r"mesh 'hill': faces: expected integers of shape \(f, 3\), got int64 \(2, 2\)"),
        (SQUARE, FACES.astype(float), r"mesh 'hill': faces: expected integers of shape \(f, 3\), got float64"),
        (SQUARE, FACES[:0], r"mesh 'hill': expected at least one face, got an empty mesh"),
        (np.zeros((0, 3)), FACES, r"mesh 'hill': face 0 is \[0, 1, 2\]; expected indices below 0"),
        (SQUARE, FACES + 1, r"mesh 'hill': face 1 is \[1, 3, 4\]; expected indices below 4"),
        (SQUARE, FACES - 1, r"mesh 'hill': face 0 is \[-1, 0, 1\]"),
        (SQUARE * [1, 1, np.nan], FACES, r"mesh 'hill': vertex 0 is \[0\.0, 0\.0, nan\]; expected finite"),
        (np.where(SQUARE == 2, np.inf, SQUARE), FACES, r"mesh 'hill': vertex 3 is \[0\.0, 1\.0, inf\]"),
    ],
)
def test_the_error_of_a_bad_mesh_names_it_and_the_first_bad_element(vertices, faces, message):
    with np.errstate(invalid="ignore"), pytest.raises(ValueError, match=message):
        Mesh(vertices, faces, "hill")


def test_bounds_exclude_unused_vertices():
    mesh = Mesh(np.vstack([SQUARE, [9.0, 9.0, 9.0]]), FACES)
    np.testing.assert_array_equal(mesh.bounds, [[0, 0, 0], [1, 1, 2]])


def test_merging_gives_the_mesh_of_each_face():
    merged, source = merge([Mesh(SQUARE, FACES[:1]), Mesh(SQUARE + 5, FACES)])
    assert source.tolist() == [0, 1, 1]
    np.testing.assert_array_equal(merged.triangles[1:], SQUARE[FACES] + 5)


def test_merging_nothing_is_an_error():
    with pytest.raises(ValueError, match="meshes: expected at least one mesh"):
        merge([])


def test_the_first_of_equal_points_represents_them():
    points = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -0.0], [0.0, 1.0], [5e-324, 1.0]])
    assert first_alike(points).tolist() == [0, 1, 0, 1, 4]
    assert first_alike(np.empty((0, 2))).tolist() == []
