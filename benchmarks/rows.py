"""Rows of a plan as typed records: writing, reading and memory, by msgspec, pydantic, and dataclasses with orjson."""

from __future__ import annotations

import multiprocessing
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import make_dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np
import orjson
import pydantic

from geometry.transforms import rigid, rotation_z
from planning.row import Bounds, Box, PlannedVehicle, Row, decode_row, encode, picture_name, rounded
from planning.weather import Weather

CHUNK = 20_000  # rows made before the clock runs
HELD = 50_000  # rows held in memory at most
FRESH = 100  # different rows; numbers of others are taken from these


class Way(NamedTuple):
    """How rows can be kept: from our rows to its records, to lines and back."""

    take: Callable[[Row], Any]
    write: Callable[[Any], bytes]
    read: Callable[[bytes], Any]


def _rows() -> Iterator[Row]:
    """Rows like those of a planner, with one companion each."""
    rng = np.random.default_rng(0)
    made = []
    for i in range(FRESH):
        poses = rounded(
            "world_from_camera", rigid(rotation_z(rng.uniform(-3, 3, 3)), rng.normal(scale=100, size=(3, 3)))
        )
        boxes = [Box(*xywh) for xywh in rounded("bbox", rng.uniform(1, 900, (2, 4))).tolist()]
        shares = rounded("visible_fraction", rng.random((2, 2))).tolist()
        numbers = rounded("gap", rng.random(12)).tolist()
        turned = {"turret": numbers[0], "gun": numbers[1]}
        vehicles = [
            {
                "vehicle": "t72", "category": "tank", "world_from_vehicle": poses[k], "articulation": turned,
                "bbox": boxes[k], "bbox_amodal": boxes[k], "visible_fraction": shares[k][0],
                "truncated_fraction": shares[k][1], "slope_deg": numbers[2], "gap": numbers[3],
                "penetration": numbers[4], "tries": 3, "label": "full", "paint": [], "air_contrast": 0.9,
                "bounds": Bounds((-3.0, -1.5, 0.0), (3.0, 1.5, 2.5)),
            }
            for k in range(2)
        ]  # fmt: skip
        made.append(
            Row(
                **vehicles[0], index=i, image_id=i + 1, file_name=picture_name(i), scenery="hills", position=i, shot=0,
                world_from_camera=poses[2], fov_x_deg=50 + numbers[5], width=1920, height=1080, hdri="noon",
                hdri_yaw_deg=numbers[6], strength=numbers[7], weather=Weather(300 + numbers[8], "fog"),
                horizon_deg=None, exposure_ev=0.5, white_balance_k=0.0, background=False, sample_seed=i,
                companions=[PlannedVehicle(**vehicles[1])], distractors=[],
                rejected={"too_steep": 2, "hidden": 1}, left_out=0,
            )
        )  # fmt: skip
    while True:
        yield from made


def _plain(hint: Any, *, limits: bool) -> Any:
    """A declared kind in the words of the standard library, with its limits as pydantic's if they are wanted."""
    if get_origin(hint) is Annotated:
        base, *metas = get_args(hint)
        known = {
            key: getattr(meta, key)
            for meta in metas
            for key in ("ge", "gt", "le", "lt", "pattern", "max_length")
            if getattr(meta, key) is not None
        }
        known.pop("pattern", None)  # pydantic's engine has no look-ahead
        kind = _plain(base, limits=limits)
        return Annotated[kind, pydantic.Field(**known)] if limits and known else kind
    if hint is np.ndarray:
        return Annotated[Any, pydantic.BeforeValidator(np.array), pydantic.PlainSerializer(np.ndarray.tolist)]
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        return _model(hint)
    if hint is Box:
        return tuple[float, float, float, float]
    if get_origin(hint) in (list, dict):
        return get_origin(hint)[tuple(_plain(one, limits=limits) for one in get_args(hint))]
    if args := get_args(hint):
        return Union[tuple(_plain(one, limits=limits) for one in args)]  # noqa: UP007 (`|` takes no tuple)
    return hint


