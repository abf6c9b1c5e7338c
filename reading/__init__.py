"""Other people's files into assets: what they hold, what is used of it and why; and the cache (paper, section 2.1.3).

`inspect` and `cache` call `export`, which starts `blender.reader` in a process of its own for each file. Code that
needs no Blender (formats, roles, parts, doubts, the report) is here; code that runs inside Blender is in `blender/`.
"""
