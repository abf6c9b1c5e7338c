"""Weather: its kinds, what it does to light on its way, and drops and flakes near the camera."""
