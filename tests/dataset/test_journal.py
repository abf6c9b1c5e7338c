import os
from contextlib import closing

import pytest

from hulldown.base.errors import DatasetError
from hulldown.dataset.store.journal import Journal, read_journal
from hulldown.tests.oracles.synced import synced_bytes


def test_a_line_survives_a_crash_of_the_machine(tmp_path, monkeypatch):
    synced, path = synced_bytes(monkeypatch), tmp_path / "journal.jsonl"
    with closing(Journal(path)) as journal:
        for i in range(3):
            journal.append({"i": i})
            assert synced[path.stat().st_ino] == path.read_bytes()


def test_a_closed_journal_never_writes_to_a_reused_descriptor(tmp_path):
    journal = Journal(tmp_path / "journal.jsonl")
    journal.append({"i": 1})
    journal.close()
    with (tmp_path / "other").open("wb") as other:
        journal.close()
        with pytest.raises(ValueError, match=r"journal\.jsonl: expected an open journal, got a closed one"):
            journal.append({"i": 2})
        other.write(b"untouched")
    assert (tmp_path / "other").read_bytes() == b"untouched"


@pytest.mark.parametrize("cut", [b'{"i":', b'{"i":2}', b"\0" * 70000, b"{" * 200000])
def test_a_truncated_last_line_is_dropped_with_a_warning(tmp_path, cut):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b'{"i":0}\n{"i":1}\n' + cut)
    assert [line["i"] for line in read_journal(path)] == [0, 1]
    with pytest.warns(UserWarning, match="last line was cut off"), closing(Journal(path)) as journal:
        journal.append({"i": 2})
    assert [line["i"] for line in read_journal(path)] == [0, 1, 2]


@pytest.mark.parametrize("content", [b"precious", b'{"i":0}\n'])
def test_a_link_in_place_of_the_journal_is_not_followed(tmp_path, content):
    """A foreign dataset must not make us write or truncate a file outside of it."""
    outside, path = tmp_path / "outside", tmp_path / "journal.jsonl"
    outside.write_bytes(content)
    path.symlink_to(outside)
    with pytest.raises(DatasetError, match=r"journal\.jsonl: cannot be written to"):
        Journal(path)
    assert outside.read_bytes() == content


@pytest.mark.parametrize("line", [b'{"i":\n', b"[1]\n", b"\n", b"\xff\n"])
def test_the_error_of_a_damaged_inner_line_names_it(tmp_path, line):
    path = tmp_path / "journal.jsonl"
    path.write_bytes(b'{"i":0}\n' + line + b'{"i":1}\n')
    with pytest.raises(DatasetError, match=r"journal\.jsonl: line 2 is damaged"):
        list(read_journal(path))


def test_a_full_disk_removes_the_partial_line(tmp_path, monkeypatch):
    path = tmp_path / "journal.jsonl"
    with closing(Journal(path)) as journal:
        journal.append({"i": 0})
        write = os.write

        def full(descriptor: int, data: bytes) -> int:
            write(descriptor, data[:4])
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "write", full)
        with pytest.raises(DatasetError, match=r"could not be recorded \(No space left on device\); free some space"):
            journal.append({"i": 1})
        monkeypatch.undo()
        journal.append({"i": 2})
    assert [line["i"] for line in read_journal(path)] == [0, 2]


def test_short_writes_are_continued(tmp_path, monkeypatch):
    path = tmp_path / "journal.jsonl"
    write = os.write
    monkeypatch.setattr(os, "write", lambda descriptor, data: write(descriptor, data[:3]))
    with closing(Journal(path)) as journal:
        journal.append({"i": list(range(10))})
    assert [line["i"] for line in read_journal(path)] == [list(range(10))]
