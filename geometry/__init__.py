"""Meshes, transforms, hulls, and predicates, without vehicles, cameras, or Blender."""
