"""Compare the datasets of two runs of a plan, one of which was disturbed."""

from __future__ import annotations

import hashlib
from pathlib import Path

from hulldown.dataset.coco import LOCK_NAME
from hulldown.dataset.store.document import JOURNAL_NAME
from hulldown.dataset.store.journal import MERGED
from hulldown.render.session import LOGS_NAME


def differences(whole: Path, killed: Path) -> dict[str, int]:
    """Count the files that are lost, too many, or different in the second of two datasets; all 0 if they are equal.

    Parameters
    ----------
    whole, killed
        Folders of datasets. The bytes of every file except logs and lock are compared; the journal by its lines in any
        order, since images finish in any order.
    """
    files, others = (_digests(folder) for folder in (whole, killed))
    return {
        "files lost": len(files.keys() - others.keys()),
        "files too many": len(others.keys() - files.keys()),
        "files that differ": sum(files[n] != others[n] for n in files.keys() & others.keys()),
    }


def _digests(dataset: Path) -> dict[Path, str]:
    """Hashes of the files that a run leaves behind."""
    found = {}
    for path in sorted(p for p in dataset.rglob("*") if p.is_file()):
        name, content = path.relative_to(dataset), path.read_bytes()
        if name.parts[0] in (LOGS_NAME, LOCK_NAME):
            continue
        if name == Path(JOURNAL_NAME):
            lines = content.splitlines(keepends=True)
            content = b"".join(sorted(line for line in lines if line != MERGED))
        found[name] = hashlib.sha256(content).hexdigest()
    return found
