"""Tasks on the workers of a Dask cluster, without Blender: who gets them, and what becomes of them."""

import operator
import time
from concurrent.futures import CancelledError

import pytest

from hulldown.geometry.errors import HulldownError
from hulldown.render.cluster.scheduler import Scheduler
from hulldown.render.cluster.workers import Cluster
from hulldown.tests.certificates import certificates, needs_openssl
from hulldown.tests.cluster_tasks import no_refusal, until_unwanted
from hulldown.tests.clusters import cluster

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    with cluster(tmp_path_factory.mktemp("nodes") / "nodes", 2) as made:
        made.wait()
        yield made


@pytest.fixture
def workers(nodes):
    said = []
    with Cluster(Scheduler(nodes.address), "render", no_refusal, (), say=said.append) as made:
        until(lambda: made.look() and len(made.fit) == 2)
        yield made


def until(holds):
    while not holds():
        time.sleep(0.05)


@pytest.mark.parametrize(
    "leave", [lambda workers, task: workers.cancel([task]), lambda workers, task: workers.client.close()]
)
def test_a_task_learns_that_nobody_waits_for_it(workers, tmp_path, leave):
    """So that a training ends with the study that wanted it, even if that was killed."""
    task = workers.submit(until_unwanted, str(tmp_path))
    until((tmp_path / "begun").exists)
    time.sleep(0.5)
    assert not (tmp_path / "ended").exists()
    leave(workers, task)
    until((tmp_path / "ended").exists)


def test_contents_are_sent_once_and_shared(workers):
    one, other = workers.fit
    content = workers.content("0" * 64, lambda digest: digest.encode(), one)
    assert workers.content("0" * 64, pytest.fail, other) is content
    assert workers.submit(operator.add, content, b"!", avoiding=[one]).result(timeout=60) == b"0" * 64 + b"!"


def test_a_refused_worker_gets_no_tasks_and_when_all_are_the_run_ends(workers):
    one, other = sorted(workers.fit)
    workers.refuse(one, "is slow")
    assert workers.fit == {other}
    workers.refuse(other, "is slow too")
    with pytest.raises(HulldownError, match="is slow too"):
        workers.look()


def test_a_task_whose_workers_are_all_gone_can_be_submitted_again(tmp_path):
    with (
        cluster(tmp_path / "nodes", 1) as nodes,
        Cluster(Scheduler(nodes.address), "render", no_refusal, (), say=lambda line: None) as workers,
    ):
        until(lambda: workers.look() and workers.fit)
        task = workers.submit(time.sleep, 600)
        until(lambda: task.client.processing()[next(iter(workers.fit))])
        nodes.workers[0].kill()
        nodes.add()
        until(lambda: workers.look() and task.done())
        with pytest.raises(CancelledError):
            task.result()
        until(lambda: workers.look() and workers.fit)
        assert workers.submit(operator.add, 1, 2).result(timeout=60) == 3


@needs_openssl
def test_nobody_comes_in_without_a_certificate(tmp_path):
    files, options = certificates(tmp_path)
    with cluster(tmp_path / "nodes", 0, tls=options) as nodes:
        assert nodes.address.startswith("tls://")
        with Cluster(Scheduler(nodes.address, **files), "render", no_refusal, (), say=lambda line: None) as workers:
            assert workers.look()
        with pytest.raises(HulldownError, match="no Dask scheduler answers there"):
            Cluster(Scheduler(nodes.address), "render", no_refusal, (), say=lambda line: None)
