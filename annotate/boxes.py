"""The exact box of a posed vehicle in an image, known before rendering (paper, section 2.1.7).

The rule is `surface_box`: clip every triangle, project what is left, take the extremes. `VehicleBoxes` gives the
same answer from the few vertices that can be extreme, and clips only where a plane cuts the vehicle.

How far rounding can move a box: let u = 2⁻⁵³, and take vertex, camera position t, rotation and f (`f_px`) as they
are stored. A vertex v at distance d = |v − t| has camera coordinates (x, y, z), and falls on the column f a + w/2 with
a = x/z. `surface_box` rounds three times over:

- Subtraction. Each coordinate of v − t is off by u of itself at most.
- Rotation. A sum of three products is off by 3u/(1 − 3u) times the sum of their sizes at most, in any order and
  with or without fused operations (Higham, section 3.1). The axes are unit vectors, so that sum is at most d by Cauchy
  and Schwarz. With the subtraction, x and z are each off by

      E = 4 u d.

- Division and pixels. x̃/z̃ differs from a by (x̃ − x)/z̃ − a (z̃ − z)/z̃, so by E (1 + |a|)/z at most; the
  quotient and the product with f round by u f |a| each, the sum with w/2 by u times the column.

In the image f |a| is at most w/2 and the column at most w. So, up to second order in u,

    |column computed − column| ≤ 4 u f (1 + |a|) d/z + 2 u w,

and the same for rows, with b = y/z and h. A side of a framed box is the largest or least of such columns, so it is
off by no more than its worst vertex. d/z is √(1 + a² + b²), the same near and far: what counts is the angle off the
axis, not the distance. In a corner of 1920 x 1080 the bound is 1.8e-12 px at 60 degrees, 4.9e-10 px at 0.1 degrees
and 5.6e-11 px at 179.

`VehicleBoxes` multiplies the rotations first and adds the difference of the positions last, so that it keeps its
digits at map coordinates. With D from the camera to the vehicle's origin and ρ from there to the vertex, E = 10 u (D
+ ρ) in place of 4 u d.

Two things have no such bound and are measured instead (docs/benchmarks.md: 5e-12 px at worst): turret
and gun, which put up to two more matrices into the product, and cuts, which move by their rounding over the sine of
the angle between plane and edge. A clipped box is the exact one of a frustum that is moved by rounding.

Higham, Accuracy and Stability of Numerical Algorithms, 2nd edition, SIAM, 2002.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from hulldown.annotate.extremes import ImageView, surface_extremes
from hulldown.annotate.posing import PosedParts, transform_part_points
from hulldown.assets.vehicle import VehicleShape
from hulldown.base.arrays import checked_array
from hulldown.camera.cameras import NEAR_M, Cameras
from hulldown.camera.intrinsics import Intrinsics

MAX_BATCH_POSES = 4096  # bounds the memory of their matrices
CLEAR_MARGIN_PX = 1e-6  # rounding can't move a point into the image from farther outside
POINTS_PER_BLOCK = 1 << 15  # a block stays in the second-level cache


@dataclass(frozen=True, eq=False, slots=True)
class Boxes:
    """Boxes of n poses, as COCO writes them: x, y, width, height in continuous pixels."""

    xywh: Float[np.ndarray, "n 4"]  # tight box of the surface inside the image; nan where there is none
    # tight box of the surface in front of the near plane, inside the image or not; nan where there is none
    amodal: Float[np.ndarray, "n 4"]
    # share of the amodal box's area that the box in the image lacks: 0 framed, 1 out of the image
    truncated_fraction: Float[np.ndarray, " n"]


def surface_box(
    vertices_world: ArrayLike, faces: ArrayLike, camera: Cameras, *, frame: bool = True
) -> Float[np.ndarray, "4"] | None:
    """Tight box of a triangle mesh's surface: the exact rule.

    Parameters
    ----------
    vertices_world
        (v, 3) meters.
    faces
        (f, 3) vertex indices.
    camera
        The camera.
    frame
        Whether only the surface inside the image counts, or all of it in front of the near plane (`NEAR_M` meters).

    Returns
    -------
    xywh in continuous pixels, or None if no surface counts. Occlusion is ignored.

    Examples
    --------
    >>> import math
    >>> import numpy as np
    >>> from hulldown.camera.intrinsics import Intrinsics
    >>> camera = Cameras(Intrinsics(640, 480, math.pi / 2), np.eye(4))
    >>> triangle = np.array([[-1.0, -1.0, 10.0], [1.0, -1.0, 10.0], [0.0, 1.0, 10.0]])
    >>> surface_box(triangle, [[0, 1, 2]], camera).round(6).tolist()
    [288.0, 208.0, 64.0, 64.0]
    """
    vertices = checked_array(vertices_world, "vertices_world", ("v", 3))
    triangles = checked_array(faces, "faces", ("f", 3), dtype=np.int64)
    if len(triangles) and not 0 <= triangles.min() <= triangles.max() < len(vertices):
        raise ValueError(f"faces: expected indices below {len(vertices)}, got {triangles.min()} to {triangles.max()}")
    # The position is subtracted first: far from the origin a product with the whole matrix would lose digits.
    used, number = np.unique(triangles, return_inverse=True)
    triangles = number.reshape(-1, 3)
    points = (camera.world_from_camera[:3, :3].T @ (vertices[used] - camera.position).T).copy()
    return _box_or_none(_surface_box_in_view(points, triangles, ImageView(camera.lenses, frame)))


class VehicleBoxes:
    """Boxes of one vehicle in any pose and articulation, equal to `surface_box` of its posed mesh.

    Parameters
    ----------
    shape
        The vehicle.

    Examples
    --------
    >>> import math
    >>> import numpy as np
    >>> from hulldown.camera.intrinsics import Intrinsics
    >>> from hulldown.geometry.meshes import Mesh
    >>> wall = Mesh(np.array([[0.0, -2, 0], [0, 2, 0], [0, 2, 3], [0, -2, 3]]), np.array([[0, 1, 2], [0, 2, 3]]))
    >>> rigid = VehicleShape(
    ...     "wall", wall, np.zeros(4, int), ("hull",), np.array([-1]), np.zeros((1, 3)), np.array([[0.0, 0, 1]]),
    ...     np.zeros((1, 2)), np.eye(4),
    ... )
    >>> looking_along_x = np.array([[0.0, 0, 1, -10], [-1, 0, 0, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])
    >>> camera = Cameras(Intrinsics(640, 480, math.pi / 2), looking_along_x)
    >>> VehicleBoxes(rigid).box(np.eye(4), camera).round(6).tolist()
    [256.0, 192.0, 128.0, 96.0]
    """

    def __init__(self, shape: VehicleShape) -> None:
        self.shape = shape
        self._parts = PosedParts(shape)

    def box(
        self,
        world_from_vehicle: ArrayLike,
        camera: Cameras,
        articulation: Mapping[str, float] | None = None,
        *,
        frame: bool = True,
    ) -> Float[np.ndarray, "4"] | None:
        """Tight box of the vehicle's surface.

        Parameters
        ----------
        world_from_vehicle
            (4, 4) rigid pose.
        camera
            What it is seen by.
        articulation
            Part name -> radians; parts not named are at rest.
        frame
            Whether only the surface inside the image counts, or all of it in front of the near plane.

        Returns
        -------
        xywh in continuous pixels, or None if no surface counts.
        """
        pose = checked_array(world_from_vehicle, "world_from_vehicle", (4, 4))[None]
        found = self.boxes(pose, camera.with_poses(camera.world_from_camera[None]), [articulation or {}])
        return _box_or_none((found.xywh if frame else found.amodal)[0])

    def boxes(
        self,
        world_from_vehicle: ArrayLike,
        cameras: Cameras,
        articulations: Sequence[Mapping[str, float]] | Float[np.ndarray, "n p"] | None = None,
    ) -> Boxes:
        """Return boxes of n poses at once.

        Parameters
        ----------
        world_from_vehicle
            (n, 4, 4) rigid poses.
        cameras
            n cameras.
        articulations
            One for each, part name -> radians, or (n, p) angles; none: all parts at rest.
        """
        vehicles = checked_array(world_from_vehicle, "world_from_vehicle", ("n", 4, 4))
        n, lenses = len(vehicles), cameras.lenses
        turned = [{}] * n if articulations is None else articulations
        for name, given in (("cameras", cameras), ("articulations", turned)):
            if len(given) != n:
                raise ValueError(f"{name}: expected {n}, one for each vehicle pose, got {len(given)}")
        angles = turned if isinstance(turned, np.ndarray) else self.shape.angles(turned)
        xywh, amodal = np.full((n, 4), np.nan), np.full((n, 4), np.nan)
        for start in range(0, n, MAX_BATCH_POSES):
            rows = slice(start, min(start + MAX_BATCH_POSES, n))
            camera_from_parts = self._parts.camera_from_parts(vehicles[rows], cameras.world_from_camera[rows], angles[rows])
            xywh[rows], amodal[rows] = self._framed_and_amodal_boxes(camera_from_parts, lenses.take(rows))
        return Boxes(xywh, amodal, truncated_fraction(xywh, amodal))

    def _framed_and_amodal_boxes(
        self, camera_from_parts: Float[np.ndarray, "n p 3 4"], lenses: Intrinsics
    ) -> tuple[Float[np.ndarray, "n 4"], Float[np.ndarray, "n 4"]]:
        faces, size = self._parts.faces, lenses.size
        low, high, nearest, farthest = self._hull_corners_and_depths(camera_from_parts, lenses)
        # A surface wholly in front of the camera has the box of its hull, if the lens doesn't bend its edges.
        whole = (nearest >= NEAR_M) & (not lenses.is_distorted)
        amodal = np.where(whole[:, None], np.concatenate([low, high - low], axis=1), np.nan)
        framed = (low >= 0.0).all(axis=1) & (high <= size).all(axis=1)
        out_of_frame = ((high < -CLEAR_MARGIN_PX) | (low > size + CLEAR_MARGIN_PX)).any(axis=1)
        xywh = np.where((whole & framed)[:, None], amodal, np.nan)
        for i in np.flatnonzero((farthest >= NEAR_M) & ~(whole & (framed | out_of_frame))).tolist():
            points, lens = self._points_in_camera(camera_from_parts[i]), lenses.take(i)
            if not whole[i]:
                amodal[i] = _surface_box_in_view(points, faces, ImageView(lens, clip_to_image=False))
                first, last = amodal[i, :2], amodal[i, :2] + amodal[i, 2:]
                if (first >= 0.0).all() and (last <= size).all():
                    xywh[i] = amodal[i]
                    continue
                if not ((last >= -CLEAR_MARGIN_PX).all() and (first <= size + CLEAR_MARGIN_PX).all()):
                    continue
            xywh[i] = _surface_box_in_view(points, faces, ImageView(lens, clip_to_image=True))
        return xywh, amodal

    def _points_in_camera(self, camera_from_parts: Float[np.ndarray, "p 3 4"]) -> Float[np.ndarray, "3 v"]:
        return transform_part_points(self._parts.vertices, self._parts.vertex_slices, camera_from_parts[None])[:, 0]

    def _hull_corners_and_depths(
        self, camera_from_parts: Float[np.ndarray, "n p 3 4"], lenses: Intrinsics
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Low and high corners in pixels of n hulls, and depths; valid in front of the camera, without distortion."""
        n = len(camera_from_parts)
        nearest, farthest, extremes = np.empty(n), np.empty(n), np.empty((n, 4))
        step = max(1, POINTS_PER_BLOCK // self._parts.extreme.shape[1])
        for start in range(0, n, step):
            rows = slice(start, start + step)
            x, y, z = transform_part_points(self._parts.extreme, self._parts.extreme_slices, camera_from_parts[rows])
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                x /= z
                y /= z
            nearest[rows], farthest[rows] = z.min(axis=1), z.max(axis=1)
            # Scaling to pixels is monotone, rounding included: the extremes may be taken first.
            for column, extreme in enumerate((x.min(axis=1), y.min(axis=1), x.max(axis=1), y.max(axis=1))):
                extremes[rows, column] = extreme
        low, high = (extremes.reshape(n, 2, 2) * lenses.focal[..., None, :] + lenses.center).swapaxes(0, 1)
        return low, high, nearest, farthest


def truncated_fraction(xywh: ArrayLike, amodal: ArrayLike) -> Float[np.ndarray, "..."]:
    """Return the share of an amodal box's area (or of a side, if the other is 0) that `xywh` lacks; 1 for nan."""
    inner = checked_array(xywh, "xywh", ("...", 4), finite=False)
    outer = checked_array(amodal, "amodal", ("...", 4), finite=False)
    with np.errstate(invalid="ignore", divide="ignore"):
        sides = np.where(outer[..., 2:] > 0.0, inner[..., 2:] / outer[..., 2:], 1.0)
    share = np.where(np.isnan(inner[..., 0]), 0.0, sides[..., 0] * sides[..., 1])
    return np.asarray(np.clip(1.0 - share, 0.0, 1.0))


def _surface_box_in_view(
    points: Float[np.ndarray, "3 v"], faces: Int[np.ndarray, "f 3"], view: ImageView
) -> Float[np.ndarray, "4"]:
    extremes = surface_extremes(points, faces, view)
    empty = not extremes[0] <= extremes[2]
    return np.full(4, np.nan) if empty else np.concatenate([extremes[:2], extremes[2:] - extremes[:2]])


def _box_or_none(box: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"] | None:
    return None if np.isnan(box[0]) else box
