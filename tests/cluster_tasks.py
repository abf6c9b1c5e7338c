"""What workers of a cluster are asked to do in tests."""

import time
from pathlib import Path

from hulldown.render.cluster.workers import wanted


def until_unwanted(folder):
    """Leave a file `begun`, and a file `ended` once nobody waits for this any more."""
    is_wanted = wanted()
    (Path(folder) / "begun").touch()
    while is_wanted():
        time.sleep(0.05)
    (Path(folder) / "ended").touch()


def no_refusal():
    return ""
