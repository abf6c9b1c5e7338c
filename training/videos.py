"""Frames of videos. FFmpeg reads one regular file of a listed container and codec.

Its readers of these containers open nothing else. Those of playlists (HLS, DASH, SDP, concat) would, and recognize a
file by its beginning too.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import UInt8

from hulldown.base.errors import DatasetError
from hulldown.base.files import open_regular

if TYPE_CHECKING:
    import cv2

# Read by OpenCV at its first video; FFmpeg's messages would fill the terminal.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
VIDEOS = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".webm")
# Where bytes of a container are in a file, and these bytes: MP4 and QuickTime, Matroska and WebM, AVI.
CONTAINERS = (
    (4, (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")),
    (0, (b"\x1a\x45\xdf\xa3",)),
    (8, (b"AVI ",)),
)
# Names of codecs in files, in lower case.
CODECS = {"avc1", "avc3", "h264", "x264", "hevc", "hev1", "hvc1", "av01", "vp80", "vp90", "vp09", "mp4v", "fmp4",
          "xvid", "dx50", "divx", "mpg4", "mjpg", "jpeg", "ffv1", "apcn", "apch", "apcs", "apco", "ap4h"}  # fmt: skip
MAX_FRAME_PIXELS = 1 << 27  # pixels of a frame
_REMEDY = "convert it to MP4 (H.264)"


class Video(NamedTuple):
    """Width and height in pixels, frames that can be decoded, and frames per second."""

    width: int
    height: int
    frames: int
    fps: float


def read_video(path: Path) -> Video:
    """Decode a video to count its frames; a warning names those that are lost."""
    import cv2

    with _open_video(path) as video:
        width, height, stated = (
            int(video.get(key))
            for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_COUNT)
        )
        frames = sum(1 for _ in iter(video.grab, False))  # a file's own count may be an estimate
        if not frames:
            raise DatasetError("has no frame that can be decoded", path=path, remedy=_REMEDY)
        if frames < stated:
            warnings.warn(
                f"{path}: is damaged: {frames} frames were read, {stated - frames} of {stated} are lost", stacklevel=2
            )
        return Video(width, height, frames, float(video.get(cv2.CAP_PROP_FPS)))


def read_frames(path: Path, indices: Sequence[int]) -> Iterator[UInt8[np.ndarray, "h w 3"]]:
    """Yield a video's RGB frames at ascending indices."""
    import cv2

    wanted = set(indices)
    with _open_video(path) as video:
        for k in range(max(wanted, default=-1) + 1):
            if not video.grab():
                raise DatasetError(f"frame {k} cannot be decoded", path=path, remedy=_REMEDY)
            if k in wanted:
                yield cv2.cvtColor(video.retrieve()[1], cv2.COLOR_BGR2RGB)


@contextmanager
def _open_video(path: Path) -> Iterator[cv2.VideoCapture]:
    import cv2

    quiet = vars(cv2).get("setLogLevel") or vars(cv2.utils)["logging"].setLogLevel  # moved in OpenCV 4.14
    quiet(0)
    with DatasetError.raise_for_system("cannot be read", path=path, remedy="name a video"), open_regular(path) as file:
        start = file.read(64)
        if not any(start.startswith(begins, at) for at, begins in CONTAINERS):
            raise DatasetError(f"isn't a video ({', '.join(VIDEOS)})", path=path, remedy=_REMEDY)
        # By its descriptor, since FFmpeg takes the beginnings of some names for protocols.
        video = cv2.VideoCapture(f"/dev/fd/{file.fileno()}", cv2.CAP_FFMPEG)
        if not video.isOpened():
            raise DatasetError("cannot be read as a video", path=path, remedy=_REMEDY)
        codec = int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True).decode("ascii", "replace")
        if codec.lower() not in CODECS:
            raise DatasetError(f"has the codec {codec!r}, which isn't read", path=path, remedy=_REMEDY)
        if video.get(cv2.CAP_PROP_FRAME_WIDTH) * video.get(cv2.CAP_PROP_FRAME_HEIGHT) > MAX_FRAME_PIXELS:
            raise DatasetError(
                f"has frames of more than {MAX_FRAME_PIXELS >> 20} megapixels", path=path, remedy=_REMEDY
            )
        yield video
