"""Render planned rows with Cycles (paper, section 2.1.4). The modules, in order.

    supervisor -> outline, session, jobs -> pool -> process   in the caller: remaining images, and their workers
        blender/worker -> renderer -> scene, cycles           in separate processes
    cluster_pool -> cluster.workers -> process                on a Dask cluster, in place of a pool: see docs/cluster.md
    cycles_masks                                              annotations compared with Cycles' own masks

`doctor` checks the machine.
"""
