"""Triangle meshes as two arrays, checked once when they are made."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.base.errors import AssetError
from hulldown.geometry.alpha import Cutouts, merged_cutouts
from hulldown.geometry.hulls import extreme_point_indices

MESH_SUFFIXES = (".ply", ".stl", ".obj", ".gltf", ".glb")


@dataclass(frozen=True, eq=False, slots=True)
class Mesh:
    """A triangle mesh, in its owner's frame.

    Parameters
    ----------
    vertices
        (v, 3) float64, finite, in meters.
    faces
        (f, 3) integer vertex indices. Winding has no meaning.
    name
        Its name in errors.
    cutouts
        Which faces textures cut out; None: none. Only `scene.cutouts` looks at them.
    extreme
        (k,) the vertices that `extreme_vertex_indices` finds, where they were stored with the mesh; None: not known.

    Raises
    ------
    ValueError
        Naming the mesh and the first offender: wrong shape, NaN or infinite vertex, face index out of range, no face.

    Examples
    --------
    >>> import numpy as np
    >>> mesh = Mesh(np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 1]]), np.array([[0, 1, 2]]), "ramp")
    >>> mesh.bounds.tolist()
    [[0.0, 0.0, 0.0], [2.0, 3.0, 1.0]]
    """

    # Plain arrays here: shapes are checked below, with errors that name the mesh.
    vertices: np.ndarray
    faces: np.ndarray
    name: str = "mesh"
    cutouts: Cutouts | None = None
    extreme: np.ndarray | None = None

    def __post_init__(self) -> None:
        vertices = np.asarray(self.vertices)
        faces = np.asarray(self.faces)
        if vertices.ndim != 2 or vertices.shape[1:] != (3,) or not np.issubdtype(vertices.dtype, np.number):
            raise ValueError(
                f"mesh {self.name!r}: vertices: expected numbers of shape (v, 3), got {vertices.dtype} {vertices.shape}"
            )
        if faces.ndim != 2 or faces.shape[1:] != (3,) or not np.issubdtype(faces.dtype, np.integer):
            raise ValueError(f"mesh {self.name!r}: faces: expected integers of shape (f, 3), got {faces.dtype} {faces.shape}")
        if not len(faces):
            raise ValueError(f"mesh {self.name!r}: expected at least one face, got an empty mesh")
        vertices = np.ascontiguousarray(vertices, dtype=np.float64)
        if not np.isfinite(vertices).all():
            i = int(np.argmax(~np.isfinite(vertices).all(axis=1)))
            raise ValueError(f"mesh {self.name!r}: vertex {i} is {vertices[i].tolist()}; expected finite coordinates")
        if faces.min() < 0 or faces.max() >= len(vertices):
            i = int(np.argmax(((faces < 0) | (faces >= len(vertices))).any(axis=1)))
            raise ValueError(f"mesh {self.name!r}: face {i} is {faces[i].tolist()}; expected indices below {len(vertices)}")
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", np.ascontiguousarray(faces, dtype=np.int32))

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the axis-aligned box around all vertices that a face uses."""
        used = self._used_mask()
        # Column by column: NumPy reduces a long thin array many times slower along its length.
        columns = [column if used.all() else column[used] for column in self.vertices.T]
        return np.array([[c.min() for c in columns], [c.max() for c in columns]])

    def _used_mask(self) -> Bool[np.ndarray, " v"]:
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces] = True
        return used

    @property
    def used_vertex_indices(self) -> Int[np.ndarray, " u"]:
        """Vertices that a face uses, ascending."""
        return np.flatnonzero(self._used_mask())

    def extreme_vertex_indices(self) -> Int[np.ndarray, " k"]:
        """Ascending vertices that include the maximum of every linear function over all used ones."""
        if self.extreme is not None:
            return self.extreme
        used = self.used_vertex_indices
        return used[extreme_point_indices(self.vertices[used])]

    @property
    def triangles(self) -> Float[np.ndarray, "f 3 3"]:
        """Corner points of every face."""
        return self.vertices[self.faces]

    def normals(self, face: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return unit normals of these faces, by their winding; nan for faces without area."""
        return unit_normals(self.vertices[self.faces[face]])

    def nearest_face(self, point: ArrayLike) -> int:
        """Return the face that is nearest to a point (3,)."""
        import trimesh

        triangles = self.triangles
        there = np.broadcast_to(checked_array(point, "point", (3,)), (len(triangles), 3))
        with np.errstate(invalid="ignore", divide="ignore"):  # faces without area
            apart = np.linalg.norm(trimesh.triangles.closest_point(triangles, there) - there, axis=1)
        return int(np.nanargmin(apart))

    def take_mesh_faces(self, face: Int[np.ndarray, " k"]) -> Mesh:
        """Return a mesh of these ascending faces and the vertices that they use."""
        used, faces = np.unique(self.faces[face], return_inverse=True)
        cutouts = self.cutouts and self.cutouts.take_faces(face)
        return Mesh(self.vertices[used], faces.reshape(-1, 3), self.name, cutouts)

    def with_vertices(self, points: Float[np.ndarray, "v 3"]) -> Mesh:
        """Return the same faces with their vertices elsewhere."""
        return Mesh(points, self.faces, self.name, self.cutouts)

    @classmethod
    def load(cls, path: str | Path) -> Mesh:
        """Return the triangles of a mesh file, without Blender: PLY, STL, OBJ, glTF or GLB.

        A file of many meshes is read as one, each where the scene puts it. Coordinates stay those of the file: glTF is
        y up by its own rules, and is not turned. For vehicles and sceneries, with names, materials and modifiers,
        `hulldown inspect` and the config read files through Blender.

        Parameters
        ----------
        path
            The file; its extension is the format, its name the mesh's.

        Raises
        ------
        AssetError
            If the file is missing, of another format, damaged or without triangles.
        """
        path = Path(path)
        _refuse_unknown_suffix(path)
        if not path.is_file():
            raise AssetError("isn't a file", path=path, remedy="check the path")
        import trimesh  # here, since it takes longer to import than all the rest of the geometry

        try:
            scene = trimesh.load_scene(path, process=False, allow_remote=False)
            mesh = scene.to_mesh()
        except Exception as error:  # on damaged files, trimesh raises any exception
            why = " ".join(f"{type(error).__name__}: {error}".split())
            raise AssetError(f"cannot be read as a mesh ({why})", path=path, remedy="export it anew") from None
        if not len(mesh.faces):
            raise AssetError("has no triangles", path=path, remedy="export surfaces, not only points, curves or lights")
        try:
            return cls(np.asarray(mesh.vertices), np.asarray(mesh.faces), path.stem)
        except ValueError as error:
            raise AssetError(str(error), path=path, remedy="export it anew") from None


def _refuse_unknown_suffix(path: Path) -> None:
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise AssetError(f"has the ending {path.suffix!r}", path=path, remedy=f"use a mesh file: {', '.join(MESH_SUFFIXES)}")


def unit_normals(triangles: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return unit normals of triangles, by their winding; nan for those without area."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    normal = np.cross(b - a, c - a)
    length = np.sqrt(np.einsum("ij,ij->i", normal, normal))
    return normal / np.where(length > 0.0, length, np.nan)[:, None]


def first_equal_indices(points: Float[np.ndarray, "n d"]) -> Int[np.ndarray, " n"]:
    """Return for every point the number of the first point at exactly the same place."""
    order = np.lexsort(points.T)  # stable: of equal points the lowest number comes first
    new = np.ones(len(order), dtype=bool)
    new[1:] = (points[order[1:]] != points[order[:-1]]).any(axis=1)
    first = np.empty(len(order), dtype=np.intp)
    first[order] = order[new][np.cumsum(new) - 1]
    return first


def merge_meshes_with_sources(meshes: Sequence[Mesh], *, name: str = "merged") -> tuple[Mesh, Int[np.ndarray, " f"]]:
    """Return all meshes as one, and for every face the index of the mesh it came from."""
    if not meshes:
        raise ValueError("meshes: expected at least one mesh, got none")
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    faces = np.concatenate([m.faces + int(o) for m, o in zip(meshes, offsets, strict=True)])
    counts = [len(m.faces) for m in meshes]
    cutouts = merged_cutouts([m.cutouts for m in meshes], counts)
    merged = Mesh(np.concatenate([m.vertices for m in meshes]), faces, name, cutouts)
    return merged, np.repeat(np.arange(len(meshes)), counts)
