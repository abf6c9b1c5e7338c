"""Join datasets, such as shares of a plan: pictures are placed, then recorded; a killed join continues."""

from __future__ import annotations

import filecmp
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from msgspec.structs import replace

from hulldown.annotate.coco_types import Record
from hulldown.base.arguments import AnyPath
from hulldown.base.errors import DatasetError
from hulldown.base.terminal import progress_bar
from hulldown.dataset.coco import CocoDataset
from hulldown.dataset.provenance import (
    Failure,
    Provenance,
    add_provenance,
    read_failures,
    read_provenance_by_plan,
    write_failures,
)
from hulldown.dataset.record_checks import refuse_unusable_records
from hulldown.dataset.store.document import Document, read_document, require_hulldown_dataset
from hulldown.dataset.store.placed_pictures import link_or_copy_picture, require_path_inside, resolve_own_picture
from hulldown.dataset.store.reservations import Reservation


@dataclass(frozen=True, slots=True)
class Joined:
    """Numbers of images that joining added and didn't add."""

    added: int
    already: int  # number of the parts' images that were in the dataset before
    failed: int  # number of failed images of parts that aren't in the dataset
    missing: int  # number of the plans' images that are in no part yet, failed ones included


@dataclass(frozen=True, eq=False, slots=True)
class _Part:
    """A dataset to be joined, with its annotations' indices by image id."""

    folder: Path
    document: Document
    boxes: dict[int, list[int]]
    provenance: dict[str, Provenance]
    failures: list[Failure]

    def reserve_in_target(self, target: CocoDataset) -> list[tuple[Reservation, Reservation]]:
        """Return each plan's run here, and in the target, which reserves one if it has none."""
        reservations = self.document.reservations.values()
        return [(own, target.reserve_ids(own.key, images=own.images, annotations=own.annotations)) for own in reservations]


@dataclass(frozen=True, slots=True)
class _Move:
    """An image of a part, its new name, and for a planned one its id and the reservations of part and dataset."""

    part: _Part
    index: int
    old_name: str
    name: str
    image_id: int | None = None
    reservations: tuple[Reservation, Reservation] | None = None

    @property
    def picture(self) -> Path:
        return self.part.folder / self.old_name


def join_datasets(
    parts: Sequence[AnyPath],
    output: AnyPath,
    *,
    allow_links: Sequence[AnyPath] = (),
    progress: Callable[[int, int], None] | None = None,
) -> Joined:
    """Put parts of a dataset together.

    Reads datasets, such as the shares of a plan from several machines; appends their images that a dataset lacks, a
    plan's as if rendered there. Join again when there are more images, or to continue after a stop.

    Parameters
    ----------
    parts
        Folders of datasets, possibly unfinished; they're unchanged.
    output
        The target; made if it doesn't exist. Pictures are hard links to those of the parts if the disk allows.
    allow_links
        Folder outside the parts that symbolic links may lead to; may be repeated.
    progress
        Called with (done, all) after each added image; None: a bar in a terminal or notebook.

    Raises
    ------
    DatasetError
        If a part is unusable, a picture is a link that leads elsewhere, or two different images have the same name
        or id; the dataset is unchanged then.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from hulldown.dataset.coco import CocoDataset
    >>> part, whole = Path(mkdtemp()), mkdtemp()
    >>> with CocoDataset.open(part, categories=["truck"]) as dataset:
    ...     (part / "1.jpg").touch()
    ...     _ = dataset.append({"file_name": "1.jpg", "width": 640, "height": 480}, [])
    >>> join_datasets([part], whole)
    Joined(added=1, already=0, failed=0, missing=0)
    """
    folder = Path(output)
    allowed = [Path(path) for path in allow_links]
    read = [_read_part(Path(part), folder, allowed) for part in parts]
    target = CocoDataset.open(folder, inputs=map(Path, parts))
    try:
        for part in read:
            target.add_categories(part.document.categories)
        moves = [move for part in read for move in _part_moves(part, target)]
        # If two parts have an image, the first part's is used.
        new = {move.name: move for move in reversed(moves) if not target.finished(move.name)}
        left = [move for move in moves if new.get(move.name) is move]
        for parent in sorted({str(PurePosixPath(move.name).parent) for move in left}):
            require_path_inside(folder, parent)
        _refuse_conflicting_images(moves, target)
        _refuse_unappendable_moves(left, target)
        failures = _latest_failures_by_name(read, target)
        read_provenance_by_plan(folder)  # damage is found before anything is added
    except BaseException:
        target.undo_open()
        raise
    with target, progress_bar("joining", progress) as advance:
        for done, move in enumerate(left, start=1):
            link_or_copy_picture(resolve_own_picture(move.part.folder, move.old_name, allowed), folder, move.name)
            target.append(*_moved_image_and_labels(move))
            advance(done, len(left))
        for part in read:
            plans = [now for _, now in part.reserve_in_target(target) if now.key in part.provenance]
            made = {now.key: replace(part.provenance[now.key], first_image_id=now.image_offset + 1) for now in plans}
            add_provenance(folder, made)
        unmade = [failure for name, failure in sorted(failures.items()) if not target.finished(name)]
        write_failures(folder, unmade)
        return Joined(len(left), len(moves) - len(left), len(unmade), target.missing())


