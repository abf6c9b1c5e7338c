"""The command line: exit codes, one-line errors, results on stdout, and messages on stderr."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
import unicodedata
from functools import partial
from types import SimpleNamespace

import pytest
from rich.table import Table

from hulldown import cli
from hulldown.base.errors import HulldownError
from hulldown.base.outputs import UNFINISHED_NAME
from hulldown.base.terminal import STDERR_TERMINAL
from hulldown.dataset.coco import CocoDataset
from hulldown.tests.builders.editing import render
from hulldown.verbs.output import FOUND, STDOUT_TERMINAL


def run_apart(*words, cwd, stdout=subprocess.PIPE):
    """The command in a separate process."""
    command = [sys.executable, "-P", "-m", "hulldown", *map(str, words)]
    return subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, cwd=cwd, timeout=120)


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run the command in this process, inside tmp_path."""
    monkeypatch.chdir(tmp_path)

    def call(*words):
        code = cli.main([*map(str, words)])
        shown = capsys.readouterr()
        return SimpleNamespace(returncode=code, stdout=shown.out, stderr=shown.err)

    return call


@pytest.mark.parametrize("verb", cli.VERBS)
def test_help_names_what_a_verb_reads_and_writes(verb, capsys):
    assert cli.main([*verb.split(), "--help"]) == 0
    printed = capsys.readouterr().out.lower()
    assert "reads" in printed or "writes" in printed


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["plan", "none.toml", "-o", "plan.jsonl"], "none.toml"),
        (["preview", "none.jsonl"], "none.jsonl"),
        (["check", "none.jsonl"], "none.jsonl"),
        (["render", "none.jsonl", "-o", "dataset"], "none.jsonl"),
        (["verify", "none"], "none"),
        (["join", "none", "-o", "dataset"], "none"),
        (["export", "none", "-o", "out"], "none"),
        (["inspect", "none.blend"], "none.blend"),
        (["subset", "none", "-o", "out"], "none"),
        (["verify", "n" * 300], "File name too long"),
        (["inspect", "none.blend", "-o", f"{'n' * 300}.png"], "File name too long"),
    ],
)
def test_a_mistake_is_one_line_with_exit_code_2(words, named, run, tmp_path):
    ran = run(*words)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert named in ran.stderr
    assert len(ran.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        *(
            (["export", "dataset", "-o", "out", "--split", split], "add up to 1")
            for split in ("0.7,0.3", "a,b,c", "0.7,0.2,0.2", "1.2,-0.1,-0.1", "nan,0,0", "0,nan,1", "inf,0,0")
        ),
        *(
            (["render", "plan.jsonl", "-o", "dataset", f"--share={share}"], "K/N with K from 1 to N")
            for share in ("0/2", "3/2", "2", "1/2/3", "a/b", "-1/2", "1/0", "\u00b2/3")
        ),
        *(
            (["render", "plan.jsonl", "-o", "dataset", f"--image-timeout={seconds}"], "a number above 0")
            for seconds in ("0", "-1", "nan", "inf")
        ),
    ],
    ids=lambda value: value[-1] if isinstance(value, list) else "",
)
def test_an_argument_out_of_range_is_refused(words, expected, run):
    ran = run(*words)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert expected in ran.stderr


@pytest.mark.parametrize(("verb", "left"), [("export", "nothing was written"), ("join", "the same command goes on from here")])
def test_a_stopped_run_reports_what_is_left(verb, left, tmp_path):
    render(tmp_path / "d", range(100))
    command = [sys.executable, "-P", "-m", "hulldown", verb, "d", "-o", "out"]
    # Tests in the background ignore Ctrl-C, and so would the command.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    for _ in range(9):  # until the signal comes before the end
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path, preexec_fn=heed) as run:
            begun = tmp_path / "out" / (UNFINISHED_NAME if verb == "export" else "")  # an earlier signal leaves an empty lock
            while run.poll() is None and not begun.exists():
                time.sleep(1e-3)
            run.send_signal(signal.SIGINT)
            said = run.stderr.read()
        if run.returncode != cli.DONE:
            break
        shutil.rmtree(tmp_path / "out")
    assert (run.returncode, said) == (130, f"hulldown: stopped; {left}\n")
    assert (tmp_path / "out").exists() <= (verb == "join")
    assert run_apart(*command[4:], cwd=tmp_path).returncode == cli.DONE


def test_join_reports_its_result(run, tmp_path):
    for i, part in enumerate(("a", "b")):
        render(tmp_path / part, [i])
    words = ("join", "a", "b", "-o", "joined", "--json")
    assert json.loads(run(*words).stdout) == {"added": 2, "already": 0, "failed": 0, "missing": 4}
    assert json.loads(run(*words).stdout)["already"] == 2


