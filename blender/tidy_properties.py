"""Names in tidy twins: `reading.blender.tidy` writes them, `render.blender.scene` reads them."""

PART_PROPERTY = "hulldown_part"  # of a vehicle's objects: the index of their part
REST_PROPERTY = "hulldown_rest"  # and the 16 numbers of vehicle_from_object at rest, float64, row by row
RANDOM_PROPERTY = "hulldown random"  # of an object, or of an instance: the random number that materials read
VISIBILITY_FLAGS = tuple(
    f"visible_{ray}" for ray in ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow")
)  # properties of an object: which rays see it
