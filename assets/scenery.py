"""A scenery: ground, and obstacles for vehicles and cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.geometry.transforms import transform_points


@dataclass(frozen=True, eq=False, slots=True)
class Scenery:
    """A scenery relative to its origin, z up, meters."""

    name: str  # the scenery's name, unique in a config
    # meters, subtracted from the file's coordinates; everything else here is relative to it
    origin: Float[np.ndarray, "3"]
    # all ground meshes merged, or None if the file has none: the ground is then the plane z = fallback_z
    ground: Mesh | None
    ground_names: tuple[str, ...]  # object name of each ground mesh
    obstacle_meshes: tuple[Mesh, ...]  # unique meshes of everything but ground (boulders, trees), each in its own frame
    instance_mesh: Int[np.ndarray, " k"]  # for each obstacle instance the index into `obstacle_meshes`
    world_from_instance: Float[np.ndarray, "k 4 4"]  # affine pose of each instance; may mirror and scale unevenly
    instance_names: tuple[str, ...]  # object name of each instance
    # whether it only hides, like grass: vehicles drive over it, and cameras look out of it
    instance_gives_way: Bool[np.ndarray, " k"]
    instance_is_water: Bool[np.ndarray, " k"]  # whether it's water: a surface that hides, with nothing placed below
    # affine: from the file's world coordinates to meters, z up, relative to `origin`
    scenery_from_file: Float[np.ndarray, "4 4"]
    crs: str = ""  # the coordinate reference system that `origin` is in: "EPSG:32632", or WKT; "" if there is none

    @property
    def solid_instance_mask(self) -> Bool[np.ndarray, " k"]:
        """(k,) instances that nothing may touch: all but grass and water."""
        return ~(self.instance_gives_way | self.instance_is_water)

    def water_surface(self) -> Mesh | None:
        """Return all water surfaces merged, or None if there is none."""
        wet = np.flatnonzero(self.instance_is_water)
        placed = [
            Mesh(transform_points(self.world_from_instance[i], mesh.vertices), mesh.faces, self.instance_names[i])
            for i, mesh in ((i, self.obstacle_meshes[self.instance_mesh[i]]) for i in wet)
        ]
        return merge_meshes_with_sources(placed, name=f"water of {self.name}")[0] if placed else None