def test_a_warning_is_one_line(tmp_path):
    with CocoDataset.open(tmp_path / "d", categories=["tank"]):
        pass
    (tmp_path / "d" / "annotations.json").unlink()
    ran = run_apart("export", "d", "-o", "out", cwd=tmp_path)
    assert ran.stderr.startswith("warning: d/annotations.json: is missing")
    assert ran.stderr.count("warning: ") == 1
    assert ran.returncode == cli.DONE


@pytest.mark.blender
def test_doctor_prints_json_in_any_folder(tmp_path):
    (tmp_path / "render").mkdir()
    for shadow in ("render/__init__.py", "bpy.py"):
        (tmp_path / shadow).write_text("raise RuntimeError('not what was meant')")
    ran = run_apart("doctor", "--json", cwd=tmp_path)
    found = json.loads(ran.stdout)
    assert found["blender"].startswith("5.")
    assert found["devices"][-1]["kind"] == "CPU"
    assert (ran.returncode, ran.stderr) == (FOUND if found["problems"] else cli.DONE, "")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["plan", "hulldown.toml", "-o", "folder.png"], "can't end in .png"),
        (["plan", "hulldown.toml", "-o", "."], "is a folder"),
        (["plan", "hulldown.toml", "-o", "file/x"], "cannot be written"),
        (["inspect", "none.blend", "-o", "folder.png"], "folder.png: is a folder; name a file"),
        (["inspect", "none.blend", "-o", "file/x.png"], "file/x.png: cannot be written"),
        (["inspect", "none.blend", "-o", "hulldown.toml"], "Expected the name of a .png file"),
        (["preview", "x.jsonl", "-o", "hulldown.toml"], "Expected the name of a .png file"),
        (["init", "file"], "cannot be written"),
        (["init", "file/project"], "cannot be written"),
        (["demo", "--output", "file"], "cannot be written"),
    ],
    ids=" ".join,
)
def test_an_unwritable_output_is_refused_before_the_work(words, message, run, tmp_path):
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").write_text("mine")
    vehicles, sceneries = '[{ path = "none.blend", category = "tank" }]', '[{ path = "none.blend" }]'
    config = f"budget.images_per_class = 1\nassets.vehicles = {vehicles}\nassets.sceneries = {sceneries}\n"
    (tmp_path / "hulldown.toml").write_text(config)
    ran = run(*words)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert message in ran.stderr.splitlines()[-1]
    assert (tmp_path / "file").read_text() == "mine"
    assert (tmp_path / "hulldown.toml").read_text() == config


def dataset_with_findings(folder, n):
    images = [{"id": i, "file_name": f"images/{'x' * 90}{i}.png", "width": 8, "height": 8} for i in range(1, n + 1)]
    folder.mkdir()
    (folder / "annotations.json").write_text(json.dumps({"images": images, "annotations": [], "categories": []}))
    return folder


def test_a_finding_is_one_line_in_a_narrow_terminal(run, tmp_path):
    ran = run("verify", dataset_with_findings(tmp_path / "dataset", 3))
    assert ran.returncode == 1
    missing = [line for line in ran.stdout.splitlines() if line.endswith(".png: is missing")]
    assert len(missing) == 3


def test_a_closed_pipe_and_a_full_disk_for_the_result(tmp_path):
    words = "verify", dataset_with_findings(tmp_path / "dataset", 2000)
    reading, writing = os.pipe()
    os.close(reading)
    unheard = run_apart(*words, cwd=tmp_path, stdout=writing)
    os.close(writing)
    assert (unheard.returncode, unheard.stderr) == (0, "")
    with open("/dev/full", "w") as full:
        crowded = run_apart(*words, "--json", cwd=tmp_path, stdout=full)
    assert crowded.returncode == 2
    assert crowded.stderr == "hulldown: stdout: No space left on device; make room and run the same command again\n"


@pytest.mark.parametrize("console", [STDOUT_TERMINAL, STDERR_TERMINAL])
def test_names_cannot_control_the_terminal(console, capsys):
    """Escape codes, backspaces, bells, and changes of direction, wherever a name from a file is printed."""
    table = Table("object")
    table.add_row("\x1b]0;title\x07")
    for shown in ("\x1b[2Jtank\x9b31m", "tank\b\b\b", "a\u202eb\u2066c", table):
        console.print(shown, soft_wrap=True)
    printed = "".join(capsys.readouterr())
    assert not [c for c in printed if c != "\n" and unicodedata.category(c).startswith("C")]
    assert "\\x1b[2Jtank\\x9b31m" in printed


def test_a_message_of_any_length_is_one_line(monkeypatch, capsys):
    def fail():
        raise HulldownError("x" * 10**6 + "\nsecond line", path="a\x1bb")

    monkeypatch.setattr("hulldown.render.doctor.diagnose_machine", fail)
    assert cli.main(["doctor"]) == 2
    printed = capsys.readouterr().err
    assert len(printed) < 3000
    assert printed.count("\n") == 1
    assert "second line" in printed
