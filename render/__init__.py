"""Planned rows through Cycles (paper, section 2.1.4): what happens, in the order in which it happens.

    supervisor -> remaining, session, jobs -> pool -> process     in the caller: what is left to do, and who does it
        blender/worker -> renderer -> scene, light, cycles, film   in processes of their own
    cluster_pool -> cluster -> node -> pool                  on a Dask cluster, in place of a pool: see docs/cluster.md
    annotations, pictures                                    what is written into the dataset
    masks                                                    the annotations held against Cycles' own masks

`doctor` looks at the machine.

Called, it is `supervisor.render`: importing this package binds it to `hulldown.render`, the public name of that
function.
"""

import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    def __call__(self, *arguments: Any, **options: Any) -> Any:
        from hulldown.render.supervisor import render

        return render(*arguments, **options)

    @property
    def __signature__(self) -> Any:
        from inspect import signature

        from hulldown.render.supervisor import render

        return signature(render)


sys.modules[__name__].__class__ = _Callable
