"""Parts put together: what several machines have rendered of a plan, or any datasets, appended to one.

An image is placed first and recorded then, each in one step, as in rendering: a join that is killed goes on where it
was, and one that is repeated adds what has come since.
"""

from __future__ import annotations

import filecmp
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import orjson

from annotate.coco import CocoDataset
from annotate.failures import read_failures, write_failures
from annotate.part import Part, loaded, read_part
from annotate.placing import check_confined, place
from annotate.provenance import add_provenance
from annotate.runs import Run
from geometry.errors import DatasetError


@dataclass(frozen=True, slots=True)
class Joined:
    """What joining did.

    Parameters
    ----------
    added
        Images that were appended.
    already
        Images of the parts that were in the dataset before.
    failed
        Images that a part has given up and that are not in the dataset.
    missing
        Images of the plans that are in no part yet, those given up included.
    """

    added: int
    already: int
    failed: int
    missing: int


@dataclass(frozen=True, slots=True)
class _Move:
    """An image of a part, the name it gets, and the run of the part and of the dataset that it belongs to, if any."""

    part: Part
    index: int
    old_name: str
    name: str
    runs: tuple[Run, Run] | None


def join(
    parts: Sequence[Path | str],
    dataset: Path | str,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Joined:
    """Append the images of `parts` that a dataset does not have; those of one plan as if it had rendered them itself.

    Parameters
    ----------
    parts
        Folders of datasets, read as far as they have got. They stay as they are.
    dataset
        Where to; made if it does not exist. Pictures are hard links to those of the parts where the disk allows.
    progress
        Told (done, all) after each image that is added.

    Raises
    ------
    DatasetError
        If a part cannot be used, or two different pictures have one name; the dataset is then as it was.
    """
    folder = Path(dataset)
    read = [read_part(Path(part), folder) for part in parts]
    target = CocoDataset.open(folder)
    try:
        for part in read:
            target.add_categories(part.document.categories)
        moves = list(_moves(read, target))
        # Of an image that two parts have, the first is taken.
        new = {move.name: move for move in reversed(moves) if not target.finished(move.name)}
        left = [move for move in moves if new.get(move.name) is move]
        check_confined(folder, (move.name for move in left))
        _refuse_other_pictures(moves, target)
    except BaseException:
        target.abandon()
        raise
    with target:
        for done, move in enumerate(left, start=1):
            place(move.part.folder / move.old_name, folder, move.name)
            _append(move, target)
            if progress is not None:
                progress(done, len(left))
        unmade = _carry_over(read, target)
        return Joined(len(left), len(moves) - len(left), len(unmade), target.missing())


def _carry_over(parts: Sequence[Part], target: CocoDataset) -> list[dict[str, Any]]:
    """Add what the parts say of their making, and their failures, to those of the dataset; returns the failures."""
    latest = {line["file_name"]: line for line in read_failures(target.folder)}
    for part in parts:
        mine = {key: _in(target, run) for key, run in part.document.runs.items()}
        entries = {key: entry for key, entry in part.provenance.items() if key in mine}
        add_provenance(
            target.folder, {key: {**e, "first_image_id": mine[key].image_offset + 1} for key, e in entries.items()}
        )
        for line in part.failures:
            name = _new_name(part, mine, line["file_name"])
            latest[name] = {**line, "file_name": name}
    unmade = [line for name, line in sorted(latest.items()) if not target.finished(name)]
    write_failures(target.folder, unmade)
    return unmade


def _in(target: CocoDataset, run: Run) -> Run:
    """What the dataset has set aside for a part's plan."""
    return target.run(run.key, images=run.images, annotations=run.annotations)


def _moves(parts: Sequence[Part], target: CocoDataset) -> Iterator[_Move]:
    for part in parts:
        runs = [(run, _in(target, run)) for run in part.document.runs.values()]
        for index, (image_id, record) in enumerate(part.document.images):
            old = orjson.loads(record)["file_name"]
            mine = next((pair for pair in runs if pair[0].has_image(image_id)), None)
            name = old if mine is None else mine[1].file_name(mine[0].planned(old))
            yield _Move(part, index, old, name, mine)


def _refuse_other_pictures(moves: Sequence[_Move], target: CocoDataset) -> None:
    """An image of no plan is known by its name alone: another picture of that name is another image."""
    pictures: dict[str, Path] = {}
    for move in moves:
        picture = move.part.folder / move.old_name
        there = target.folder / move.name
        other = pictures.setdefault(move.name, there if there.exists() else picture)
        if move.runs is None and not other.samefile(picture) and not filecmp.cmp(other, picture, shallow=False):
            raise DatasetError(f"is another picture than {other}", path=picture, remedy="give one of them another name")


def _append(move: _Move, target: CocoDataset) -> None:
    document = move.part.document
    image = loaded(document.images[move.index])
    boxes = [loaded(document.annotations[i]) for i in move.part.boxes.get(image["id"], ())]
    names = {category["id"]: category["name"] for category in document.categories}
    if move.runs is None:
        del image["id"]
    else:
        image["id"] += move.runs[1].image_offset - move.runs[0].image_offset
    for box in boxes:
        box["category"] = names[box.pop("category_id")]
        del box["image_id"]
        if move.runs is None or not move.runs[0].has_annotation(box["id"]):
            del box["id"]
        else:
            box["id"] += move.runs[1].annotation_offset - move.runs[0].annotation_offset
    try:
        target.append({**image, "file_name": move.name}, boxes)
    except ValueError as error:
        raise DatasetError(
            f"{move.old_name}: {error}", path=move.part.folder, remedy="check both with `hulldown verify`"
        ) from error


def _new_name(part: Part, mine: Mapping[str, Run], name: str) -> str:
    """The dataset's name for an image that a part has given up, and that has no id."""
    runs = sorted(part.document.runs.values(), key=lambda run: -len(run.prefix))
    run = next((run for run in runs if PurePosixPath(name).name.startswith(run.prefix)), None)
    return name if run is None else mine[run.key].file_name(run.planned(name))
