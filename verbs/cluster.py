"""Arguments of `study run` for a cluster."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hulldown.base.terminal import say
from hulldown.cluster.scheduler import Scheduler, needing_dask

if TYPE_CHECKING:
    from hulldown.cluster.workers import Answer
    from hulldown.training.study.runs import Launch, Progress, RunOptions


def add_scheduler(sub: argparse.ArgumentParser, help_text: str) -> None:
    """Add the arguments for a cluster to a verb."""
    sub.add_argument("--scheduler", metavar="ADDRESS", help=help_text)
    sub.add_argument("--tls-ca-file", type=Path, metavar="PEM", help="for --scheduler tls://HOST:8786")
    sub.add_argument("--tls-cert", dest="tls_client_cert", type=Path, metavar="PEM", help="the same")
    sub.add_argument("--tls-key", dest="tls_client_key", type=Path, metavar="PEM", help="the same")


def scheduler_of(arguments: argparse.Namespace) -> Scheduler | None:
    """Return the scheduler in the arguments; None without one."""
    if arguments.scheduler is None:
        return None
    given = {name: getattr(arguments, name) for name in ("tls_ca_file", "tls_client_cert", "tls_client_key")}
    return Scheduler(arguments.scheduler, **{name: str(path) for name, path in given.items() if path is not None})


@contextmanager
def training_workers(scheduler: Scheduler, *, say: Callable[[str], None] = say) -> Iterator[Launch]:
    """Provide a function that runs runs of a study on the training workers of a cluster."""
    from hulldown.base.code import difference, versions

    with needing_dask():
        from hulldown.cluster.workers import Cluster
    from hulldown.training.study.runs import LOST, PACKAGES, RESOURCE, manifest_digest

    with Cluster(scheduler, RESOURCE, partial(difference, versions(*PACKAGES)), say=say) as cluster:

        def launch(
            study: Path, names: Sequence[str], options: RunOptions, progress: Progress
        ) -> Generator[tuple[str, str | None]]:
            here = partial(_train_here, study.resolve(), manifest_digest(study), options)
            lost: str | None = LOST
            with closing(cluster.run(names, partial(partial, here), lost=lost)) as ended:
                for name, reasons in ended:
                    yield name, reasons[-1]

        yield launch


def _train_here(study: Path, manifest: str, options: RunOptions, name: str) -> Answer[str | None] | str:
    """Do a run on a worker of the cluster."""
    from hulldown.cluster.workers import Answer, wanted
    from hulldown.training.study.runs import run_here, unseen

    return unseen(study, manifest) or Answer(run_here(study, name, options, wanted()))
