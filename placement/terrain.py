"""The ground: the topmost surface under a point, its height, normal and face."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from geometry.arrays import checked
from geometry.meshes import Mesh
from geometry.predicates import ORIENT_BOUND, TINY
from geometry.rays import RayCaster, in_coherent_blocks
from placement.certificate import EMPTY, SINGLE, SheetMap
from placement.exact import ExactGround
from placement.ground import Ground, normals_from_slopes

Method = Literal["certified", "refined", "float32"]


@dataclass(frozen=True, eq=False, slots=True)
class Hits:
    """The ground under n points.

    Parameters
    ----------
    z
        (n,) height in metres; nan where there is no ground.
    normal
        (n, 3) unit normal, pointing up; nan where there is no ground.
    face
        (n,) face index; -1 where there is no ground.
    """

    z: Float[np.ndarray, " n"]
    normal: Float[np.ndarray, "n 3"]
    face: Int[np.ndarray, " n"]

    @property
    def hit(self) -> Bool[np.ndarray, " n"]:
        """Whether there is ground under each point."""
        return self.face >= 0


class Terrain:
    """Ground that answers where its top is.

    Parameters
    ----------
    mesh
        All ground triangles, of any winding, connected or not, in metres, with coordinates within 1e30. Triangles
        that are exactly vertical or have no area are no ground.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._mesh = mesh
        self._bounds = mesh.bounds
        self._plane = False
        self._ground = ground = Ground.of(mesh)
        self._missing = not len(ground.faces)
        if self._missing:
            return
        low, high = _boxes(ground)
        self._exact = ExactGround(ground, low, high)
        bounds = np.stack([low.min(axis=0), high.max(axis=0)])
        self._sheets = SheetMap(mesh.vertices[:, :2], ground.faces, bounds, self._exact.count)
        self._caster = RayCaster(Mesh(mesh.vertices, ground.faces, mesh.name))

    @classmethod
    def flat(cls, z: float) -> Terrain:
        """The plane at this height, which goes on for ever: face 0 everywhere."""
        height = float(checked(z, "z", ()))
        terrain = cls.__new__(cls)
        corners = np.array([[-1.0, -1.0, height], [3.0, -1.0, height], [-1.0, 3.0, height]])
        terrain._mesh = Mesh(corners, np.array([[0, 1, 2]]), "plane")
        terrain._bounds = np.array([[-np.inf, -np.inf, height], [np.inf, np.inf, height]])
        terrain._plane = True
        return terrain

    @property
    def mesh(self) -> Mesh:
        """The ground as it was given; of a plane, one triangle of it."""
        return self._mesh

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the ground; of a plane, without end in x and y."""
        return self._bounds.copy()

    def top_hits(self, xy: ArrayLike, *, method: Method = "certified", threads: int = 1) -> Hits:
        """The highest ground at each point.

        Parameters
        ----------
        xy
            (n, 2) metres, in the mesh's frame; anywhere.
        method
            "float32": what Embree says. "refined": the height and normal, in float64, of the face that Embree names.
            "certified": the exact face, whatever float32 makes of it; its height within 8 ulp of the ground's
            largest |z|, its normal within 1e-12 radians.
        threads
            How many threads share the work.

        Raises
        ------
        ValueError
            If `xy` has another shape or a number that is not finite, or the method is unknown.
        """
        points = checked(xy, "xy", ("n", 2))
        if method not in get_args(Method):
            raise ValueError(f"method: expected one of {get_args(Method)}, got {method!r}")
        n = len(points)
        if self._plane:
            up = np.tile([0.0, 0.0, 1.0], (n, 1))
            return Hits(np.full(n, self._bounds[0, 2]), up, np.zeros(n, dtype=np.int32))
        hits = Hits(np.full(n, np.nan), np.full((n, 3), np.nan), np.full(n, -1, dtype=np.int32))
        if not self._missing:
            block = {"float32": self._float32, "refined": self._refined, "certified": self._certified}[method]
            in_coherent_blocks(lambda i: block(points, i, hits), points, threads=threads)
        return hits

    def _float32(self, points: Float[np.ndarray, "n 2"], i: Int[np.ndarray, " k"], hits: Hits) -> None:
        face, hits.z[i], normal = self._caster.down_in_full(points.take(i, axis=0))
        length = np.sqrt(np.einsum("ij,ij->i", normal, normal))
        with np.errstate(invalid="ignore"):
            hits.normal[i] = normal * (np.where(normal[:, 2] < 0, -1.0, 1.0) / length)[:, None]
        hits.face[i] = np.where(face < 0, -1, self._ground.mesh_face.take(face))

    def _refined(self, points: Float[np.ndarray, "n 2"], i: Int[np.ndarray, " k"], hits: Hits) -> None:
        xy = points.take(i, axis=0)
        face = self._caster.down(xy)
        met = np.flatnonzero(face >= 0)
        i, face = i.take(met), face.take(met)
        x, y = xy.take(met, axis=0).T.copy()
        hits.z[i] = self._ground.heights(x, y, face, self._ground.faces.take(face, axis=0)[:, 0])
        hits.normal[i] = normals_from_slopes(self._ground.slope.take(face, axis=0))
        hits.face[i] = self._ground.mesh_face.take(face)

    def _certified(self, points: Float[np.ndarray, "n 2"], i: Int[np.ndarray, " k"], hits: Hits) -> None:
        """Embree proposes; where a single sheet is certain and the point certainly inside, that is the answer."""
        ground = self._ground
        xy = points.take(i, axis=0)
        face = self._caster.down(xy)
        x, y = xy.T.copy()
        state = self._sheets.state(x, y)
        corners = ground.faces.take(face, axis=0, mode="clip").T.astype(np.intp)
        accepted = _strictly_inside(ground, corners, x, y)
        accepted &= (face >= 0) & (state == SINGLE)
        accepted &= ground.tame.take(face, mode="clip")
        z = ground.heights(x, y, face.clip(0), corners[0])
        normal = normals_from_slopes(ground.slope.take(face, axis=0, mode="clip"))
        if not accepted.all():
            z[~accepted], normal[~accepted], face[~accepted] = np.nan, np.nan, -1
            open_ = np.flatnonzero(~accepted & (state != EMPTY))
            tops = self._exact.tops(xy.take(open_, axis=0))
            z[open_], normal[open_], face[open_] = tops.z, tops.normal, tops.face
        hits.z[i] = z
        hits.normal[i] = normal
        hits.face[i] = np.where(face < 0, -1, ground.mesh_face.take(face, mode="clip"))


def _strictly_inside(
    ground: Ground, corners: Int[np.ndarray, "3 k"], x: Float[np.ndarray, " k"], y: Float[np.ndarray, " k"]
) -> Bool[np.ndarray, " k"]:
    """Whether each point is certainly inside its counter-clockwise triangle and on none of its edges."""
    dx = [ground.x.take(c) - x for c in corners]
    dy = [ground.y.take(c) - y for c in corners]
    inside = np.ones(len(x), dtype=bool)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        left, right = dx[a] * dy[b], dy[a] * dx[b]
        area = left - right
        np.abs(left, out=left)
        np.abs(right, out=right)
        left += right
        left *= ORIENT_BOUND
        left += TINY
        inside &= area > left
    return inside


def _boxes(ground: Ground) -> tuple[Float[np.ndarray, "f 2"], Float[np.ndarray, "f 2"]]:
    low, high = np.empty((len(ground.faces), 2)), np.empty((len(ground.faces), 2))
    for axis, values in enumerate((ground.x, ground.y)):
        a, b, c = (values.take(corner) for corner in ground.faces.T)
        low[:, axis] = np.minimum(np.minimum(a, b), c)
        high[:, axis] = np.maximum(np.maximum(a, b), c)
    return low, high
