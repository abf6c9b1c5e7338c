"""Planned rows through Cycles (paper, section 2.1.4): what happens, in the order in which it happens.

    supervisor -> remaining, session, jobs -> pool -> process     in the caller: what is left to do, and who does it
        blender/worker -> renderer -> scene, light, cycles   in processes of their own
    cluster_pool -> cluster -> node -> pool                  on a Dask cluster, in place of a pool: see docs/cluster.md
    annotations, png                                         what is written into the dataset
    masks                                                    the annotations held against Cycles' own masks

`doctor` looks at the machine.
"""
