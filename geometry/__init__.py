"""Meshes, rays and rigid transforms; knows no vehicles, no cameras and no Blender."""
