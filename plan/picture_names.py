"""Names of a plan's pictures."""

from __future__ import annotations

# What a picture may be called on any file system: a path below images/ in normal form. No component is empty,
# begins with a dot, ends in what Windows drops, or is a device of Windows; no character is one that a system refuses.
PICTURE_NAME = (
    r"^images(?:/(?!\.)(?!(?i:con|prn|aux|nul|com\d|lpt\d)(?:\.|/|\Z))"
    r"[^/\\\x00-\x1f\x7f-\x9f<>:\"|?*\ud800-\udfff]{1,200}(?<![ .])){1,16}(?<=\.png)\Z"
)


def picture_name(index: int) -> str:
    """Return the planned path of an image."""
    return f"images/{index + 1:08d}.png"
