"""Runs inside Blender, bpy's or an installed one; needs numpy and bpy only."""
