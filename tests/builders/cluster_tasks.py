"""Tasks for the workers of a cluster in tests."""

import os
import signal
import time
from pathlib import Path

from distributed import get_worker

from hulldown.cluster.workers import TaskResult, make_task_wanted_check


def address_unless(refused):
    """Answer with the worker's address; the worker at `refused` refuses."""
    address = str(get_worker().address)
    return "is slow" if address == refused else TaskResult(address)


def fails(reason):
    """Fail on each worker."""
    return TaskResult(f"{reason} on {get_worker().address}", has_failed=True)


def fails_on(bad):
    """Answer with the worker's address; the worker at `bad` fails."""
    address = str(get_worker().address)
    return TaskResult(address, has_failed=address == bad)


def kills_its_worker(deadly):
    """End the worker at once if the job is deadly."""
    if deadly:
        os.kill(os.getpid(), signal.SIGKILL)
    return TaskResult("done")


def until_unwanted(folder):
    """Write a file `begun`, and a file `ended` once the client has stopped waiting."""
    is_wanted = make_task_wanted_check()
    (Path(folder) / "begun").touch()
    while is_wanted():
        time.sleep(0.05)
    (Path(folder) / "ended").touch()
    return TaskResult(None)


def slow_at_first(folder):
    """The first call takes ten minutes."""
    try:
        (Path(folder) / "called").touch(exist_ok=False)
    except FileExistsError:
        return TaskResult("second")
    time.sleep(600)
    return TaskResult("first")
