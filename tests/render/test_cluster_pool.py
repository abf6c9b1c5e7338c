"""`hulldown render --scheduler` with Blender and Dask workers, while something goes wrong.

The dataset must equal that of a run on this machine, to the byte.
"""

import json
import os
import re
import resource
import shutil
import signal
import site
import sys
from pathlib import Path

import psutil
import pytest
from msgspec.structs import replace

from hulldown.base.errors import HulldownError
from hulldown.cluster.scheduler import Scheduler
from hulldown.dataset.provenance import read_failures
from hulldown.plan.library import load_planned_library
from hulldown.plan.plan_file import read_plan
from hulldown.reading.confinement.landlock import landlock_version
from hulldown.render.pool import Engine
from hulldown.render.process import Limits
from hulldown.render.supervisor import render_remaining_images
from hulldown.tests.builders.blender_plans import IMAGES, plan_in, run_python, run_script
from hulldown.tests.builders.certificates import certificates, needs_openssl
from hulldown.tests.builders.clusters import HIDDEN, PYTHONPATH, ROOT, blenders, cluster, digests, rendering, wait_for
from hulldown.tests.oracles.rendered import assert_shows_plan

pytestmark = pytest.mark.blender
THOROUGH = pytest.mark.thorough


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A plan, and its dataset by a run on this machine, in `whole`."""
    made = tmp_path_factory.mktemp("cluster")
    run_script("render_worlds.py", made)
    plan = read_plan(plan_in(made))
    render_remaining_images(plan.path, made / "whole", engine=Engine(device="cpu"))
    assert_shows_plan(made / "whole", plan, load_planned_library(plan))
    return made


@pytest.fixture(scope="module")
def nodes(folder):
    """A cluster of three workers. A test that kills one adds another; a stopped one counts as lost after 30 s."""
    with cluster(folder / "nodes", 3, lost="30s") as made:
        yield made


class Course:
    """A run on a cluster, with its messages; calls `act` once after `at` pictures."""

    def __init__(self, folder, plan, address, *, at=0, act=None):
        self.lines, self.workers, self._at, self._act = [], set(), at, act
        self.output = folder
        scheduler = Scheduler(address)
        self.report = render_remaining_images(
            plan, folder, progress=self._show, engine=Engine(scheduler=scheduler, device="cpu")
        )

    def _show(self, progress):
        self.workers.add(progress.workers)
        if progress.line:
            self.lines.append(progress.line)
        if self._act is not None and progress.finished >= self._at:
            act, self._act = self._act, None
            act()

    def line(self, *words):
        """The one message with all of these words."""
        (line,) = (line for line in self.lines if all(word in line for word in words))
        return line


def assert_same(one, two, images=IMAGES):
    assert len(list((one / "images").iterdir())) == images
    assert digests(one) == digests(two)


def working(nodes):
    """A worker whose Blender is running."""
    return next(worker for worker in nodes.workers if worker.poll() is None and blenders(worker))


def test_a_cluster_renders_a_plan_as_one_machine_does(folder, nodes, tmp_path):
    course = Course(tmp_path / "d", folder / "plan.jsonl", nodes.address)
    assert course.report.complete
    assert 1 <= max(course.workers) <= 3
    assert_same(folder / "whole", tmp_path / "d")


@pytest.mark.parametrize(
    ("harm", "is_gone"),
    [
        pytest.param(lambda worker: worker.kill(), True, id="it is killed"),
        pytest.param(lambda worker: blenders(worker)[0].kill(), False, id="its Blender is killed", marks=THOROUGH),
        pytest.param(lambda worker: worker.send_signal(signal.SIGSTOP), True, id="it is stopped", marks=THOROUGH),
    ],
)
def test_a_harmed_worker_loses_no_image_and_leaves_no_blender(folder, nodes, tmp_path, harm, is_gone):
    harmed, orphans = [], []

    def act():
        harmed.append(working(nodes))
        orphans.extend(blenders(harmed[0]))
        harm(harmed[0])

    course = Course(tmp_path / "d", folder / "plan.jsonl", nodes.address, at=2, act=act)
    harmed[0].kill()
    nodes.add()
    assert_same(folder / "whole", tmp_path / "d")
    assert any("is gone; others do its tasks" in line for line in course.lines) == is_gone
    assert psutil.wait_procs(orphans, timeout=60)[1] == []
    assert orphans


@pytest.mark.thorough
def test_workers_enforce_the_memory_limit(folder, nodes, tmp_path):
    engine = Engine(device="cpu", scheduler=Scheduler(nodes.address), limits=Limits(memory_bytes=1))
    with pytest.raises(HulldownError, match="more than the limit"):
        render_remaining_images(folder / "plan.jsonl", tmp_path / "d", engine=engine)


@pytest.mark.thorough
@needs_openssl
def test_a_run_over_tls_continues_after_its_client_was_killed(folder, tmp_path):
    _, options = certificates(tmp_path)
    with cluster(tmp_path / "nodes", 1, tls=options) as nodes:

        def start():
            return rendering(folder / "plan.jsonl", tmp_path / "d", nodes.file, *options[2:])  # but for the protocol

        killed = start()
        wait_for(killed, tmp_path / "d", 3)
        killed.kill()
        killed.communicate()
        client = start()
        messages = client.communicate()[1]
        assert client.returncode == 0, messages
    assert int(re.search(r"(\d+) were there", messages)[1]) >= 2
    assert_same(folder / "whole", tmp_path / "d")


@pytest.mark.thorough
def test_a_run_continues_with_another_scheduler_and_waits_for_workers(folder, tmp_path):
    with cluster(tmp_path / "first", 1) as first, pytest.raises(HulldownError, match="out of reach"):
        Course(tmp_path / "d", folder / "plan.jsonl", first.address, at=3, act=first.scheduler.kill)
    with cluster(tmp_path / "second") as second:
        course = Course(tmp_path / "d", folder / "plan.jsonl", second.address, act=second.add)
    assert course.line("waiting for workers")
    assert 3 <= course.report.already < IMAGES
    assert_same(folder / "whole", tmp_path / "d")


@pytest.mark.thorough
def test_workers_that_cannot_render_are_named_and_the_others_continue(folder, tmp_path):
    """One has no bpy, one has other code, and the disk of one is full."""
    packages = tmp_path / "packages"
    packages.mkdir()
    for entry in Path(next(p for p in site.getsitepackages() + sys.path if (Path(p) / "bpy").is_dir())).iterdir():
        if not entry.name.startswith("bpy"):
            (packages / entry.name).symlink_to(entry)
    environment = {"PYTHONPATH": f"{PYTHONPATH}{os.pathsep}{packages}"}
    other = tmp_path / "other" / "hulldown"
    ignored = shutil.ignore_patterns(".*", "tests", "docs", "benchmarks")
    shutil.copytree(ROOT, other, ignore=ignored)
    kinds = other / "camera" / "weather" / "kinds.py"
    kinds.write_text(kinds.read_text() + "\nOTHER = 1\n")
    lines = []
    with cluster(tmp_path / "nodes") as nodes:
        nodes.add(python=(sys.executable, "-P", "-S"), environment=environment)
        nodes.add(environment={"PYTHONPATH": str(other.parent)})
        nodes.wait()
        engine = Engine(scheduler=Scheduler(nodes.address), device="cpu")
        with pytest.raises(HulldownError, match="all workers are"):
            render_remaining_images(folder / "plan.jsonl", tmp_path / "d", progress=lines.append, engine=engine)
        for _ in range(2):
            nodes.add()
        nodes.add(largest_file=4096)
        nodes.wait()
        course = Course(tmp_path / "d", folder / "plan.jsonl", nodes.address)
    for why in ("it has no bpy", "it has hulldown "):
        assert sum(f"is not used: {why}" in progress.line for progress in lines) == 1
    assert_same(folder / "whole", tmp_path / "d")
    assert not course.report.failed


@pytest.mark.thorough
@pytest.mark.xfail(not landlock_version(), reason="this kernel has no Landlock, which hides the files", run=False)
def test_workers_that_do_not_see_the_assets_are_refused_in_one_line(folder, tmp_path):
    with cluster(tmp_path / "nodes") as nodes:
        nodes.add(before=(sys.executable, "-c", HIDDEN, PYTHONPATH, str(folder)))
        with pytest.raises(HulldownError, match=f"all workers are: it cannot read {folder}"):
            Course(tmp_path / "d", folder / "plan.jsonl", nodes.address)
    assert not (tmp_path / "d").exists()


@pytest.mark.thorough
def test_a_row_that_cannot_be_rendered_is_given_up_as_on_one_machine(folder, nodes, tmp_path):
    """Blender can't render 2 x 2 pixels."""
    header, *rows = (folder / "plan.jsonl").read_text().splitlines()
    lines = [{**json.loads(header), "images": 4}, *(json.loads(row) for row in rows[:4])]
    lines[2] |= {"width": 2, "height": 2}
    plan = folder / "poisoned.jsonl"
    plan.write_text("".join(json.dumps(line) + "\n" for line in lines))
    whole = render_remaining_images(plan, tmp_path / "whole", engine=Engine(device="cpu"))
    course = Course(tmp_path / "d", plan, nodes.address)
    assert course.report.failed == whole.failed == ("images/00000002.png",)
    assert (tmp_path / "d/annotations.json").read_bytes() == (tmp_path / "whole/annotations.json").read_bytes()
    (local,), (elsewhere,) = read_failures(tmp_path / "whole"), read_failures(tmp_path / "d")
    assert elsewhere == replace(local, reasons=2 * local.reasons)  # by two workers


