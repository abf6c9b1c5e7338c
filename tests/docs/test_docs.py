"""The commands in README and docs work.

Every link has a target, and the command accepts the arguments of every `hulldown` line. `make thorough` runs them.
"""

import itertools
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from PIL import Image
from pycocotools.coco import COCO

from hulldown import cli
from hulldown.plan.config.config_keys import config_text
from hulldown.verbs.command import make_command_app

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
FENCE = re.compile(r"^ *```(?:sh|console)\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
# Two tiny pictures per class in place of 420 pictures of 1080p.
SMALL = {
    "budget.images_per_class": 2,
    "budget.images_per_position": 2,
    "render.profile": "fast",
    "render.samples": 2,
    "render.width": 96,
    "render.height": 54,
    "camera.min_box_px": 1.0,
}


def commands(page):
    lines = [line.strip() for block in FENCE.findall(page.read_text(encoding="utf-8")) for line in block.splitlines()]
    return [line for line in lines if line.startswith("hulldown ")]


def python_code():
    """The Python code of docs/python.md, in four pieces."""
    code = re.findall(r"(?ms)^```python\n(.*?)^```", (ROOT / "docs" / "python.md").read_text(encoding="utf-8"))
    assert len(code) == 4
    return code


def python(words, folder):
    """Run Python in a folder."""
    return subprocess.run([sys.executable, "-P", *words], cwd=folder, capture_output=True, text=True, timeout=900)


def hulldown(command, folder):
    return python(["-m", "hulldown.cli", *shlex.split(command, comments=True)[1:]], folder)


def shrink(config):
    """The same project with one vehicle per class, one scenery, and a few small pictures."""
    parsed = tomllib.loads(config.read_text(encoding="utf-8"))
    one_a_class = {entry["category"]: entry for entry in parsed["assets"]["vehicles"]}
    text = config_text(
        vehicles=list(one_a_class.values()),
        sceneries=parsed["assets"]["sceneries"][-1:],
        hdris=parsed["assets"]["hdris"],
        values=SMALL,
    )
    config.write_text(text, encoding="utf-8")


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """A folder in which the README was followed from top to bottom, and the output of each command."""
    folder = tmp_path_factory.mktemp("reader")
    answers = {}
    for command in commands(ROOT / "README.md"):
        answers[command] = hulldown(command, folder)
        if command.startswith("hulldown init"):
            shrink(folder / "project" / "hulldown.toml")
    return folder, answers


@pytest.mark.blender
@pytest.mark.thorough
def test_every_command_of_the_readme_works(reader):
    _, answers = reader
    verbs = {command.split()[1] for command in answers}
    assert verbs >= {"init", "inspect", "plan", "preview", "render", "verify", "export"}
    assert {c: (a.returncode, a.stderr[-500:]) for c, a in answers.items() if a.returncode} == {}


@pytest.mark.blender
@pytest.mark.thorough
def test_following_the_readme_makes_a_dataset(reader):
    folder, _ = reader
    coco = COCO(folder / "project" / "dataset" / "annotations.json")
    assert len(coco.imgs) == len(coco.anns) == 6
    assert {len(coco.getImgIds(catIds=[category])) for category in coco.cats} == {2}
    assert (folder / "project" / "training" / "train" / "_annotations.coco.json").exists()
    assert (folder / "project" / "preview.png").exists()
    assert (folder / "parts.png").exists()


@pytest.mark.blender
@pytest.mark.thorough
@pytest.mark.parametrize("page", PAGES[1:], ids=lambda page: page.stem)
def test_every_command_of_a_page_works_in_that_project(page, reader):
    folder, _ = reader
    for command in commands(page):
        if not command.startswith("hulldown init"):
            answer = hulldown(command, folder)
            assert answer.returncode == 0, f"{command}: {answer.stderr[-500:]}"


@pytest.mark.blender
@pytest.mark.thorough
def test_the_code_of_the_python_page_runs_in_that_project(reader):
    folder, _ = reader
    ran = python(["-c", "\n".join(python_code())], folder)
    assert ran.returncode == 0, ran.stderr[-500:]
    with Image.open(folder / "labeled.png") as labeled, Image.open(folder / "bare.png") as bare:
        assert labeled.size == bare.size
        assert labeled.tobytes() != bare.tobytes()
    assert (folder / "planned.png").exists()


def test_the_command_accepts_the_arguments_of_every_line():
    """Of those that are shown without being run, too."""
    fenced = re.compile(r"(?ms)^ *```\w*\n(.*?)^ *```")
    blocks = {page.stem: "\n".join(fenced.findall(page.read_text(encoding="utf-8"))) for page in PAGES}
    shown = {page: re.findall(r"(?m)^ *(hulldown .*)$", text) for page, text in blocks.items()}
    assert {"README", "cluster", "performance", "training"} <= {page for page, lines in shown.items() if lines}
    assert all(set(commands(page)) <= set(shown[page.stem]) for page in PAGES)
    for line in itertools.chain.from_iterable(shown.values()):
        words = shlex.split(line, comments=True)[1:]
        make_command_app(words, cli.VERBS).parse_args(words, exit_on_error=False)


def test_the_code_of_the_python_page_imports_existing_names():
    code = "\n".join(python_code())
    compile(code, "python.md", "exec")
    exec("\n".join(line for line in code.splitlines() if line.startswith(("import ", "from "))), {})


def anchors(page):
    """Anchors of a page's headings, made as GitHub makes them."""
    headings = re.findall(r"(?m)^#+ (.+)$", re.sub(r"(?ms)^```.*?^```", "", page.read_text(encoding="utf-8")))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_link_has_a_target(page):
    lost = []
    for link in re.findall(r"\]\(([^)]+)\)", page.read_text(encoding="utf-8")):
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if "://" not in link and not (target.exists() and (not anchor or anchor in anchors(target))):
            lost.append(link)
    assert lost == []


def test_make_help_lists_every_target():
    printed = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for target in ("setup", "browser", "demo", "test", "check", "bench", "thorough", "clean", "help"):
        assert f"make {target} " in printed
