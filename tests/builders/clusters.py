"""Dask clusters of separate processes on this machine, which tests kill and stop, and the files that a run leaves."""

import hashlib
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path

import psutil
from distributed import Client

from hulldown.base.outputs import LOCK_NAME
from hulldown.dataset.store.document import JOURNAL_NAME
from hulldown.dataset.store.journal import MERGED_LINE
from hulldown.render.session import LOGS_NAME

ROOT = Path(__file__).resolve().parents[2]
PYTHONPATH = str(ROOT / ".dev")  # the folder that contains the package
LOST_S = "600s"  # silence after which a worker counts as lost; on a busy machine it may be long
# Landlock hides a folder from a worker, as if it were on another machine; the network stays open.
HIDDEN = """
import os, sys
sys.path.insert(0, sys.argv[1])
from hulldown.reading.confinement import landlock
landlock.NETWORK_ABI = landlock.SCOPE_ABI = 10**6
hidden, *command = sys.argv[2:]
around = [os.path.join("/", name) for name in os.listdir("/")]
paths = []
while around:
    path = around.pop()
    if os.path.islink(path) and f"{hidden}{os.sep}".startswith(os.path.join(os.path.realpath(path), "")):
        continue
    if hidden == path or not hidden.startswith(path + os.sep):
        paths += [path] * (hidden != path)
    else:
        around += [os.path.join(path, name) for name in os.listdir(path)]
landlock.confine_this_process({"execute": paths, "read": [], "write": paths})
os.execv(command[0], command)
"""


class Cluster:
    """A scheduler and its workers."""

    def __init__(self, folder: Path, tls: Sequence[str] = (), lost: str = LOST_S) -> None:
        folder.mkdir(parents=True)
        self.folder, self.file = folder, folder / "scheduler.json"
        self.workers: list[subprocess.Popen] = []
        self._tls = tls
        self.log = (folder / "log").open("ab")
        environment = {"DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": lost}
        options = ["--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(self.file), "--no-dashboard", *tls]
        self.scheduler = self._start([sys.executable, "-P", "-m", "distributed.cli.dask_scheduler", *options], environment)
        while not self.address:
            assert self.scheduler.poll() is None, f"see {folder / 'log'}"
            time.sleep(0.05)

    @property
    def address(self) -> str:
        try:
            return json.loads(self.file.read_text())["address"]
        except (OSError, ValueError):  # not written yet, or only in part
            return ""

    def add(self, python=(sys.executable, "-P"), before=(), environment=None, largest_file=None, resources="render=1"):
        """Start a worker, perhaps with another Python, by another command, or with a limit on the size of files."""
        number = len(self.workers)
        scratch = self.folder / f"worker-{number}"
        options = ["--nthreads", "1", "--resources", resources, "--memory-limit", "0", "--no-nanny", "--no-dashboard"]
        options += ["--host", "127.0.0.1", "--local-directory", str(scratch), "--name", f"worker-{number}"]
        command = [*before, *python, "-m", "distributed.cli.dask_worker", self.address, *options, *self._tls]

        def bound():
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))

        worker = self._start(command, environment or {}, bound if largest_file else None)
        self.workers.append(worker)
        return worker

    def wait(self) -> None:
        """Wait until all running workers are connected."""
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(sum(worker.poll() is None for worker in self.workers), timeout=120)

    def _start(self, command, environment, before=None):
        return subprocess.Popen(
            command,
            env={**os.environ, "PYTHONPATH": PYTHONPATH, **environment},
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=self.log,
            preexec_fn=before,
        )

    def close(self) -> None:
        for process in [*self.workers, self.scheduler]:
            process.kill()
            process.wait()
        self.log.close()


def rendering(plan, dataset, scheduler, *more, **options):
    """Start `hulldown render` on a cluster in a separate process."""
    command = [sys.executable, "-P", "-m", "hulldown.cli", "render", str(plan), "-o", str(dataset)]
    command += ["--device", "cpu", "--scheduler", str(scheduler), *map(str, more)]
    environment = {**os.environ, "PYTHONPATH": PYTHONPATH}
    return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True, **options)


def wait_for(run, dataset, pictures):
    """Wait until a run has added these pictures, and is still running."""
    while len(list((dataset / "images").glob("*"))) < pictures:
        assert run.poll() is None
        time.sleep(0.01)


def digests(dataset):
    """Hashes of a dataset's files except logs and lock; of the journal's lines in any order, as images finish so."""
    found = {}
    for path in dataset.rglob("*"):
        name = path.relative_to(dataset)
        if path.is_file() and name.parts[0] not in (LOGS_NAME, LOCK_NAME):
            lines = path.read_bytes().splitlines(keepends=True)
            lines = sorted(line for line in lines if line != MERGED_LINE) if name == Path(JOURNAL_NAME) else lines
            found[str(name)] = hashlib.sha256(b"".join(lines)).hexdigest()
    return found


@contextmanager
def cluster(folder, workers=0, *, tls=(), lost=LOST_S):
    """A cluster; `tls` are options of `dask scheduler` and `dask worker`, `lost` is the silence of a lost worker."""
    made = Cluster(folder, tls, lost)
    try:
        for _ in range(workers):
            made.add()
        yield made
    finally:
        made.close()


def blenders(worker):
    """The rendering processes of a worker."""
    try:
        return psutil.Process(worker.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []
