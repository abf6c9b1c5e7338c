import numpy as np
import pytest
import trimesh

from hulldown.base.errors import AssetError
from hulldown.geometry.meshes import MESH_SUFFIXES, Mesh, first_equal_indices, merge_meshes_with_sources
from hulldown.geometry.transforms import rigid_matrix, rotation_z
from hulldown.tests.builders.shapes import surface

SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 2.0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def test_bounds_exclude_unused_vertices():
    mesh = Mesh(np.vstack([SQUARE, [9.0, 9.0, 9.0]]), FACES)
    np.testing.assert_array_equal(mesh.bounds, [[0, 0, 0], [1, 1, 2]])


def test_merging_gives_the_mesh_of_each_face():
    merged, source = merge_meshes_with_sources([Mesh(SQUARE, FACES[:1]), Mesh(SQUARE + 5, FACES)])
    assert source.tolist() == [0, 1, 1]
    np.testing.assert_array_equal(merged.triangles[1:], SQUARE[FACES] + 5)


def test_the_first_of_equal_points_represents_them():
    points = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, -0.0], [0.0, 1.0], [5e-324, 1.0]])
    assert first_equal_indices(points).tolist() == [0, 1, 0, 1, 4]
    assert first_equal_indices(np.empty((0, 2))).tolist() == []


def hill() -> Mesh:
    x, y = np.arange(5.0), np.arange(4.0)
    return surface(x, y, np.add.outer(np.sin(x), np.sin(y)) / 3.0, "hill")


@pytest.mark.parametrize("ending", [*MESH_SUFFIXES, ".PLY"])
def test_a_mesh_file_is_loaded(tmp_path, ending):
    mesh, kind = hill(), ending[1:].lower()
    options = {"obj": {"digits": 17}, "gltf": {"merge_buffers": True, "embed_buffers": True}}.get(kind, {})
    content = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(file_type=kind, **options)
    content = content["model.gltf"] if kind == "gltf" else content
    (tmp_path / f"hill{ending}").write_bytes(content.encode() if isinstance(content, str) else content)
    loaded = Mesh.load(tmp_path / f"hill{ending}")
    assert loaded.name == "hill"
    # Compared face by face, since STL repeats vertices; OBJ is exact, the others are float32.
    rounded = mesh.triangles if ending == ".obj" else mesh.triangles.astype(np.float32)
    np.testing.assert_allclose(loaded.triangles, rounded, rtol=0, atol=1e-16)


def test_meshes_of_a_scene_are_in_their_places(tmp_path):
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    scene = trimesh.Scene()
    scene.add_geometry(box, transform=rigid_matrix(np.eye(3), [10.0, 0.0, 0.0]))
    scene.add_geometry(box, transform=rigid_matrix(rotation_z(np.pi / 4), [0.0, 20.0, 0.0]))
    scene.export(str(tmp_path / "two.glb"))
    mesh = Mesh.load(tmp_path / "two.glb")
    assert len(mesh.faces) == 24
    np.testing.assert_allclose(mesh.bounds, [[-np.sqrt(2), -1, -1], [11, 20 + np.sqrt(2), 1]], atol=1e-5)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", b"ply\nrubbish", "cannot be read as a mesh"),
        ("a.glb", b"xx", "cannot be read as a mesh"),
        ("a.gltf", b"{}", "cannot be read as a mesh|has no triangles"),
        ("a.stl", b"solid nothing\nendsolid", "has no triangles"),
        ("a.obj", b"v 0 0 0\n", "has no triangles"),
        ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "expected finite coordinates"),
        ("a.blend", b"BLENDER", r"has the ending '\.blend'; use a mesh file: \.ply, "),
        ("a.ply", None, "isn.t a file; check the path"),
    ],
)
def test_a_file_without_a_mesh_is_refused_with_its_name(tmp_path, name, content, message):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(AssetError, match=message) as refused:
        Mesh.load(tmp_path / name)
    assert str(refused.value).startswith(str(tmp_path / name))
    assert "\n" not in str(refused.value)


def test_normals_equal_those_of_trimesh():
    vertices = np.random.default_rng(0).normal(size=(60, 3))
    mesh = Mesh(vertices, np.arange(60).reshape(-1, 3))
    oracle = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).face_normals
    np.testing.assert_allclose(mesh.normals(np.arange(20)), oracle, atol=1e-12)
    flat = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))
    assert np.isnan(flat.normals(np.array([0]))).all()
