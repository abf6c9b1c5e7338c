"""The ground, and top hits: the topmost surface under a point, its height, normal, and face."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Complex, Float, Int, UInt8
from numpy.typing import ArrayLike

from hulldown.base.arrays import checked_array
from hulldown.geometry.meshes import Mesh
from hulldown.geometry.predicates import MIN_EXACT_PRODUCT, ORIENT_BOUND
from hulldown.placement.exact import ExactGround
from hulldown.placement.ground_faces import HEIGHT_ULPS, GroundFaceHits, GroundFaces, plane_heights, upward_normals
from hulldown.placement.sheet_map import MAX_TRACED_SHEETS, SheetMap
from hulldown.scene.ray_caster import RayCaster, checked_mesh_bounds, coherent_index_blocks


class Terrain:
    """Ground for top hits.

    Parameters
    ----------
    ground
        A mesh: all ground triangles, of any winding, connected or not, in meters, with coordinates within 1e30.
        Exactly vertical triangles and those without area don't count. Or the height of an infinite plane.
    caster
        An existing ray caster of the same mesh.

    Examples
    --------
    >>> import numpy as np
    >>> from hulldown.geometry.meshes import Mesh
    >>> slope = Mesh(np.array([[0.0, 0, 0], [10, 0, 5], [10, 10, 5], [0, 10, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    >>> hits = Terrain(slope).top_hits([[4.0, 3.0], [20.0, 0.0]])
    >>> hits.z.tolist(), hits.face.tolist()
    ([2.0, nan], [0, -1])
    """

    def __init__(self, ground: Mesh | float, *, caster: RayCaster | None = None) -> None:
        self._plane = not isinstance(ground, Mesh)
        if not isinstance(ground, Mesh):
            z = float(checked_array(ground, "ground", ()))
            self._mesh = Mesh(np.array([[-1.0, -1.0, z], [3.0, -1.0, z], [-1.0, 3.0, z]]), np.array([[0, 1, 2]]), "plane")
            self._bounds = np.array([[-np.inf, -np.inf, z], [np.inf, np.inf, z]])
            return
        self._mesh = mesh = ground
        self._bounds = checked_mesh_bounds(mesh)
        self._ground = top = GroundFaces.from_mesh(mesh)
        self._missing = not len(top.mesh_face)
        if self._missing:
            return
        boxes = top.face_boxes()
        self._exact = ExactGround(top, *boxes)
        bounds = np.stack([boxes[0, :2].min(axis=1), boxes[1, :2].max(axis=1)])
        self._sheets = SheetMap(mesh.vertices, top.corners, bounds, self._exact.count)
        # Faces without XY area would slow Embree down, and could only mislead it.
        every = len(top.mesh_face) == len(mesh.faces)
        if every and caster is not None:
            self._caster = caster
        else:
            self._caster = RayCaster(mesh if every else Mesh(mesh.vertices, mesh.faces[top.mesh_face], mesh.name))
        self._apart = 4.0 * HEIGHT_ULPS * float(np.spacing(np.abs(self._bounds[:, 2]).max()))

    @property
    def mesh(self) -> Mesh:
        """The ground's mesh; for a plane, one triangle of it."""
        return self._mesh

    @property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lowest and highest corner of the ground; infinite in x and y for a plane."""
        return self._bounds.copy()

    def top_hits(self, xy: ArrayLike) -> GroundFaceHits:
        """Return the highest ground at each point: the exact face, its height, and its normal.

        The height is within 8 ulp of the ground's largest |z|, and the normal within 1e-12 radians.

        Parameters
        ----------
        xy
            (n, 2) meters, in the mesh's frame; anywhere.

        Raises
        ------
        ValueError
            If `xy` has another shape or a number that is not finite.
        """
        points = checked_array(xy, "xy", ("n", 2))
        n = len(points)
        if self._plane:
            up = np.tile([0.0, 0.0, 1.0], (n, 1))
            return GroundFaceHits(np.full(n, self._bounds[0, 2]), up, np.zeros(n, dtype=np.int32))
        if self._missing:
            return GroundFaceHits(np.full(n, np.nan), np.full((n, 3), np.nan), np.full(n, -1, dtype=np.int32))
        hits = GroundFaceHits(np.empty(n), np.empty((n, 3)), np.empty(n, dtype=np.int32))
        # Some points are so far away that only their being outside can be computed.
        with np.errstate(over="ignore", invalid="ignore"):
            for i in coherent_index_blocks(points):
                self._fill_block_hits(points, i, hits)
        return hits

    def _fill_block_hits(self, points: Float[np.ndarray, "n 2"], i: Int[np.ndarray, " k"], hits: GroundFaceHits) -> None:
        x, y = _point_columns(points, i)
        proposal = self._caster.top_face(x, y).astype(np.intp)
        accepted, z, slope = self._inside_mask_height_and_slope(proposal, x, y)
        sheets = self._sheets.count(x, y)
        several = np.flatnonzero(accepted & (sheets > 1) & (sheets <= MAX_TRACED_SHEETS))
        accepted &= sheets == 1
        if len(several):
            here = x[several], y[several]
            accepted[several] = self._all_sheets_found_mask(sheets[several], *here, z[several], slope[several])
        face, normal = proposal, upward_normals(slope)
        rest = np.flatnonzero(~accepted)
        if len(rest):
            proposed = proposal[rest]
            face[rest], z[rest], normal[rest] = -1, np.nan, np.nan
            somewhere = sheets[rest] > 0
            rest = rest[somewhere]
            tops = self._exact.top_hits(x[rest], y[rest], proposed[somewhere])
            face[rest], z[rest], normal[rest] = tops.face, tops.z, tops.normal
        self._write_hits(hits, i, face, z, normal)

    def _faces_below_planes(
        self,
        x: Float[np.ndarray, " k"],
        y: Float[np.ndarray, " k"],
        z: Float[np.ndarray, " k"],
        slope: Complex[np.ndarray, " k"],
    ) -> Int[np.ndarray, " k"]:
        """Return the first face that is farther below faces of these heights and slopes than float32 errs, or -1."""
        gap = 4 * self._caster.resolution * (1.0 + np.abs(slope.real) + np.abs(slope.imag))
        return self._caster.first_face_below(x, y, z - gap).astype(np.intp)

    def _all_sheets_found_mask(
        self,
        sheets: UInt8[np.ndarray, " k"],
        x: Float[np.ndarray, " k"],
        y: Float[np.ndarray, " k"],
        z: Float[np.ndarray, " k"],
        slope: Complex[np.ndarray, " k"],
    ) -> Bool[np.ndarray, " k"]:
        """Return whether `sheets` - 1 sheets are found under a face, each certainly lower than the one before."""
        found = np.zeros(len(x), dtype=bool)
        row, n = np.arange(len(x)), 1
        while len(row):
            lower, z_lower, slope = self._inside_mask_height_and_slope(self._faces_below_planes(x, y, z, slope), x, y)
            lower &= z_lower < z - self._apart
            n += 1
            found[row[lower & (sheets == n)]] = True
            more = np.flatnonzero(lower & (sheets > n))
            row, sheets, x, y, z, slope = row[more], sheets[more], x[more], y[more], z_lower[more], slope[more]
        return found

    def _inside_mask_height_and_slope(
        self, face: Int[np.ndarray, " k"], x: Float[np.ndarray, " k"], y: Float[np.ndarray, " k"]
    ) -> tuple[Bool[np.ndarray, " k"], Float[np.ndarray, " k"], Complex[np.ndarray, " k"]]:
        """Return which points are certainly in their well-conditioned faces, the faces' heights there, and slopes."""
        g = self._ground
        corners = [corner[face].astype(np.intp) for corner in g.corners]  # -1 reads the last face
        dx, dy = [g.x[c] - x for c in corners], [g.y[c] - y for c in corners]
        inside = _strictly_inside_mask(dx, dy)
        inside &= face >= 0
        inside &= g.well_conditioned[face]
        slope = g.slope[face]
        return inside, plane_heights(slope, -dx[0], -dy[0], g.z[corners[0]]), slope

    def _write_hits(
        self,
        hits: GroundFaceHits,
        i: Int[np.ndarray, " k"],
        face: Int[np.ndarray, " k"],
        z: Float[np.ndarray, " k"],
        normal: Float[np.ndarray, "k 3"],
    ) -> None:
        hits.z[i] = z
        # As one 24-byte item a row: several times as fast as rows of three.
        hits.normal.view(_VERTEX_BYTES)[:, 0][i] = normal.view(_VERTEX_BYTES)[:, 0]
        mesh_face = self._ground.mesh_face[face]
        mesh_face[face < 0] = -1
        hits.face[i] = mesh_face


_VERTEX_BYTES = np.dtype("V24")


def _point_columns(
    points: Float[np.ndarray, "n 2"], i: Int[np.ndarray, " k"]
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    # As complex numbers, which NumPy gathers twice as fast as rows of two.
    xy = points.view(np.complex128)[:, 0][i]
    return np.ascontiguousarray(xy.real), np.ascontiguousarray(xy.imag)


def _strictly_inside_mask(dx: list[Float[np.ndarray, " k"]], dy: list[Float[np.ndarray, " k"]]) -> Bool[np.ndarray, " k"]:
    """Return which points are certainly inside their counterclockwise triangles; corners are relative to them."""
    inside = np.ones(len(dx[0]), dtype=bool)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        left, right = dx[a] * dy[b], dy[a] * dx[b]
        area = left - right
        np.abs(left, out=left)
        np.abs(right, out=right)
        left += right
        left *= ORIENT_BOUND
        left += MIN_EXACT_PRODUCT
        inside &= area > left
    return inside
