"""Render planned rows with Cycles (paper, section 2.1.4). The modules, in order.

    supervisor -> outline, session, jobs -> pool -> process       in the caller: remaining images, and their workers
        blender/worker -> renderer -> scene, light, cycles, film   in separate processes
    cluster_pool -> workers -> node -> process               on a Dask cluster, in place of a pool: see docs/cluster.md
    annotations, pictures                                    records and pictures for the dataset
    masks                                                    annotations compared with Cycles' own masks

`doctor` checks the machine.

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
