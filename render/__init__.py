"""Everything that needs Blender: reading asset files, rendering planned poses. The only folder that imports bpy.

Reading a file, in the order it happens (call `cache` for a config, `export` for one file):

    cache -> store -> export -> formats                  in the caller: is it read already? can it be read?
        reader -> importers, textures -> capture, evaluate, poses
                                                         in a process of its own: what does the file draw?
        cleanup, parts -> build -> tidy, report, doubts  no Blender: what of it is what? bundle, twin and report
    inspect                                              the same for a person

Rendering a plan:

    supervisor -> session, jobs -> pool -> process       in the caller: what is left to do, who does it
        worker -> renderer -> scene, light, cycles       in processes of their own; blender_frames converts
    annotations, provenance, png                         what is written beside the pictures
    masks, object_index                                  the annotations held against Cycles' own masks

`doctor` looks at the machine; `demo/` builds the demo assets.
"""
