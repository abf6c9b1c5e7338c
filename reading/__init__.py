"""Read asset files into vehicles, sceneries, and HDRIs (paper, section 2.1.3); `blender/` runs inside Blender."""
