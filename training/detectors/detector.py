"""Detectors, and their files."""

from __future__ import annotations

import argparse
import json
import pickle
import struct
import types
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int, UInt8

from hulldown.base.errors import HulldownError

RUN_NAME, WEIGHTS_NAME = "run.json", "weights.pt"
# Exceptions of unpickling damaged bytes, or of loading them into a network.
DAMAGED = (
    *(RuntimeError, ValueError, LookupError, TypeError, AttributeError, EOFError, OSError),
    *(pickle.UnpicklingError, struct.error),
)
_REMEDY = "name a folder of `hulldown train`, its weights.pt, or a checkpoint of RF-DETR"
_KINDS = {
    b"\x89PNG": "a PNG picture",
    b"\xff\xd8\xff": "a JPEG picture",
    b"PK": "a damaged PyTorch file, or one that holds more than weights",
    b"{": "a JSON file",
    b"[": "a JSON file",
    b"\x80": "a pickled Python object",
}


@dataclass(frozen=True, eq=False, slots=True)
class Detections:
    """Detections in a picture, by falling score.

    Parameters
    ----------
    xywh
        (k, 4) boxes in the picture's pixels, inside it.
    score
        (k,) confidence, from 0 to 1.
    label
        (k,) index into the detector's classes.
    """

    xywh: Float[np.ndarray, "k 4"]
    score: Float[np.ndarray, " k"]
    label: Int[np.ndarray, " k"]


@runtime_checkable
class Detector(Protocol):
    """A trained network; `classes` are the names of its classes."""

    classes: tuple[str, ...]

    def detect(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> list[Detections]:
        """Detect objects in RGB pictures of any sizes, as one batch."""


def read_run(folder: Path) -> dict[str, Any]:
    """Read run.json of a run folder.

    Raises
    ------
    HulldownError
        If there is none, or it is damaged.
    """
    path = folder / RUN_NAME
    try:
        run = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise HulldownError(f"no {RUN_NAME} here", path=folder, remedy="name a folder of `hulldown train`") from None
    except (OSError, ValueError) as error:
        raise HulldownError(f"cannot be read ({error})", path=path, remedy="train again in another folder") from None
    if not isinstance(run, dict) or not isinstance(run.get("model"), str):
        raise HulldownError("isn't a hulldown run", path=path, remedy="name a folder of `hulldown train`")
    return run


def read_weights(path: Path) -> dict[str, Any]:
    """Read a weights file of hulldown or RF-DETR; code in it is refused, not run.

    Raises
    ------
    HulldownError
        If there is no such file, or it isn't a weights file.
    """
    import torch

    try:
        with warnings.catch_warnings(), torch.serialization.safe_globals([argparse.Namespace, types.SimpleNamespace]):
            warnings.filterwarnings("ignore", "Detected pickle protocol")  # of a file that happens to begin like one
            found = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise HulldownError("no such run folder or checkpoint", path=path, remedy=_REMEDY) from None
    except DAMAGED:  # its text advises loading code
        raise HulldownError(f"is {_kind(path)}, not the weights of a detector", path=path, remedy=_REMEDY) from None
    if not isinstance(found, dict):
        raise HulldownError("is a PyTorch file, but not the weights of a detector", path=path, remedy=_REMEDY)
    return found


def _kind(path: Path) -> str:
    """Guess the kind of a file that can't be loaded from its first bytes."""
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        return f"unreadable ({error.strerror})"
    for start, kind in _KINDS.items():
        if head.startswith(start):
            return kind
    if path.suffix.lower() in (".onnx", ".safetensors"):
        return f"of the kind {path.suffix.lower()}"
    return "empty" if not head else "damaged or of an unknown kind"


def first_line(error: BaseException) -> str:
    """The first line of an error's text."""
    return str(error).strip().split("\n")[0][:200] or type(error).__name__


def chosen_device(device: str) -> Any:
    """Return the device that the user named.

    Raises
    ------
    HulldownError
        If it doesn't exist.
    """
    import torch

    device = {"gpu": "cuda"}.get(device, device)
    if device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        chosen = torch.device(device)
        torch.empty(0, device=chosen)
    except (RuntimeError, AssertionError) as error:
        raise HulldownError(
            f"device {device!r} cannot be used ({first_line(error)})", remedy="name auto or cpu"
        ) from None
    return chosen
