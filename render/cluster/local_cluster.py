"""A Dask cluster on this machine, to try what docs/cluster.md says of larger ones."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import dask
from distributed import LocalCluster

from hulldown.geometry.child import Child
from hulldown.geometry.errors import HulldownError
from hulldown.render.cluster.cluster_pool import RESOURCE
from hulldown.render.cluster.node import SHARE_VARIABLE

RESOURCES = f"{RESOURCE}=1,train=1"
HOST = "127.0.0.1"  # whoever reaches the port of a scheduler can run programs here
LOST_S = 60  # a worker that says nothing for so long is lost
END_S = 10  # what workers get to end by themselves


@contextmanager
def local_cluster(workers: int, *, port: int = 0) -> Iterator[str]:
    """A scheduler in this process and workers beside it that render, for as long as the block lasts; its address.

    The workers end with the scheduler, however it ends; one that dies is started again.

    Parameters
    ----------
    workers
        How many; they share the machine's cores and memory.
    port
        The scheduler's; 0 for any.

    Raises
    ------
    HulldownError
        If the port is taken.
    """
    with dask.config.set({"distributed.scheduler.worker-ttl": f"{LOST_S} s"}):
        try:
            scheduler = LocalCluster(n_workers=0, host=HOST, scheduler_port=port, dashboard_address=f"{HOST}:0")
        except (OSError, RuntimeError) as error:
            remedy = "name another with --port, or 0 for any"
            raise HulldownError(f"port {port} cannot be used ({error})", remedy=remedy) from None
    with scheduler:
        address = str(scheduler.scheduler_address)
        env = {**os.environ, SHARE_VARIABLE: str(workers), "DASK_LOGGING__DISTRIBUTED": "warning"}
        with Child(worker_command(address, workers), env=env, hear=_pass_on) as child:
            try:
                yield address
            finally:
                child.terminate()
                child.wait(END_S)


def _pass_on(line: bytes) -> None:
    sys.stderr.write(line.decode("utf-8", "replace"))


def worker_command(address: str, workers: int) -> list[str]:
    """How workers of this machine are started, as docs/cluster.md says."""
    # Of memory Dask would see its own process, and not Blender, which is watched by `render.pool`.
    options = ["--nthreads", "1", "--resources", RESOURCES, "--memory-limit", "0", "--host", HOST, "--no-dashboard"]
    return [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nworkers", str(workers), *options]
