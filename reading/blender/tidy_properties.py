"""Names in tidy twins: `reading.blender.tidy` writes them, `rendering.blender.scene` reads them."""

PART = "hulldown_part"  # of a vehicle's objects: the index of their part
REST = "hulldown_rest"  # and the 16 numbers of vehicle_from_object at rest, float64, row by row
UNPAINTED = "hulldown_unpainted"  # of a vehicle's objects: whether they keep their colors as it is painted
