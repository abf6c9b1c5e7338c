"""Names in tidy twins: `reading.blender.tidy` writes them, `rendering.blender.scene` reads them."""

PART = "hulldown_part"  # of a vehicle's objects: the index of their part
REST = "hulldown_rest"  # and the 16 numbers of vehicle_from_object at rest, float64, row by row
INPUT = "hulldown input "  # begins the names of what materials read of an object, or of an instance; a number follows
ROW = "hulldown row "  # and of rows 0 to 2 of file_from_object, of a vehicle's objects
