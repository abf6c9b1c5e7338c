"""The command's manners: exit codes, one line for a mistake, results on stdout and the rest on stderr."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import cli

ROOT = Path(__file__).parents[1]
VERBS = ["init", "inspect", "plan", "preview", "render", "verify", "export", "doctor", "demo"]


def run(*words, cwd):
    return subprocess.run(
        [sys.executable, "-P", "-m", "cli", *map(str, words)],
        cwd=cwd, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=120,
    )  # fmt: skip


@pytest.mark.parametrize("verb", VERBS)
def test_help_says_what_a_verb_reads_and_writes(verb, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main([verb, "--help"])
    assert stop.value.code == 0
    said = capsys.readouterr().out.lower()
    assert "reads" in said or "writes" in said


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["plan", "none.toml", "-o", "plan.jsonl"], "none.toml"),
        (["preview", "none.jsonl"], "none.jsonl"),
        (["render", "none.jsonl", "-o", "dataset"], "none.jsonl"),
        (["verify", "none"], "none"),
        (["export", "none", "-o", "out"], "none"),
        (["inspect", "none.blend"], "none.blend"),
    ],
)
def test_a_mistake_is_one_line_with_exit_code_2(words, named, tmp_path):
    ran = run(*words, cwd=tmp_path)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert named in ran.stderr
    assert len(ran.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_the_help_does_not_wait_for_the_stages():
    code = "import sys, cli; cli._parser().format_help(); assert not {'numpy', 'scipy', 'bpy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=60)


@pytest.mark.parametrize("split", ["0.7,0.3", "a,b,c", "0.7,0.2,0.2", "1.2,-0.1,-0.1"])
def test_a_split_that_does_not_add_up_is_refused(split, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["export", "dataset", "-o", "out", "--split", split])
    assert stop.value.code == 2
    assert "add up to 1" in capsys.readouterr().err


@pytest.mark.blender
def test_doctor_speaks_json(tmp_path):
    ran = run("doctor", "--json", cwd=tmp_path)
    found = json.loads(ran.stdout)
    assert found["blender"].startswith("5.0")
    assert found["devices"][-1]["kind"] == "CPU"
    assert (ran.returncode == 0) == (found["problems"] == [])
