"""Read asset files into vehicles, sceneries, and HDRIs, with a report and a cache (paper, section 2.1.3).

`cache` calls `export`, which starts a process with `blender.reader` for each file. Code that
needs no Blender (formats, roles, parts, doubts, the report) is here; code that runs inside Blender is in `blender/`.
"""
