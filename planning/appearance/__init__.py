"""What an image looks like: weather, light, exposure, and paint, as functions of the seed."""
