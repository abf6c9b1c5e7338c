"""Names in tidy twins: `reading.blender.tidy` writes them, `render.blender.scene` reads them."""

PART_PROPERTY = "hulldown_part"  # index of the part that a vehicle's object belongs to
REST_PROPERTY = "hulldown_rest"  # 16 numbers of an object's vehicle_from_object at rest, float64, row by row
RANDOM_PROPERTY = "hulldown random"  # random number of an object or instance, which materials read
VISIBILITY_FLAGS = tuple(
    f"visible_{ray}" for ray in ("camera", "diffuse", "glossy", "transmission", "volume_scatter", "shadow")
)  # properties of an object: which rays see it
