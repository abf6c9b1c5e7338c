"""Runs inside Blender: opens one asset file and takes out of it what the renderer would draw."""
