"""The scheduler of a cluster: its address and certificates, and a cluster on this machine, to try docs/cluster.md."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from hulldown.base.errors import HulldownError

HOST = "127.0.0.1"  # anyone who reaches a scheduler's port can run programs here
RESOURCE = "render"  # of workers that render, declared by `dask worker --resources "render=1"`
SHARE_VARIABLE = "HULLDOWN_SHARE"  # number of workers that share this machine's cores and memory
LOST_S = 60  # a worker silent for this long is lost


@dataclass(frozen=True, slots=True)
class Scheduler:
    """A Dask scheduler, see docs/cluster.md."""

    address: str  # `tcp://HOST:PORT` or `tls://HOST:PORT`, or the .json file of `dask scheduler --scheduler-file`
    # files for `tls://`, by their names in `distributed.Security`; empty: by Dask's configuration
    tls: Mapping[str, str] = field(default_factory=dict)


@contextmanager
def needing_dask() -> Iterator[None]:
    """Turn a missing Dask into a one-line error."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in ("dask", "distributed"):
            raise
        raise HulldownError("needs Dask, which is not installed", remedy="pip install 'hulldown[cluster]'") from None


@contextmanager
def local_cluster(workers: int, *, port: int) -> Iterator[str]:
    """Run a scheduler in this process, and workers for rendering and training, during the block; yields its address.

    The workers end with the scheduler in any case; one that dies is restarted.

    `workers`: number of workers, which share the machine's cores and memory.
    `port`: the scheduler's; 0 for any.
    """
    with needing_dask():
        import dask
        from distributed import LocalCluster

    settings = {
        "distributed.scheduler.worker-ttl": f"{LOST_S} s",
        "distributed.logging.distributed": "warning",
        "distributed.nanny.environ": {SHARE_VARIABLE: str(workers)},
    }
    with dask.config.set(settings):
        try:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                resources={RESOURCE: 1, "train": 1},
                memory_limit=0,  # Dask sees only its own process; `rendering.process` watches Blender
                host=HOST,
                scheduler_port=port,
                dashboard_address=f"{HOST}:0",
                worker_dashboard_address=None,
            )
        except (OSError, RuntimeError) as error:
            remedy = "name another with --port, or 0 for any"
            raise HulldownError(f"port {port} cannot be used ({error})", remedy=remedy) from None
        with cluster:
            yield str(cluster.scheduler_address)