def _model(kind: type[msgspec.Struct]) -> Any:
    fields = {
        name: (_plain(hint, limits=True), ...) for name, hint in get_type_hints(kind, include_extras=True).items()
    }
    return pydantic.create_model(kind.__name__, __config__={"arbitrary_types_allowed": True, "strict": False}, **fields)


def _ways() -> dict[str, Way]:
    model = _model(Row)
    record = make_dataclass("Record", Row.__struct_fields__, slots=True, frozen=True)
    poses = ("world_from_vehicle", "world_from_camera")

    def arrays(values: dict[str, Any]) -> dict[str, Any]:
        return {key: np.array(value) if key in poses else value for key, value in values.items()}

    return {
        "dictionaries and orjson, unchecked": Way(lambda row: orjson.loads(encode(row)), orjson.dumps, orjson.loads),
        "dataclass and orjson, unchecked": Way(
            lambda row: record(**arrays(orjson.loads(encode(row)))),
            lambda one: orjson.dumps(one, option=orjson.OPT_SERIALIZE_NUMPY),
            lambda line: record(**arrays(orjson.loads(line))),
        ),
        "pydantic, checked": Way(
            lambda row: model.model_validate_json(encode(row)),
            lambda one: one.model_dump_json().encode(),
            model.model_validate_json,
        ),
        "msgspec, checked (hulldown)": Way(lambda row: row, encode, decode_row),
    }


def _peak() -> float:
    """MB that this process has held at most; not ru_maxrss, which begins at what the parent held."""
    found = re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) / 1024


def _measure(queue: Any, name: str, rows: int, path: str) -> None:
    way = _ways()[name]
    some = [way.take(row) for _, row in zip(range(min(rows, CHUNK)), _rows(), strict=False)]
    written = 0.0
    with Path(path).open("wb") as file:
        for start in range(0, rows, len(some)):
            began = time.process_time()
            lines = [way.write(one) for one in some[: rows - start]]
            written += time.process_time() - began
            file.writelines(line.rstrip(b"\n") + b"\n" for line in lines)
    before, began = _peak(), time.process_time()
    with Path(path).open("rb") as file:
        held = [way.read(line) for line in islice(file, HELD)]
        peak = _peak() - before
        for line in file:
            way.read(line)
    read = time.process_time() - began
    queue.put({"write_us": 1e6 * written / rows, "read_us": 1e6 * read / rows, "held_kb": 1e3 * peak / len(held)})


def run(quick: bool) -> dict[str, Any]:
    """Measure, each way in a process of its own, and all of them in turn."""
    rows, rounds = (20_000, 2) if quick else (1_000_000, 1)
    context = multiprocessing.get_context("spawn")
    results: dict[str, list[dict[str, float]]] = {}
    with TemporaryDirectory() as folder:
        for _ in range(rounds):
            for name in _ways():
                queue = context.Queue()
                process = context.Process(target=_measure, args=(queue, name, rows, f"{folder}/plan.jsonl"))
                process.start()
                results.setdefault(name, []).append(queue.get(timeout=3600))
                process.join()
    ways = {name: {key: min(one[key] for one in found) for key in found[0]} for name, found in results.items()}
    return {"rows": rows, "ways": ways}


def report(results: dict[str, Any]) -> str:
    """A Markdown section."""
    lines = [
        "## Rows of a plan",
        "",
        f"{results['rows']:,} rows with a companion each, written as lines, read back, and held in memory. Checked "
        "means that types, ranges and shapes are; poses become arrays in all but the first.",
        "",
        "| | write a row (us) | read a row (us) | hold a row (kB) |",
        "|---|---:|---:|---:|",
    ]
    for name, way in results["ways"].items():
        lines.append(f"| {name} | {way['write_us']:.1f} | {way['read_us']:.1f} | {way['held_kb']:.1f} |")
    return "\n".join(lines) + "\n"


def plots(results: dict[str, Any], folder: Path) -> list[Path]:
    """Writing and reading, side by side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 2.8), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    for axis, key, title in zip(axes, ("write_us", "read_us"), ("write a row (us)", "read a row (us)"), strict=True):
        axis.barh(list(results["ways"]), [way[key] for way in results["ways"].values()])
        axis.set_title(title)
    path = folder / "rows.png"
    figure.savefig(path, dpi=100)
    return [path]
