"""The ground: the topmost surface under a point, its height, normal and face."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from geometry.arrays import checked
from geometry.meshes import Mesh
from geometry.rays import RayCaster, coherent_order, in_blocks

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
        All ground triangles, of any winding, connected or not. Triangles that are vertical or have no area are
        no ground.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.bounds = mesh.bounds
        self._caster = RayCaster(mesh)
        self._flat = False

    @classmethod
    def flat(cls, z: float) -> Terrain:
        """The plane at this height, which goes on for ever: face 0 everywhere."""
        height = float(checked(z, "z", ()))
        terrain = cls.__new__(cls)
        corners = np.array([[-1.0, -1.0, height], [3.0, -1.0, height], [-1.0, 3.0, height]])
        terrain.mesh = Mesh(corners, np.array([[0, 1, 2]]), "plane")
        terrain.bounds = np.array([[-np.inf, -np.inf, height], [np.inf, np.inf, height]])
        terrain._flat = True
        return terrain

    def top_hits(self, xy: ArrayLike, *, method: Method = "certified", threads: int = 1) -> Hits:
        """The highest ground at each point.

        Parameters
        ----------
        xy
            (n, 2) metres, in the mesh's frame; anywhere.
        method
            "float32": what Embree says. "refined": the height and normal, in float64, of the face that Embree names.
            "certified": the exact answer.
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
        if self._flat:
            up = np.tile([0.0, 0.0, 1.0], (n, 1))
            return Hits(np.full(n, self.bounds[0, 2]), up, np.zeros(n, dtype=np.int32))
        z, normal, face = np.empty(n), np.empty((n, 3)), np.empty(n, dtype=np.int32)

        def answer(i: Int[np.ndarray, " k"]) -> None:
            if method == "float32":
                face[i], z[i], up = self._caster.down_in_full(points[i])
                normal[i] = _unit_up(up)
            else:
                face[i], z[i], normal[i] = self._refined(points[i])

        in_blocks(answer, coherent_order(points), threads=threads)
        return Hits(z, normal, face)

    def _refined(
        self, xy: Float[np.ndarray, "k 2"]
    ) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
        face = self._caster.down(xy)
        a, b, c = np.moveaxis(self.mesh.vertices[self.mesh.faces[face]], 1, 0)
        cross = np.cross(b - a, c - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = a[:, 2] - ((xy - a[:, :2]) * cross[:, :2]).sum(axis=1) / cross[:, 2]
            normal = _unit_up(cross)
        z[face < 0] = np.nan
        normal[face < 0] = np.nan
        return face, z, normal


def _unit_up(normal: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 3"]:
    length = np.sqrt(np.einsum("ij,ij->i", normal, normal))
    return normal * (np.where(normal[:, 2] < 0, -1.0, 1.0) / length)[:, None]
