"""Materials, inside Blender: opacity, cut-outs, textures, and paint."""