def _read_part(folder: Path, target: Path, allowed: Sequence[Path]) -> _Part:
    """Read a part for the dataset in `target`; refuse it if records would be lost."""
    require_hulldown_dataset(folder)
    if target.exists() and folder.samefile(target):
        raise DatasetError("is a part of itself", path=folder, remedy="name the other parts only")
    document = read_document(folder)
    for key, value in document.head.items():
        if key != "info" and value:
            raise DatasetError(
                f"has {key!r}, which joining would lose", path=folder, remedy="join the other parts into this one"
            )
    images, annotations = document.images, document.annotations
    refuse_unusable_records(folder, document.categories, images, annotations)
    if len(document.file_names) < len(images):
        raise DatasetError("file names aren't unique", path=folder, remedy="check it with `hulldown verify`")
    boxes: dict[int, list[int]] = {}
    for i, record in enumerate(annotations):
        boxes.setdefault(record["image_id"], []).append(i)
    for name in sorted(document.file_names):
        resolve_own_picture(folder, name, allowed)
    return _Part(folder, document, boxes, read_provenance_by_plan(folder), read_failures(folder))


def _latest_failures_by_name(parts: Sequence[_Part], target: CocoDataset) -> dict[str, Failure]:
    latest = {failure.file_name: failure for failure in read_failures(target.folder)}
    for part in parts:
        reservations = part.reserve_in_target(target)
        for failure in part.failures:
            name = failure.file_name  # failed images have no id
            own = [(was, now) for was, now in reservations if PurePosixPath(name).name.startswith(was.prefix)]
            if own:
                was, now = max(own, key=lambda pair: len(pair[0].prefix))
                name = now.dataset_file_name(was.planned(name))
            latest[name] = replace(failure, file_name=name)
    return latest


def _part_moves(part: _Part, target: CocoDataset) -> Iterator[_Move]:
    reservations = part.reserve_in_target(target)
    for index, record in enumerate(part.document.images):
        image_id, old = record["id"], record["file_name"]
        own = next((pair for pair in reservations if pair[0].owns_image(image_id, old)), None)
        if own is None:
            yield _Move(part, index, old, old)
        else:
            was, now = own
            new_id = image_id - was.image_offset + now.image_offset
            yield _Move(part, index, old, now.dataset_file_name(was.planned(old)), new_id, own)


def _refuse_conflicting_images(moves: Sequence[_Move], target: CocoDataset) -> None:
    """Refuse different images with the same id (planned ones) or name (others), of which one would be lost."""
    names, ids = {move.name for move in moves}, {move.image_id for move in moves} - {None}
    by_name: dict[str, tuple[int | None, Path]] = {}
    by_id: dict[int, tuple[str, Path]] = {}
    for image_id, name in target.images():
        if name in names:
            by_name[name] = image_id, target.folder / name
        if image_id in ids:
            by_id[image_id] = name, target.folder / name
    for move in moves:
        picture, there = move.picture, target.folder / move.name
        if move.image_id is not None:
            name, first_picture = by_id.setdefault(move.image_id, (move.name, picture))
            if name != move.name:
                raise DatasetError(
                    f"has the id {move.image_id}, as has {first_picture}",
                    path=picture,
                    remedy="give the one that is not of the plan another id",
                )
        stray = move.image_id is None and there.exists()
        its_id, first_picture = by_name.setdefault(move.name, (move.image_id, there if stray else picture))
        same = its_id is not None and its_id == move.image_id  # the same planned image
        same = same or not first_picture.exists() or first_picture.samefile(picture)
        if not same and not filecmp.cmp(first_picture, picture, shallow=False):
            which = "one of them" if move.image_id is None and its_id not in ids else "the one of no plan"
            remedy = f"give {which} another name"
            raise DatasetError(f"is another picture than {first_picture}", path=picture, remedy=remedy)


def _refuse_unappendable_moves(moves: Sequence[_Move], target: CocoDataset) -> None:
    claimed: set[int] = set()
    for move in moves:
        image, boxes = _moved_image_and_labels(move)
        try:
            target.require_appendable(image, boxes)
        except ValueError as error:
            problem = f"{move.old_name}: {error}"
            raise DatasetError(problem, path=move.part.folder, remedy="check both with `hulldown verify`") from error
        ids = {box["id"] for box in boxes if "id" in box}
        if repeated := ids & claimed:
            problem = f"annotation {min(repeated)} is on another image too"
            raise DatasetError(problem, path=move.picture, remedy="give it another id")
        claimed |= ids


def _moved_image_and_labels(move: _Move) -> tuple[Record, Sequence[Record]]:
    document = move.part.document
    names = {category["id"]: category["name"] for category in document.categories}
    image = document.images[move.index]
    labels = []
    for i in move.part.boxes.get(image["id"], ()):
        label = document.annotations[i]
        new = {key: value for key, value in label.items() if key not in ("id", "image_id", "category_id")}
        new["category"] = names[label["category_id"]]
        if move.reservations is not None and move.reservations[0].has_annotation_id(label["id"]):
            new["id"] = label["id"] + move.reservations[1].annotation_offset - move.reservations[0].annotation_offset
        labels.append(new)
    ids = {} if move.image_id is None else {"id": move.image_id}
    return {**{key: value for key, value in image.items() if key != "id"}, **ids, "file_name": move.name}, labels
