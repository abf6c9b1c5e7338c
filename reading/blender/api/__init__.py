"""Arrays, nodes, and renders by Blender's API."""
