"""What a worker replies: a line of JSON for each job. Needs no library, so that a Blender without NumPy can reply."""

from __future__ import annotations

from dataclasses import dataclass, field

REPLY_PREFIX = "@hulldown "  # marks a reply's line; an installed Blender prints before we can stop it


@dataclass(frozen=True)
class Reply:
    """A reply to a job, or the first one, which comes without a job when the worker is ready or unusable."""

    ready: str = ""  # versions of Blender, Python, and NumPy
    # device, devices: name of the device that a start has chosen, and the number of graphics cards, 1 if there are none
    device: str = ""
    devices: int = 1
    # CPU seconds of each part of a picture: "load", "sync", "sample", and "save"
    seconds: dict[str, float] = field(default_factory=dict)
    failed: str = ""
    unusable: str = ""  # unusable, remedy: why every image would fail, which ends the run, and what to do about it
    remedy: str = ""
