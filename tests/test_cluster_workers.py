"""Tasks on the workers of a Dask cluster, without Blender: who gets them, and what becomes of them."""

import contextlib
import time

import pytest

from hulldown.geometry.errors import AssetError, HulldownError
from hulldown.render.cluster.scheduler import Scheduler
from hulldown.render.cluster.workers import Cluster
from hulldown.tests.certificates import certificates, needs_openssl
from hulldown.tests.cluster_tasks import no_refusal, slow_at_first, until_unwanted, with_contents
from hulldown.tests.clusters import cluster


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    with cluster(tmp_path_factory.mktemp("nodes") / "nodes", 2) as made:
        made.wait()
        yield made


@pytest.fixture
def workers(nodes):
    lines = []
    with Cluster(Scheduler(nodes.address), "render", no_refusal, (), say=lines.append) as made:
        until(lambda: made.look() and len(made.fit) == 2)
        yield made


def never():
    return False


def until(holds):
    while not holds():
        time.sleep(0.05)


@pytest.mark.parametrize("leave", ["stops", "is killed"])
def test_a_task_learns_that_nobody_waits_for_it(workers, tmp_path, leave):
    """So that a training ends with the study that wanted it, even if that was killed."""

    left = []

    def stopping():
        if (tmp_path / "begun").exists() and not left:
            assert not (tmp_path / "ended").exists()
            left.append(leave)
            if leave == "is killed":
                workers.client.close()
        return left == ["stops"]

    with contextlib.suppress(HulldownError):
        assert not list(workers.results([str(tmp_path)], until_unwanted, str, stopping=stopping))
    until((tmp_path / "ended").exists)


def test_contents_are_sent_once_and_shared(workers):
    read = []

    def content(digest):
        read.append(digest)
        return digest.encode()

    found = workers.results(range(3), with_contents, lambda job: "0" * 64, stopping=never, content=content)
    assert [answer.value for _, answer in found] == [b"0" * 64] * 3
    assert 1 <= len(read) <= 2


def test_a_content_that_cannot_be_read_ends_the_run(workers):
    def content(digest):
        raise AssetError("was changed during the render")

    with pytest.raises(AssetError, match="changed"):
        list(workers.results([0], with_contents, lambda job: "1" * 64, stopping=never, content=content))


def test_a_refused_worker_gets_no_tasks_and_when_all_are_the_run_ends(workers):
    one, other = sorted(workers.fit)
    workers.refuse(one, "is slow")
    assert workers.fit == {other}
    workers.refuse(other, "is slow too")
    with pytest.raises(HulldownError, match="is slow too"):
        workers.look()


def test_a_task_whose_workers_are_all_gone_is_done_by_the_next(tmp_path):
    with (
        cluster(tmp_path / "nodes", 1) as nodes,
        Cluster(Scheduler(nodes.address), "render", no_refusal, (), say=lambda line: None) as workers,
    ):
        until(lambda: workers.look() and workers.fit)
        killed = []

        def kill():
            if not killed and any(workers.client.processing().values()):
                killed.append(nodes.workers[0].kill())
                nodes.add()
            return False

        ((job, answer),) = workers.results([tmp_path], slow_at_first, str, stopping=kill)
        assert (job, answer.value, killed) == (tmp_path, "second", [None])


@needs_openssl
def test_tasks_go_over_tls_and_nobody_comes_in_without_a_certificate(tmp_path):
    files, options = certificates(tmp_path)
    with cluster(tmp_path / "nodes", 1, tls=options) as nodes:
        assert nodes.address.startswith("tls://")
        with pytest.raises(HulldownError, match="no Dask scheduler answers there"):
            Cluster(Scheduler(nodes.address), "render", no_refusal, (), say=lambda line: None)
        with Cluster(Scheduler(nodes.address, **files), "render", no_refusal, (), say=lambda line: None) as workers:
            found = workers.results(["data"], with_contents, str, stopping=never, content=str.encode)
            assert [answer.value for _, answer in found] == [b"data"]


def test_a_lost_scheduler_ends_the_run_in_one_line(tmp_path):
    with (
        cluster(tmp_path / "nodes", 1) as nodes,
        Cluster(Scheduler(nodes.address), "render", no_refusal, (), say=lambda line: None) as workers,
        pytest.raises(HulldownError, match=r"^tcp://.*: the scheduler is out of reach; start one, .* which continues$"),
    ):
        list(workers.results([""], with_contents, str, stopping=nodes.scheduler.kill))
