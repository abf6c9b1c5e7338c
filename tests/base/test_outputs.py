"""What a verb may write: nothing of the user's is replaced, a folder has one writer, and strangers' files stay."""

import errno
import os
from pathlib import Path

import pytest

from hulldown.base.outputs import (
    DONE_NAME,
    LOCK_NAME,
    OutputBusy,
    OutputError,
    OutputFolder,
    OutputLock,
    require_replaceable_file,
)


def test_only_new_empty_and_own_files_are_claimed(tmp_path):
    mine, ours, empty, linked = (tmp_path / name for name in ("mine", "ours", "empty", "linked"))
    mine.write_bytes(b"mine")
    ours.write_bytes(b"MARK and more")
    empty.touch()
    linked.symlink_to(tmp_path / "nowhere")
    for path in (tmp_path / "new" / "file", ours, empty):
        require_replaceable_file(path, "a page", b"MARK")
    for path in (mine, linked):
        with pytest.raises(OutputError, match="exists and isn't a page by hulldown; name another file by -o"):
            require_replaceable_file(path, "a page", b"MARK")
    with pytest.raises(OutputError, match="is an input of this command"):
        require_replaceable_file(ours, "a page", b"MARK", inputs=[mine, tmp_path / "." / "ours"])
    with pytest.raises(OutputError, match="is a folder; name a file for a page"):
        require_replaceable_file(tmp_path, "a page")
    with pytest.raises(OutputError, match=r"mine/x: cannot be written \(.*mine is a file\)"):
        require_replaceable_file(mine / "x", "a page")


def test_only_new_empty_and_own_folders_are_filled(tmp_path):
    inputs = tmp_path / "dataset"
    inputs.mkdir()
    (inputs / "photo.png").touch()
    for written in (".report.json.7.tmp", "report.json"):  # the first one is what a killed process leaves
        with OutputFolder(tmp_path / "a" / "b", "evaluation", inputs=[inputs]) as output:
            (output.folder / written).touch()
    assert sorted(os.listdir(tmp_path / "a" / "b")) == [".hulldown-evaluation", "report.json"]
    for path, problem in (
        (inputs, "is inside .*dataset, which this command reads"),
        (inputs / "sub", "is inside .*dataset, which this command reads"),
        (tmp_path / "a" / "b", r"isn't empty: it has \.hulldown-evaluation and no passes"),
        (inputs / "photo.png", "is a file, not a folder"),
    ):
        before = sorted(tmp_path.rglob("*"))
        with pytest.raises(OutputError, match=problem):
            OutputFolder(path, "passes", inputs=[inputs])
        assert sorted(tmp_path.rglob("*")) == before


def test_an_output_has_one_writer_and_its_lock_and_empty_folders_are_removed(tmp_path):
    with OutputFolder(tmp_path / "a" / "b", "run", ["config.json"]):
        with pytest.raises(OutputBusy, match="another process is writing this run"):
            OutputFolder(tmp_path / "a" / "b", "run", ["config.json"])
        assert os.listdir(tmp_path / "a" / "b") == [LOCK_NAME]
    assert os.listdir(tmp_path) == []


def test_a_place_without_files_is_not_a_second_process():
    with pytest.raises(OutputError, match=r"cannot be written \(no file can be made here\)"):
        OutputLock.acquire_for_file(Path("/proc/plan.jsonl"), "plan")


def test_what_others_put_into_a_folder_stays_when_the_work_fails(tmp_path):
    folder = tmp_path / "out"

    def export(fill):
        with OutputFolder(folder, "export", [DONE_NAME]) as output, output.stage_content("key") as unfinished:
            fill(unfinished)

    def fill_disk(unfinished):
        (folder / "mine.txt").write_text("mine")
        (unfinished / "train").mkdir()
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OutputError, match=r"No space left.*; free some space"):
        export(fill_disk)
    assert os.listdir(folder) == ["mine.txt"]
    with pytest.raises(OutputError, match=r"mine\.txt and no export"):
        OutputFolder(folder, "export", [DONE_NAME])
    (folder / "mine.txt").unlink()
    with pytest.raises(OutputError, match=r"data\.yaml: was put here by somebody else"):
        export(lambda unfinished: [(home / "data.yaml").write_text(str(home)) for home in (folder, unfinished)])
    assert (folder / "data.yaml").read_text() == str(folder)


@pytest.mark.parametrize("change", [lambda path: path.unlink(), lambda path: path.write_text("other")])
def test_a_folder_is_done_if_all_its_files_are_there_as_they_were_made(tmp_path, change):
    folder = tmp_path / "out"
    with OutputFolder(folder, "export", [DONE_NAME]) as output, output.stage_content("key") as unfinished:
        (unfinished / "train").mkdir()
        (unfinished / "train" / "1.txt").write_text("1")
    (folder / "labels.cache").touch()  # a training tool's
    with OutputFolder(folder, "export", [DONE_NAME]) as output:
        assert output.finish_earlier_run("key")
        assert not output.finish_earlier_run("other key")
        change(folder / "train" / "1.txt")
        with pytest.raises(OutputError, match=r"1\.txt: is missing, or isn't as it was written; delete .*out"):
            output.finish_earlier_run("key")
