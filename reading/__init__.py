"""Other people's files into assets: what they hold, what is used of it and why; and the cache (paper, section 2.1.3).

`inspect` and `cache` ask `export`, which starts `blender.reader` in a process of its own for each file. What needs no
Blender (formats, roles, parts, doubts, the report) stands here; what runs inside Blender alone stands in `blender/`.
"""
