"""Everything that needs Blender; the only folder that imports bpy.

    reading/    asset files to plain arrays, cached: before planning
    demo/       the demo assets, built by code

and beside them, planned poses to pictures, in the order in which it happens:

    supervisor -> todo, session, jobs -> pool -> process in the caller: what is left to do, who does it
        worker -> renderer -> scene, light, cycles       in processes of their own; blender_frames converts,
                                                         tidy_properties say what is what in a tidy twin
    annotations, png                                     what is written into the dataset
    masks, object_index                                  the annotations held against Cycles' own masks

`doctor` looks at the machine.
"""
