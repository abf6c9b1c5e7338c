"""Tasks on the workers of a Dask cluster: that they end with who wants them, and go over TLS."""

import time

import dask
import pytest

import render.tasks
from benchmarks.clusters import cluster
from geometry.errors import HulldownError
from render.scheduler import Scheduler
from render.tasks import Tasks
from tests.certificates import certificates, needs_openssl
from tests.cluster_tasks import echo, until_unwanted


def wait_for(path):
    while not path.exists():
        time.sleep(0.05)


def worker_of(tasks):
    while not (workers := tasks.workers()):
        time.sleep(0.1)
    return next(iter(workers))


@pytest.mark.parametrize("leave", [lambda tasks, task: tasks.take_back([task]), lambda tasks, task: tasks.close()])
def test_a_task_learns_that_nobody_waits_for_it(tmp_path, leave):
    """So that a training ends with the study that wanted it, even if that was killed."""
    with cluster(tmp_path / "nodes", 1) as nodes:
        tasks = Tasks(Scheduler(nodes.address), "render")
        task = tasks.submit(worker_of(tasks), until_unwanted, str(tmp_path).encode())
        wait_for(tmp_path / "begun")
        time.sleep(0.5)
        assert not (tmp_path / "ended").exists()
        leave(tasks, task)
        wait_for(tmp_path / "ended")
        tasks.close()


def test_workers_that_are_there_are_never_missed(tmp_path, monkeypatch):
    """Dask's client asks for the cluster's state by itself, in the middle of our own question, and not for workers."""
    monkeypatch.setattr(render.tasks, "LOOK_S", 0.0)
    with (
        cluster(tmp_path / "nodes", 1) as nodes,
        dask.config.set({"distributed.client.scheduler-info-interval": "1ms"}),
    ):
        tasks = Tasks(Scheduler(nodes.address), "render")
        worker = worker_of(tasks)
        assert {tuple(tasks.workers() or ()) for _ in range(500)} == {(worker,)}
        tasks.close()


@needs_openssl
def test_tasks_go_over_tls_and_nobody_comes_in_without_a_certificate(tmp_path):
    files, options = certificates(tmp_path)
    with cluster(tmp_path / "nodes", 1, tls=options) as nodes:
        assert nodes.address.startswith("tls://")
        tasks = Tasks(Scheduler(nodes.address, **files), "render")
        task = tasks.submit(worker_of(tasks), echo, b"hello")
        assert tasks.events.get(timeout=300) == (task, b"hello")
        tasks.close()
        with pytest.raises(HulldownError, match="no Dask scheduler answers there"):
            Tasks(Scheduler(nodes.address), "render")
