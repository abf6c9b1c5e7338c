"""What an image looks like: light, exposure, lens, and paint, as functions of the seed."""
