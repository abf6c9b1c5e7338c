"""Bytes that would survive a crash of the machine."""

import os
import stat
from pathlib import Path


def synced_bytes(monkeypatch):
    """Watch `os.fsync`; return a dictionary from each file's inode to its bytes when it was last synced."""
    found, fsync = {}, os.fsync

    def noted(descriptor):
        fsync(descriptor)
        status = os.fstat(descriptor)
        if stat.S_ISREG(status.st_mode):
            found[status.st_ino] = Path(f"/proc/self/fd/{descriptor}").read_bytes()

    monkeypatch.setattr(os, "fsync", noted)
    return found
