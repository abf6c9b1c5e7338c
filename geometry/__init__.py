"""Meshes, rays, transforms, and portable arithmetic, without vehicles, cameras, or Blender."""
