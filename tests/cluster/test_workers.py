"""Distribution, refusal, retries, and cancellation of tasks on Dask workers, without Blender."""

import asyncio
import socket
import time
from functools import partial

import pytest

from hulldown.base.child import Stopped
from hulldown.base.errors import HulldownError
from hulldown.cluster.scheduler import Scheduler
from hulldown.cluster.workers import MAX_TASK_LOSSES, Cluster
from hulldown.tests.builders import cluster_tasks
from hulldown.tests.builders.certificates import certificates, needs_openssl
from hulldown.tests.builders.clusters import cluster


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    with cluster(tmp_path_factory.mktemp("nodes") / "nodes", 2) as made:
        made.wait()
        yield made


@pytest.fixture
def workers(nodes):
    with connected(nodes) as made:
        yield made


def connected(nodes, **tls):
    return Cluster(Scheduler(nodes.address, **tls), "render", lambda: "", say=lambda line: None)


def calling(function):
    """From a job to a call of the function with it."""
    return partial(partial, function)


def until(holds):
    while not holds():
        time.sleep(0.05)


@pytest.mark.parametrize("leave", ["stops", "is killed"])
def test_a_task_notices_that_its_client_is_gone(workers, tmp_path, leave):
    """A training then ends with its study, even if that was killed."""

    left = []

    def stopping():
        if (tmp_path / "begun").exists() and not left:
            assert not (tmp_path / "ended").exists()
            left.append(leave)
            if leave == "is killed":
                workers.client.close()
        return left == ["stops"]

    with pytest.raises((Stopped, HulldownError)):
        list(workers.run([tmp_path], calling(cluster_tasks.until_unwanted), lost=None, stopping=stopping))
    until((tmp_path / "ended").exists)


def test_a_refused_worker_gets_no_tasks_and_the_run_ends_when_all_are_refused(workers, nodes):
    one, other = sorted(workers.client.scheduler_info()["workers"])
    call = calling(cluster_tasks.address_unless)
    assert [results for _, results in workers.run([one] * 8, call, lost=None)] == [[other]] * 8
    assert workers.working == 1
    with pytest.raises(HulldownError, match=f"{other}: is refused, as all workers are: it is slow"):
        list(workers.run([other], call, lost=None))


def test_a_worker_without_the_clients_code_is_refused_before_it_reads_the_task(nodes):
    lines = []
    with (
        Cluster(Scheduler(nodes.address), "render", lambda: "has another version", say=lines.append) as workers,
        pytest.raises(HulldownError, match="all workers are: it has another version"),
    ):
        list(workers.run([""], calling(cluster_tasks.address_unless), lost=None))
    assert sum("is not used: it has another version" in line for line in lines) == 2


def test_the_results_of_all_workers_that_fail_are_kept(workers):
    ((_, results),) = workers.run(["it fails"], calling(cluster_tasks.fails), lost=None)
    addresses = sorted(workers.client.scheduler_info()["workers"])
    assert sorted(results) == [f"it fails on {address}" for address in addresses]


def test_a_worker_that_fails_where_another_succeeds_gets_no_more_tasks(workers):
    one, other = sorted(workers.client.scheduler_info()["workers"])
    found = workers.run([one] * 8, calling(cluster_tasks.fails_on), lost=None)
    assert [results[-1] for _, results in found] == [other] * 8
    assert workers.working == 1


@pytest.mark.thorough
def test_a_task_that_kills_its_workers_is_given_up_after_the_others(tmp_path):
    with cluster(tmp_path / "nodes", 1) as nodes, connected(nodes) as workers:

        def replace():
            if nodes.workers[-1].poll() is not None:
                nodes.add()
            return False

        found = workers.run([True, False, False], calling(cluster_tasks.kills_its_worker), lost="lost", stopping=replace)
        assert list(found) == [(False, ["done"]), (False, ["done"]), (True, ["lost"])]
        assert len(nodes.workers) - 1 in (MAX_TASK_LOSSES, MAX_TASK_LOSSES + 1)


def test_a_task_whose_workers_are_all_gone_is_done_by_the_next(tmp_path):
    with cluster(tmp_path / "nodes", 1) as nodes, connected(nodes) as workers:
        killed = []

        def kill():
            if not killed and (tmp_path / "called").exists():
                killed.append(nodes.workers[0].kill())
                nodes.add()
            return False

        ((job, results),) = workers.run([tmp_path], calling(cluster_tasks.slow_at_first), lost=None, stopping=kill)
        assert (job, results, killed) == (tmp_path, ["second"], [None])


@needs_openssl
def test_tls_works_and_requires_a_certificate(tmp_path):
    files, options = certificates(tmp_path)
    with cluster(tmp_path / "nodes", 1, tls=options) as nodes:
        assert nodes.address.startswith("tls://")
        with pytest.raises(HulldownError, match="no Dask scheduler answers there"):
            connected(nodes)
        with connected(nodes, **files) as workers:
            found = workers.run([""], calling(cluster_tasks.address_unless), lost=None)
            assert [results[0].startswith("tls://") for _, results in found] == [True]


def test_a_server_that_is_no_scheduler_is_a_one_line_error(monkeypatch):
    monkeypatch.setattr("hulldown.cluster.workers.MAX_SCHEDULER_ABSENCE_S", 1.0)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"

        async def connect_in_notebook():
            Cluster(Scheduler(address), "render", lambda: "", say=lambda line: None)

        with pytest.raises(HulldownError, match=rf"^{address}: no Dask scheduler answers there"):
            asyncio.run(connect_in_notebook())


def test_a_lost_scheduler_is_a_one_line_error(tmp_path):
    with (
        cluster(tmp_path / "nodes", 1) as nodes,
        connected(nodes) as workers,
        pytest.raises(HulldownError, match=r"^tcp://.*: the scheduler is out of reach; start one, .* which continues$"),
    ):
        list(workers.run([""], calling(cluster_tasks.address_unless), lost=None, stopping=nodes.scheduler.kill))
