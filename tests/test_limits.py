"""docs/limits.md has every reason for rejecting a try, and existing keys."""

import re
from pathlib import Path

from hulldown.placement.rejection import Rejection
from hulldown.planning.config.schema import Config

ROWS = re.findall(
    r"^\| `(\w+)` \|(.*)\|.*\|$", (Path(__file__).parents[1] / "docs" / "limits.md").read_text(encoding="utf-8"), re.M
)


def test_the_docs_have_every_reason():
    assert sorted(reason for reason, _ in ROWS) == sorted(each.key for each in Rejection if each)


def test_keys_of_reasons_are_keys_of_the_config():
    for _, keys in ROWS:
        for section, key in re.findall(r"`(\w+)\.(\w+)`", keys):
            assert key in Config.model_fields[section].annotation.model_fields
