"""Lists of names in messages, and the order of doubts."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence

MOST = 12  # names that a sentence lists
SHOWN = 3  # doubts that a warning lists
# Words of doubts about files whose pictures or labels would be wrong, worst first,
WORST = (
    *("NO GROUND", "missing: ", "isn't there, and", "of its surface is transparent", "level sheet", "hides the HDRI"),
    *("plain white", "without its textures", "placed on their roofs"),
    *("set scale", "more triangles are dropped", 'set up = "', "set forward", "its light is tinted"),
    *("paint:", "above its horizon", "of the sky overhead", "as warm as a ceiling"),
)
# and of doubts that only report a decision.
MILDEST = (
    "is used in its place",
    "turns about",
    "isn't used as ground",
    "perhaps water",
    "are black:",
    "are as bright",
)


def quoted(names: Iterable[str], *, most: int = MOST) -> str:
    """Quote names, each once, and count the rest.

    Examples
    --------
    >>> quoted(["Hull", "Gun", "Hull", "Cab"], most=2)
    "'Hull', 'Gun' and 1 more"
    """
    unique = list(dict.fromkeys(names))
    more = f" and {len(unique) - most} more" if len(unique) > most else ""
    return ", ".join(map(repr, unique[:most])) + more


def as_key(names: Iterable[str], *, most: int = MOST) -> str:
    """Format names as a config value, each once."""
    return json.dumps(list(dict.fromkeys(names))[:most], ensure_ascii=False)


def warnings_of(doubts: Mapping[str, Sequence[str]]) -> list[str]:
    """Return one warning for each file, those with the worst doubts first, each with its worst `SHOWN` doubts.

    Parameters
    ----------
    doubts
        Sentences by path.

    Examples
    --------
    >>> for warning in warnings_of({"a.obj": ["odd"], "b.obj": ["odd", "odd 2", "missing: b.png", "odd 3"]}):
    ...     print(warning)
    b.obj
      missing: b.png
      odd
      odd 2
      and 1 more, which `hulldown inspect` lists
    a.obj
      odd
    """
    ranked = {path: sorted(lines, key=_rank) for path, lines in doubts.items() if lines}
    warnings = []
    for path, lines in sorted(ranked.items(), key=lambda item: _rank(item[1][0])):
        shown = [line.replace("\n", "\\n") for line in lines[:SHOWN]]
        more = [f"and {len(lines) - SHOWN} more, which `hulldown inspect` lists"] if len(lines) > SHOWN else []
        warnings.append("\n  ".join([path, *shown, *more]))
    return warnings


def _rank(doubt: str) -> int:
    usual = len(WORST)
    found = next((rank for rank, word in enumerate(WORST) if word in doubt), usual)
    return usual + 1 if found == usual and any(word in doubt for word in MILDEST) else found
