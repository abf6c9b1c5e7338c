"""Asset files to plain arrays, once a file; call `cache` for a config or plan, `export` for one file.

In the order in which it happens:

    cache -> store -> export -> formats                  in the caller: is it read already? can it be read?
        reader -> importers, textures -> capture, evaluate, poses
                                                         in a process of its own: what does the file draw?
        cleanup, parts -> build -> tidy, report, doubts  no Blender: what of it is what? bundle, twin and report
    inspect                                              the same for a person
"""
