"""What the processes that render may reach: their jobs' files, and a folder to write to."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from planning.plan_file import Plan
from planning.row import Source
from reading.landlock import asset_folders, confined
from render.jobs import RenderAssets

CARDS = ("nvidia*", "dri", "kfd", "shm")  # of /dev
DRIVER_CACHES = (".nv", ".cache/cycles", ".cache/nvidia", ".cache/neo_compiler_cache", ".cache/mesa_shader_cache")


@dataclass(frozen=True, slots=True)
class Confinement:
    """What a worker may reach, where the kernel has Landlock; see `reading.landlock`.

    Parameters
    ----------
    write
        Folder that it writes to, which must exist when it starts.
    read
        Files and folders of its jobs.
    gpu
        Whether it may use graphics cards, and the folders in which their drivers keep what they have compiled.
    """

    write: Path
    read: tuple[Path, ...]
    gpu: bool = True

    def of(self, command: Sequence[str]) -> list[str]:
        """The command that runs `command` confined."""
        program = shutil.which(command[0]) or command[0]
        cards = [str(card) for pattern in CARDS for card in sorted(Path("/dev").glob(pattern))] if self.gpu else []
        caches = [Path.home() / cache for cache in DRIVER_CACHES] if self.gpu else []
        return confined([program, *command[1:]], read=self.read, write=[self.write, *caches], devices=cards)

    @property
    def environment(self) -> dict[str, str]:
        """Where it puts what it writes for itself."""
        return {"TMPDIR": str(self.write)}


def confinement_of(plan: Plan, assets: RenderAssets, write: Path, *, gpu: bool) -> Confinement:
    """What workers may reach that render a plan into the folder `write`: besides that, its assets and their folders."""
    files = [file.tidy for file in assets.vehicles.values()] + [file.path for file in assets.sceneries.values()]
    files += list(assets.hdris.values())
    root = plan.path.absolute().parent / plan.header.root
    header = plan.header
    sources: tuple[Mapping[str, Source], ...] = (header.vehicles, header.distractors, header.sceneries)
    listed = [root / file.path for of in sources for file in of.values()]
    folders = {folder: None for file in [*files, *listed] for folder in asset_folders(Path(os.path.normpath(file)))}
    return Confinement(write, tuple(folders), gpu=gpu)