@pytest.mark.thorough
def test_a_full_disk_of_the_client_is_a_one_line_error_and_the_run_continues_later(folder, nodes, tmp_path):
    def bound():
        resource.setrlimit(resource.RLIMIT_FSIZE, (16384, 16384))

    client = rendering(folder / "plan.jsonl", tmp_path / "d", nodes.address, preexec_fn=bound)
    (line,) = (line for line in client.communicate()[1].splitlines() if line.startswith("hulldown: "))
    assert client.returncode == 2
    assert "File too large" in line
    Course(tmp_path / "d", folder / "plan.jsonl", nodes.address)
    assert_same(folder / "whole", tmp_path / "d")


SECRET = """
import pathlib, sys
import bpy, numpy as np
from hulldown.tests.builders.blend_parts import save
from hulldown.tests.builders.node_trees import textured, write_picture
source, secret, target = sys.argv[1:]
write_picture(pathlib.Path(secret), np.full((8, 8, 3), (1.0, 0.9, 0.0)))
bpy.ops.wm.open_mainfile(filepath=source)
material = textured("ground", bpy.data.images.load(secret))
for thing in bpy.data.objects:
    if thing.type == "MESH":
        thing.data.materials.clear()
        thing.data.materials.append(material)
save(target, relative_remap=False)
"""


@pytest.mark.thorough
@pytest.mark.xfail(not landlock_version(), reason="this kernel has no Landlock", run=False)
def test_a_texture_outside_the_asset_folders_is_missing_as_on_one_machine(folder, tmp_path):
    """It was missing in a local render, but visible on a cluster."""
    client, secret = tmp_path / "client" / "pack" / "worlds", tmp_path / "secret" / "ground.png"
    for made in (client, secret.parent):
        made.mkdir(parents=True)
    for name in ("tank.blend", "gray.exr"):
        shutil.copy(folder / name, client / name)
    run_python("-c", SECRET, folder / "field.blend", secret, client / "field.blend")
    plan = plan_in(client, images=2)
    render_remaining_images(plan, tmp_path / "whole", engine=Engine(device="cpu"))
    with cluster(tmp_path / "nodes", 1) as nodes:
        Course(tmp_path / "d", plan, nodes.address)
    assert_same(tmp_path / "whole", tmp_path / "d", images=2)
