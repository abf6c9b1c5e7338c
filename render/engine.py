"""The choice of a renderer."""

from __future__ import annotations

import shutil
from dataclasses import dataclass

from hulldown.geometry.errors import HulldownError
from hulldown.render.cluster.scheduler import Scheduler
from hulldown.render.process import DEFAULT_LIMITS, Limits


@dataclass(frozen=True, slots=True)
class Engine:
    """The renderer: Blender processes on this machine, or the workers of a Dask cluster.

    Parameters
    ----------
    workers
        Processes of this machine; None for one a GPU, or one if there is none.
    device
        "auto", "cpu", "gpu", "optix", "cuda", "hip", "oneapi" or "metal".
    blender
        An installed Blender instead of the bpy module.
    scheduler
        Scheduler of a Dask cluster; None: processes on this machine.
    require_confinement
        Whether to use only workers of a cluster that can confine Blender.
    limits
        Limits of time, memory, and attempts.

    Raises
    ------
    HulldownError
        If `blender` isn't a program.
    """

    workers: int | None = None
    device: str = "auto"
    blender: str | None = None
    scheduler: Scheduler | None = None
    require_confinement: bool = False
    limits: Limits = DEFAULT_LIMITS

    def __post_init__(self) -> None:
        if self.blender is not None and shutil.which(self.blender) is None:
            raise HulldownError("isn't an executable program", path=self.blender, remedy="name Blender's executable")


DEFAULT_ENGINE = Engine()
