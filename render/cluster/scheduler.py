"""Where the scheduler of a cluster is, and how it is to be spoken to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hulldown.geometry.errors import HulldownError


@dataclass(frozen=True, slots=True)
class Scheduler:
    """A Dask scheduler, see docs/cluster.md.

    Parameters
    ----------
    address
        `tcp://HOST:PORT` or `tls://HOST:PORT`, or the .json file that `dask scheduler --scheduler-file` has written.
    tls_ca, tls_cert, tls_key
        Certificates for `tls://`; None for what Dask's own configuration says.
    """

    address: str
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None


@contextmanager
def needing_dask() -> Iterator[None]:
    """Say in one line that Dask is not installed.

    Raises
    ------
    HulldownError
        That.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in ("dask", "distributed"):
            raise
        raise HulldownError("needs Dask, which is not installed", remedy="pip install 'hulldown[cluster]'") from None
