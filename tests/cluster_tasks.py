"""What workers of a cluster are asked to do in tests."""

import time
from pathlib import Path

from hulldown.render.cluster.workers import Answer, wanted


def no_refusal():
    return ""


def until_unwanted(folder):
    """Leave a file `begun`, and a file `ended` once nobody waits for this any more."""
    is_wanted = wanted()
    (Path(folder) / "begun").touch()
    while is_wanted():
        time.sleep(0.05)
    (Path(folder) / "ended").touch()
    return Answer()


def with_contents(digest, *contents):
    """Lack a content that wasn't sent."""
    return Answer(b"".join(contents)) if contents else Answer(lacking=(digest,))


def slow_at_first(folder):
    """The first call takes ten minutes."""
    try:
        (Path(folder) / "called").touch(exist_ok=False)
    except FileExistsError:
        return Answer("second")
    time.sleep(600)
    return Answer("first")
