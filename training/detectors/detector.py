"""Detectors, and their files."""

from __future__ import annotations

import argparse
import pickle
import struct
import types
import warnings
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from msgspec import Struct

from hulldown.base.errors import HulldownError
from hulldown.base.files import open_regular_file
from hulldown.base.outside import describe_path, file_sha256, read_json

if TYPE_CHECKING:
    import torch

RUN_NAME = "run.json"
WEIGHTS_NAME, WEIGHTS_FOLDER = "weights.pt", "weights"  # RF-DETR's, and those of a detector of transformers
TRANSFORMERS_FILES = ("config.json", "preprocessor_config.json", "model.safetensors")  # in a folder of weights
# Exceptions of unpickling damaged bytes, or of loading them into a network.
DAMAGE_ERRORS = (
    *(RuntimeError, ValueError, LookupError, TypeError, AttributeError, EOFError, OSError),
    *(pickle.UnpicklingError, struct.error, zipfile.BadZipFile, MemoryError, NotImplementedError, RecursionError),
)
_REMEDY = "name a folder of `hulldown train`, its weights, or a checkpoint of RF-DETR"
_WEIGHT_KINDS = {
    b"\x89PNG": "a PNG picture",
    b"\xff\xd8\xff": "a JPEG picture",
    b"PK": "a damaged PyTorch file, or one that holds more than weights",
    b"{": "a JSON file",
    b"[": "a JSON file",
    b"\x80": "a pickled Python object",
}


@dataclass(frozen=True, eq=False, slots=True)
class Detections:
    """Detections in a picture, by falling score."""

    xywh: Float[np.ndarray, "k 4"]  # boxes in the picture's pixels, inside it
    score: Float[np.ndarray, " k"]  # confidence, from 0 to 1
    class_index: Int[np.ndarray, " k"]  # index into the detector's classes

    def take(self, rows: Int[np.ndarray, " r"] | Bool[np.ndarray, " k"]) -> Detections:
        """Return rows of the table."""
        return Detections(self.xywh[rows], self.score[rows], self.class_index[rows])


@runtime_checkable
class Detector(Protocol):
    """A trained network; `classes` has the names of its classes."""

    classes: tuple[str, ...]

    def detect(self, images: Sequence[UInt8[np.ndarray, "_ _ 3"]]) -> list[Detections]:
        """Detect objects in RGB pictures of any sizes, as one batch."""


class RunFigures(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Figures of a finished run; `valid` has those of the validation set, with the step of the best weights."""

    final_loss: float | None = None
    seconds: float | None = None
    seconds_per_step: float | None = None
    valid: dict[str, float] | None = None


class RunSource(Struct, frozen=True):
    """A dataset that a run was trained on."""

    folder: str
    images: int
    drawn: int


class Run(Struct, frozen=True, kw_only=True):
    """The contents of run.json."""

    status: Literal["running", "finished"]
    model: str
    resolution: tuple[int, int]
    classes: tuple[str, ...]
    budget: int
    seed: int
    effective_batch: int
    batch: int
    accumulate: int
    steps: int
    masks: bool | None = None  # not in the first runs
    sources: dict[str, RunSource]
    device: str
    python: str
    versions: dict[str, str]
    figures: RunFigures


def read_run(folder: Path) -> Run:
    """Read run.json of a run folder."""
    refuse = partial(HulldownError, path=folder / RUN_NAME, remedy="name a folder of `hulldown train`")
    return read_json(folder / RUN_NAME, Run, refuse, what="a hulldown run")


def find_weights(path: Path) -> Path:
    """Return the weights of a finished run, a file or a folder; return other paths unchanged."""
    if not path.is_dir() or (path / TRANSFORMERS_FILES[-1]).exists():
        return path
    if not (path / RUN_NAME).exists():
        remedy = "name a folder of `hulldown train`"
        raise HulldownError(f"is {describe_path(path)}, not a run", path=path, remedy=remedy)
    if read_run(path).status != "finished":
        problem, remedy = "training is running, not finished", "run the same `hulldown train` again"
        raise HulldownError(problem, path=path, remedy=remedy)
    folder = path / WEIGHTS_FOLDER
    return folder if folder.exists() else path / WEIGHTS_NAME


def weights_digest(path: Path) -> str:
    """Return the SHA-256 of the weights of a run, of a file, or of the tensors in a folder."""
    weights = find_weights(path)
    return file_sha256(weights / TRANSFORMERS_FILES[-1] if weights.is_dir() else weights)


def read_detr_weights(path: Path) -> dict[str, object]:
    """Read a weights file of RF-DETR; code in it is refused, not run."""
    refuse = partial(HulldownError, path=path, remedy=_REMEDY)
    try:
        with open_regular_file(path) as file:
            head = file.read(16)
            found = load_tensors(file)
    except FileNotFoundError:
        raise refuse("no such run folder or checkpoint") from None
    except DAMAGE_ERRORS as error:  # its text advises loading code
        kind = f"unreadable ({error.strerror})" if isinstance(error, OSError) else _guess_file_kind(path, head)
        raise refuse(f"is {kind}, not the weights of a detector") from None
    if not isinstance(found, dict):
        raise refuse("is a PyTorch file, but not the weights of a detector")
    return found


def load_tensors(file: BinaryIO) -> object:
    """Load an opened PyTorch file, which must be a regular one; code in it is refused."""
    import torch

    file.seek(0)
    if zipfile.is_zipfile(file):
        with zipfile.ZipFile(file) as parts:
            if any(part.compress_type != zipfile.ZIP_STORED for part in parts.infolist()):
                raise ValueError("its parts are compressed")
    file.seek(0)
    with warnings.catch_warnings(), torch.serialization.safe_globals([argparse.Namespace, types.SimpleNamespace]):
        warnings.filterwarnings("ignore", "Detected pickle protocol")  # of a file that happens to begin like one
        return torch.load(file, map_location="cpu", weights_only=True)


def refuse_nonfinite_weights(network: torch.nn.Module, path: Path) -> None:
    """Refuse weights that aren't finite."""
    for name, tensor in network.state_dict().items():
        if tensor.is_floating_point() and not bool(tensor.isfinite().all()):
            raise HulldownError(f"{name} has values that aren't finite", path=path, remedy="name other weights")


def _guess_file_kind(path: Path, head: bytes) -> str:
    """Guess the kind of a file that can't be loaded from its first bytes."""
    for start, kind in _WEIGHT_KINDS.items():
        if head.startswith(start):
            return kind
    if path.suffix.lower() in (".onnx", ".safetensors"):
        return f"of the kind {path.suffix.lower()}"
    return "empty" if not head else "damaged or of an unknown kind"


def first_error_line(error: BaseException) -> str:
    """Return the first line of an error's text."""
    return str(error).strip().split("\n")[0][:200] or type(error).__name__


def usable_torch_device(device: str) -> Any:
    """Return the device that the user named."""
    import torch

    device = {"gpu": "cuda"}.get(device, device)
    if device == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        chosen = torch.device(device)
        torch.empty(0, device=chosen)
    except (RuntimeError, AssertionError) as error:
        raise HulldownError(
            f"device {device!r} cannot be used ({first_error_line(error)})", remedy="name auto or cpu"
        ) from None
    return chosen
