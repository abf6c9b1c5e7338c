"""Find the pictures for a detector: a dataset's, of folders and patterns, or a video's frames.

FFmpeg reads one regular file of a listed container and codec. Its readers of these containers open nothing else. Those
of playlists (HLS, DASH, SDP, concat) would, and recognize a file by its beginning too.
"""

from __future__ import annotations

import glob
import os
import warnings
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import UInt8

from hulldown.annotate.records import Image
from hulldown.assets.picture_files import read_picture, read_pixels
from hulldown.base.errors import DatasetError
from hulldown.base.files import open_regular_file
from hulldown.base.outside import describe_path
from hulldown.dataset.foreign_labels import PICTURE_SUFFIXES, foreign_reader
from hulldown.dataset.store.document import COCO_NAME, is_hulldown_dataset
from hulldown.training.evaluation.labels import Labels, read_labels

if TYPE_CHECKING:
    import cv2


READER_THREADS = 2
PICTURES_AHEAD = 16
Picture = UInt8[np.ndarray, "h w 3"]
VIDEO_SUFFIXES = (".avi", ".m4v", ".mkv", ".mov", ".mp4", ".webm")
# Where bytes of a container are in a file, and these bytes: MP4 and QuickTime, Matroska and WebM, AVI.
VIDEO_CONTAINERS = ((4, (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")), (0, (b"\x1a\x45\xdf\xa3",)), (8, (b"AVI ",)))
# Names of codecs in files, in lower case.
VIDEO_CODECS = {"avc1", "avc3", "h264", "x264", "hevc", "hev1", "hvc1", "av01", "vp80", "vp90", "vp09", "mp4v", "fmp4",
          "xvid", "dx50", "divx", "mpg4", "mjpg", "jpeg", "ffv1", "apcn", "apch", "apcs", "apco", "ap4h"}  # fmt: skip
MAX_FRAME_PIXELS = 1 << 27
_REMEDY = "convert it to MP4 (H.264)"


@dataclass(frozen=True, eq=False, slots=True)
class Pictures:
    """Pictures in a fixed order."""

    path: Path  # the user's path, for errors
    folder: Path  # folder that file names are relative to
    images: Sequence[Image]  # the pictures; records of a video's have ``frame``, from 0
    category_ids: Mapping[str, int]  # id of each class's name, of a dataset; empty otherwise
    video: Video | None = None  # the video at `path` whose frames they are, if there is one

    @classmethod
    def from_labels(cls, labels: Labels) -> Pictures:
        """Return a dataset's pictures."""
        ids = dict(zip(labels.class_names, labels.class_id.tolist(), strict=True))
        return cls(labels.path, labels.folder, labels.images, ids)

    def read(self, indices: Sequence[int]) -> Iterator[Picture]:
        """Yield RGB pictures, (h, w, 3), at ascending indices."""
        yield from read_frames(self.path, indices) if self.video else self._read_files(indices)

    def _read_files(self, indices: Sequence[int]) -> Iterator[Picture]:
        def read(k: int) -> Picture:
            return read_pixels(self.folder / self.images[k].file_name, self.images[k].size)

        coming: deque[Future[Picture]] = deque()
        with ThreadPoolExecutor(READER_THREADS) as pool:
            for k in indices:
                coming.append(pool.submit(read, k))
                if len(coming) > PICTURES_AHEAD:
                    yield coming.popleft().result()
            while coming:
                yield coming.popleft().result()


def find_pictures(paths: Sequence[str | os.PathLike[str]]) -> Pictures:
    """Find the pictures at the user's paths: a dataset, folders, files, and patterns such as photographs/*.jpg."""
    first = Path(paths[0])
    if len(paths) == 1 and _has_records(first):
        return Pictures.from_labels(read_labels(first))
    if len(paths) == 1 and first.suffix.lower() in VIDEO_SUFFIXES:
        video = probe_video(first)
        record = {"file_name": first.name, "width": video.width, "height": video.height}
        frames = [Image.from_record({"id": k + 1, "frame": k, **record}, ()) for k in range(video.frames)]
        return Pictures(first, first.parent, frames, {}, video)
    files = sorted({file.absolute() for path in paths for file in _list_picture_files(str(path))})
    folder = Path(os.path.commonpath([file.parent for file in files]))
    images = []
    for number, file in enumerate(files, 1):
        width, height = read_picture(file, largest=0).size
        name = file.relative_to(folder).as_posix()
        images.append(Image.from_record({"id": number, "file_name": name, "width": width, "height": height}, ()))
    return Pictures(first, folder, images, {})


def _has_records(path: Path) -> bool:
    if path.suffix == ".json" or is_hulldown_dataset(path) or (path / COCO_NAME).exists():
        return True
    return path.is_dir() and foreign_reader(path) is not None


def _list_picture_files(path: str) -> list[Path]:
    if os.path.isdir(path):
        found = [file for file in Path(path).rglob("*") if file.suffix.lower() in PICTURE_SUFFIXES and file.is_file()]
    elif os.path.exists(path):
        found = [Path(path)]
    else:
        found = [Path(name) for name in glob.glob(path, recursive=True) if name.lower().endswith(PICTURE_SUFFIXES)]
    if not found:
        here = f": it is {describe_path(Path(path))}" if os.path.exists(path) else ""
        raise DatasetError(
            f"no pictures here{here}", path=path, remedy=f"name a dataset, a video, or {', '.join(PICTURE_SUFFIXES)}"
        )
    if strange := [file for file in found if file.suffix.lower() not in PICTURE_SUFFIXES]:
        remedy = "name one video by itself" if strange[0].suffix.lower() in VIDEO_SUFFIXES else "name a picture or a folder"
        raise DatasetError(f"is no picture ({', '.join(PICTURE_SUFFIXES)})", path=strange[0], remedy=remedy)
    return found


# Read by OpenCV at its first video; FFmpeg's messages would fill the terminal.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")


class Video(NamedTuple):
    """A video's width and height in pixels, frames that can be decoded, and frames per second."""

    width: int
    height: int
    frames: int
    fps: float


def probe_video(path: Path) -> Video:
    """Decode a video to count its frames; a warning names those that are lost."""
    import cv2

    with _open_video(path) as video:
        width, height, stated = (
            int(video.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT, cv2.CAP_PROP_FRAME_COUNT)
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
    with DatasetError.replace_os_errors("cannot be read", path=path, remedy="name a video"), open_regular_file(path) as file:
        start = file.read(64)
        if not any(start.startswith(begins, at) for at, begins in VIDEO_CONTAINERS):
            raise DatasetError(f"isn't a video ({', '.join(VIDEO_SUFFIXES)})", path=path, remedy=_REMEDY)
        # By its descriptor, since FFmpeg takes the beginnings of some names for protocols.
        video = cv2.VideoCapture(f"/dev/fd/{file.fileno()}", cv2.CAP_FFMPEG)
        if not video.isOpened():
            raise DatasetError("cannot be read as a video", path=path, remedy=_REMEDY)
        codec = int(video.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True).decode("ascii", "replace")
        if codec.lower() not in VIDEO_CODECS:
            raise DatasetError(f"has the codec {codec!r}, which isn't read", path=path, remedy=_REMEDY)
        if video.get(cv2.CAP_PROP_FRAME_WIDTH) * video.get(cv2.CAP_PROP_FRAME_HEIGHT) > MAX_FRAME_PIXELS:
            raise DatasetError(f"has frames of more than {MAX_FRAME_PIXELS >> 20} megapixels", path=path, remedy=_REMEDY)
        yield video
