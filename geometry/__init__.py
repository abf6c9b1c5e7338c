"""Meshes, rays, and rigid transforms, without vehicles, cameras, or Blender."""
