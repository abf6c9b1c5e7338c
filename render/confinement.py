"""Confinement of rendering processes to their jobs' files and a folder for output."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hulldown.reading.confinement.landlock import confined

CARDS = ("nvidia*", "dri", "kfd", "shm")  # of /dev
DRIVER_CACHES = (".nv", ".cache/cycles", ".cache/nvidia", ".cache/neo_compiler_cache", ".cache/mesa_shader_cache")


@dataclass(frozen=True, slots=True)
class Confinement:
    """Paths that a worker may use, if the kernel has Landlock; see `reading.confinement.landlock`.

    Parameters
    ----------
    write
        Folder for output, which must exist at the start.
    read
        Files and folders of its jobs.
    """

    write: Path
    read: tuple[Path, ...]

    def of(self, command: Sequence[str], *, gpu: bool) -> list[str]:
        """Return a command that runs `command` confined; `gpu`: with graphics cards, and their kernel caches."""
        program = shutil.which(command[0]) or command[0]
        cards = [str(card) for pattern in CARDS for card in sorted(Path("/dev").glob(pattern))] if gpu else []
        caches = [Path.home() / cache for cache in DRIVER_CACHES] if gpu else []
        return confined([program, *command[1:]], read=self.read, write=[self.write, *caches], devices=cards)
