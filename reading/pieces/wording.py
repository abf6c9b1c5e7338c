"""Lists of names in messages."""

from __future__ import annotations

import json
from collections.abc import Iterable

MAX_SENTENCE_NAMES = 12
MAX_LISTED_NAMES = 6  # of a vehicle's objects, in a sentence


def quote_names(names: Iterable[str], *, most: int = MAX_SENTENCE_NAMES) -> str:
    """Quote names, without repeats, and count the rest.

    >>> quote_names(["Hull", "Gun", "Hull", "Cab"], most=2)
    "'Hull', 'Gun' and 1 more"
    """
    unique = list(dict.fromkeys(names))
    more = f" and {len(unique) - most} more" if len(unique) > most else ""
    return ", ".join(map(repr, unique[:most])) + more


def names_as_config_value(names: Iterable[str], *, most: int = MAX_SENTENCE_NAMES) -> str:
    """Format names as a config value, without repeats."""
    return json.dumps(list(dict.fromkeys(names))[:most], ensure_ascii=False)
