"""The address of a cluster's scheduler, and its certificates."""

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
        `tcp://HOST:PORT` or `tls://HOST:PORT`, or the .json file of `dask scheduler --scheduler-file`.
    tls_ca, tls_cert, tls_key
        Certificates for `tls://`; None: by Dask's configuration.
    """

    address: str
    tls_ca: Path | None = None
    tls_cert: Path | None = None
    tls_key: Path | None = None


@contextmanager
def needing_dask() -> Iterator[None]:
    """Turn a missing Dask into a one-line error.

    Raises
    ------
    HulldownError
        If Dask isn't installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in ("dask", "distributed"):
            raise
        raise HulldownError("needs Dask, which is not installed", remedy="pip install 'hulldown[cluster]'") from None
