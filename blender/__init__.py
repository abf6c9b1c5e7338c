"""What the reader and the renderer share inside Blender's process: opening files, nodes, materials, and buffers."""
