"""Find the pictures for a detector: a dataset's, of folders and patterns, or a video's frames."""

from __future__ import annotations

import glob
import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from hulldown.annotate.records import Image
from hulldown.assets.picture_files import read_picture, read_pixels
from hulldown.base.errors import DatasetError
from hulldown.dataset.foreign_labels import PICTURES, foreign_reader
from hulldown.dataset.store.document import COCO_NAME, is_own
from hulldown.training.evaluation.labels import Labels, read_labels
from hulldown.training.videos import VIDEOS, Video, read_frames, read_video

READER_THREADS = 2  # threads
PICTURES_AHEAD = 16  # pictures that are read in advance
Picture = UInt8[np.ndarray, "h w 3"]


@dataclass(frozen=True, eq=False, slots=True)
class Pictures:
    """Pictures in a fixed order."""

    path: Path  # the user's path, for errors
    folder: Path  # folder that file names are relative to
    images: Sequence[Image]  # the pictures; records of a video's have ``frame``, from 0
    category_ids: Mapping[str, int]  # id of each class's name, of a dataset; empty otherwise
    video: Video | None = None  # the video at `path` whose frames they are, if there is one

    @classmethod
    def of(cls, labels: Labels) -> Pictures:
        """Return a dataset's pictures."""
        ids = dict(zip(labels.class_names, labels.class_id.tolist(), strict=True))
        return cls(labels.path, labels.folder, labels.images, ids)

    def read(self, indices: Sequence[int]) -> Iterator[Picture]:
        """Yield RGB pictures, (h, w, 3), at ascending indices."""
        yield from read_frames(self.path, indices) if self.video else self._files(indices)

    def _files(self, indices: Sequence[int]) -> Iterator[Picture]:
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
        return Pictures.of(read_labels(first))
    if len(paths) == 1 and first.suffix.lower() in VIDEOS:
        video = read_video(first)
        record = {"file_name": first.name, "width": video.width, "height": video.height}
        frames = [Image.of({"id": k + 1, "frame": k, **record}, ()) for k in range(video.frames)]
        return Pictures(first, first.parent, frames, {}, video)
    files = sorted({file.absolute() for path in paths for file in _list_files(str(path))})
    folder = Path(os.path.commonpath([file.parent for file in files]))
    images = []
    for number, file in enumerate(files, 1):
        width, height = read_picture(file, largest=0).size
        name = file.relative_to(folder).as_posix()
        images.append(Image.of({"id": number, "file_name": name, "width": width, "height": height}, ()))
    return Pictures(first, folder, images, {})


def _has_records(path: Path) -> bool:
    if path.suffix == ".json" or is_own(path) or (path / COCO_NAME).exists():
        return True
    return path.is_dir() and foreign_reader(path) is not None


def _list_files(path: str) -> list[Path]:
    if os.path.isdir(path):
        found = [file for file in Path(path).rglob("*") if file.suffix.lower() in PICTURES and file.is_file()]
    elif os.path.exists(path):
        found = [Path(path)]
    else:
        found = [Path(name) for name in glob.glob(path, recursive=True) if name.lower().endswith(PICTURES)]
    if not found:
        raise DatasetError("no pictures here", path=path, remedy=f"name a dataset, a video, or {', '.join(PICTURES)}")
    if strange := [file for file in found if file.suffix.lower() not in PICTURES]:
        remedy = "name one video by itself" if strange[0].suffix.lower() in VIDEOS else "name a picture or a folder"
        raise DatasetError(f"is no picture ({', '.join(PICTURES)})", path=strange[0], remedy=remedy)
    return found
