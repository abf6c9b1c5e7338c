"""Runs inside Blender: opens one asset file and extracts everything that the renderer would draw."""
