"""The runs of a study on the training workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hulldown.base.code import difference, versions
from hulldown.base.terminal import say
from hulldown.cluster.scheduler import Scheduler, needing_dask
from hulldown.training.study.runs import (
    LOST,
    PACKAGES,
    RESOURCE,
    Launch,
    Progress,
    RunOptions,
    manifest_digest,
    run_here,
    unseen,
)

if TYPE_CHECKING:
    from hulldown.cluster.workers import Answer


@contextmanager
def training_workers(scheduler: Scheduler, *, say: Callable[[str], None] = say) -> Iterator[Launch]:
    """Provide a function that runs runs of a study on the training workers of a cluster."""
    with needing_dask():
        from hulldown.cluster.workers import Cluster

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

    return unseen(study, manifest) or Answer(run_here(study, name, options, wanted()))
