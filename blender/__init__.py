"""What reader and renderer share inside Blender: opening files, nodes, materials, buffers; needs numpy and bpy only."""
