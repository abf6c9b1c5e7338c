"""The scheduler of a cluster: its address and certificates, and a cluster on this machine, to try docs/cluster.md."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

from cyclopts import Parameter

from hulldown.base.arguments import Count, make_option_check
from hulldown.base.errors import HulldownError
from hulldown.base.terminal import print_message

LOCAL_HOST = "127.0.0.1"  # anyone who reaches a scheduler's port can run programs here
RENDER_RESOURCE = "render"  # workers that render declare it: `dask worker --resources "render=1"`
SHARE_VARIABLE = "HULLDOWN_SHARE"  # number of workers that share this machine's cores and memory
MAX_WORKER_SILENCE_S = 60  # a worker that is silent for longer is lost


@Parameter(name="*")
@dataclass(frozen=True, slots=True)
class Scheduler:
    """A Dask scheduler, see docs/cluster.md.

    Parameters
    ----------
    address
        Use the workers of the Dask cluster with this scheduler, which see all these folders: tcp://HOST:8786, or the
        .json file that `dask scheduler --scheduler-file` writes.
    tls_ca_file
        PEM file for --scheduler tls://HOST:8786; by default as Dask is configured.
    tls_client_cert
        The same.
    tls_client_key
        The same.
    """

    address: Annotated[
        str,
        make_option_check("tcp://HOST:PORT or a .json file", lambda text: "://" in text or text.endswith(".json")),
        Parameter(name="--scheduler"),
    ]
    tls_ca_file: str | None = None
    tls_client_cert: Annotated[str | None, Parameter(name="--tls-cert")] = None
    tls_client_key: Annotated[str | None, Parameter(name="--tls-key")] = None

    @property
    def tls_arguments(self) -> dict[str, str]:
        """Arguments of `distributed.Security`; empty: by Dask's configuration."""
        names = ("tls_ca_file", "tls_client_cert", "tls_client_key")
        return {name: path for name in names if (path := getattr(self, name)) is not None}


@contextmanager
def explain_missing_dask() -> Iterator[None]:
    """Turn a missing Dask into a one-line error."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in ("dask", "distributed"):
            raise
        raise HulldownError("needs Dask, which is not installed", remedy="pip install 'hulldown[cluster]'") from None


def run_local_cluster(
    *, workers: Count = 2, port: Annotated[int, make_option_check("a port from 0 to 65535", range(65536).__contains__)] = 8786
) -> None:
    """Start a Dask cluster on this machine.

    Starts a scheduler and workers for `hulldown render --scheduler`, until Ctrl-C or SIGTERM; writes nothing.

    Parameters
    ----------
    workers
        Processes, which share the machine's cores and memory.
    port
        The scheduler's, on 127.0.0.1; 0 for any.
    """
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that the workers end too
    with start_local_cluster(workers, port=port) as address:
        print_message(f"{workers} workers; render with: hulldown render PLAN -o DATASET --scheduler {address}")
        print_message("Ctrl-C ends them")
        threading.Event().wait()


@contextmanager
def start_local_cluster(workers: int, *, port: int) -> Iterator[str]:
    """Run a scheduler on `port` (0: any) and `workers` that restart if they die; yields the scheduler's address."""
    with explain_missing_dask():
        import dask
        from distributed import LocalCluster

    settings = {
        "distributed.scheduler.worker-ttl": f"{MAX_WORKER_SILENCE_S} s",
        "distributed.logging.distributed": "warning",
        "distributed.nanny.environ": {SHARE_VARIABLE: str(workers)},
    }
    with dask.config.set(settings):
        try:
            cluster = LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                resources={RENDER_RESOURCE: 1},
                memory_limit=0,  # Dask sees only its own process; `render.process` watches Blender
                host=LOCAL_HOST,
                scheduler_port=port,
                dashboard_address=f"{LOCAL_HOST}:0",
                worker_dashboard_address=None,
            )
        except (OSError, RuntimeError) as error:
            remedy = "name another with --port, or 0 for any"
            raise HulldownError(f"port {port} cannot be used ({error})", remedy=remedy) from None
        with cluster:
            yield str(cluster.scheduler_address)
