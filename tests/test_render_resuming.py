"""Kills of `hulldown render` and of Blender: the dataset must equal that of an undisturbed run."""

import shutil

import pytest

from hulldown.tests.blender_plans import IMAGES, copied, plan_in
from hulldown.tests.oracles.resuming import Kill, differences, render

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def folder(worlds, tmp_path_factory):
    """A plan, rendered into `whole` by an undisturbed run and into `killed` with kills."""
    made = copied(worlds, tmp_path_factory.mktemp("resuming"))
    plan = plan_in(made)
    render(plan, made / "whole")
    course = render(plan, made / "killed", [Kill("worker", 2, 0.02), Kill("run", 3, 0.05)])
    assert course.killed == {"run": 1, "worker": 1}
    assert course.started == 2
    return made


def test_two_kills_lose_and_double_nothing(folder):
    found = differences(folder / "whole", folder / "killed")
    assert found == dict.fromkeys(found, 0)
    assert len(list((folder / "killed" / "images").iterdir())) == IMAGES


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("lost", "files lost"),
        ("other", "files that differ"),
        ("left over", "files too many"),
        ("journal line twice", "files that differ"),
    ],
)
def test_the_comparison_finds(folder, tmp_path, what, expected):
    changed = tmp_path / "changed"
    shutil.copytree(folder / "killed", changed)
    first, second = sorted((changed / "images").iterdir())[:2]
    if what == "lost":
        first.unlink()
    elif what == "other":
        shutil.copy(second, first)
    elif what == "left over":
        (changed / ".unfinished").mkdir()
        shutil.copy(first, changed / ".unfinished")
    else:
        lines = (changed / "journal.jsonl").read_bytes().splitlines(keepends=True)
        (changed / "journal.jsonl").write_bytes(b"".join([*lines[:3], *lines[2:]]))
    found = differences(folder / "whole", changed)
    assert {key: n for key, n in found.items() if n} == {expected: 1}
