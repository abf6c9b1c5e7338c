"""Names in tidy twins: `reading.blender.tidy` writes them, `render.blender.scene` reads them."""

PART = "hulldown_part"  # of a vehicle's objects: the index of their part
REST = "hulldown_rest"  # and the 16 numbers of vehicle_from_object at rest, float64, row by row
RANDOM = "hulldown random"  # of an object, or of an instance: the random number that materials read
VISIBILITY = tuple(
    f"visible_{ray}" for ray in ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow")
)  # properties of an object: which rays see it
