"""The list of label types, from which docs/dataset.md follows."""

from pathlib import Path
from typing import get_type_hints

from msgspec import Meta

from hulldown.annotate.label_list import LABEL_TYPES

PAGE = (Path(__file__).parents[2] / "docs" / "dataset.md").read_text(encoding="utf-8")


def test_the_docs_describe_every_field():
    hints = [hint for kind in LABEL_TYPES for hint in get_type_hints(kind, include_extras=True).items()]
    described = [(name, meta) for name, hint in hints for meta in hint.__metadata__ if isinstance(meta, Meta)]
    wanted = "\n".join(f"| | `{name}` | {meta.description} |" for name, meta in described)
    assert len(described) == len(hints)
    assert wanted in PAGE, f"docs/dataset.md is to have these lines:\n{wanted}"
