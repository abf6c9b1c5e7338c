"""The dataset file: the cost of recording another image, from a thousand images to a million."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import orjson

from hulldown.benchmarks.tables import table
from hulldown.dataset.coco import MAX_MERGE_TIME_SHARE, CocoDataset
from hulldown.dataset.store.document import ANNOTATIONS_NAME, JOURNAL_NAME, write_coco_document

APPEND_COUNT = 200
REWRITTEN_AT_MOST = 100_000  # images; the dictionaries of a million do not fit into an ordinary machine's memory
MERGED_AFTER = 10_000  # images
POSE = np.round(np.random.default_rng(0).normal(size=(4, 4)), 6).tolist()


def run(quick: bool) -> dict:
    """Measure."""
    sizes = (1_000, 10_000) if quick else (1_000, 100_000, 1_000_000)
    with tempfile.TemporaryDirectory() as name:
        return {
            "appends": APPEND_COUNT,
            "fsync_us": _fsync(Path(name)),
            "sizes": {str(n): _measure_size(Path(name), n) for n in sizes},
        }


def report(results: dict) -> str:
    """A Markdown section."""
    sizes = results["sizes"]
    rows = {
        "append one image, us": "append_us",
        "write the whole file after each image (the paper's way), us": "rewrite_us",
        "open the dataset, s": "open_s",
        "memory, MB": "open_mb",
        "open another tool's layout, s": "open_whole_s",
        "memory, MB ": "open_whole_mb",
        "merge into annotations.json, s": "merge_s",
        "annotations.json, MB": "megabytes",
    }
    return "\n\n".join([
        "## COCO files",
        "Recording one finished image with one annotation; mean of "
        f"{results['appends']} appends. An append is one line in a journal and an fsync "
        f"({results['fsync_us']:.0f} us on this disk when idle); merging takes at most "
        f"{MAX_MERGE_TIME_SHARE:.0%} of a run's time.",
        table(
            ["images there already", *(f"{int(n):,}" for n in sizes)],
            [(label, *(_cell(size.get(key)) for size in sizes.values())) for label, key in rows.items()],
        ),
    ])  # fmt: skip


def _cell(figure: float | None) -> str:
    return "not run" if figure is None else f"{figure:,.4g}"


def plots(results: dict, folder: Path) -> list[Path]:
    """Draw the cost of an image against the number of images in the dataset."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for key, label in (("rewrite_us", "rewrite the file"), ("append_us", "journal (hulldown)")):
        known = {int(n): size[key] for n, size in results["sizes"].items() if key in size}
        axes.plot(list(known), list(known.values()), marker="o", label=label)
    axes.set(xscale="log", yscale="log", xlabel="images there already", ylabel="microseconds an image")
    axes.legend()
    path = folder / "coco.png"
    figure.savefig(path, dpi=120)
    return [path]


def _measure_size(folder: Path, n: int) -> dict[str, float]:
    dataset = folder / str(n)
    _fill(dataset, n)
    open_s, open_mb = _opened(dataset)
    opened = CocoDataset.open(dataset)
    spent = []
    for i in range(APPEND_COUNT):
        image, annotations = _image(n + i), [_annotation(n + i)]
        started = time.perf_counter()
        opened.append(image, annotations)
        spent.append(time.perf_counter() - started)
    started = time.perf_counter()
    opened.close()
    merge_s = time.perf_counter() - started
    path = dataset / "annotations.json"
    result = {
        "append_us": 1e6 * float(np.mean(spent)),
        "append_p95_us": 1e6 * float(np.quantile(spent, 0.95)),
        "fsync_us": _fsync(dataset),
        "open_s": open_s,
        "merge_s": merge_s,
        "megabytes": path.stat().st_size / 1e6,
        "open_mb": open_mb,
    }
    if n <= REWRITTEN_AT_MOST:
        rewrite_s = _rewrite(path)
        result |= {"rewrite_us": 1e6 * rewrite_s, "ratio": rewrite_s / float(np.mean(spent))}
        os.replace(path.parent / "again.json", path)
        result["open_whole_s"], result["open_whole_mb"] = _opened(dataset)
    shutil.rmtree(dataset)
    return result


def _rewrite(path: Path) -> float:
    """Seconds to write the whole dictionary with the standard library, as the simplest program does; no fsync."""
    coco = json.loads(path.read_bytes())
    started = time.perf_counter()
    with (path.parent / "again.json").open("w") as file:
        file.write(json.dumps(coco))
    return time.perf_counter() - started


def _fsync(folder: Path) -> float:
    """Return microseconds of the disk's fsync of a line."""
    spent = []
    with (folder / "probe").open("ab", buffering=0) as file:
        for _ in range(APPEND_COUNT):
            file.write(b"x" * 900)
            started = time.perf_counter()
            os.fsync(file.fileno())
            spent.append(time.perf_counter() - started)
    (folder / "probe").unlink()
    return 1e6 * float(np.mean(spent))


def _opened(folder: Path) -> tuple[float, float]:
    """Return seconds of opening a dataset, and the MB that it adds to a process of its own."""
    code = r"""if True:
        import re, sys, time
        from hulldown.dataset.coco import CocoDataset
        # Not ru_maxrss, which begins at what the parent held.
        def peak(): return int(re.search(r"VmHWM:\s+(\d+)", open("/proc/self/status").read())[1]) / 1024
        before, started = peak(), time.perf_counter()
        CocoDataset.open(sys.argv[1])
        print(time.perf_counter() - started, peak() - before)
    """
    words = [sys.executable, "-c", code, str(folder)]
    seconds, megabytes = subprocess.run(words, check=True, capture_output=True, text=True).stdout.split()
    return float(seconds), float(megabytes)


def _fill(folder: Path, n: int) -> None:
    """Write a dataset of n images at once, with the files that appending each would make."""
    folder.mkdir()
    images = ({"id": i + 1, **_image(i)} for i in range(n))
    annotations = ({"id": i + 1, "image_id": i + 1, "category_id": 1, **_annotation(i)} for i in range(n))
    head = {"categories": [{"id": 1, "name": "tank", "supercategory": "vehicle"}]}
    with (folder / ANNOTATIONS_NAME).open("wb") as file:
        write_coco_document(file, head, map(orjson.dumps, images), map(orjson.dumps, annotations))
    with (folder / JOURNAL_NAME).open("wb") as file:
        file.write(orjson.dumps(head) + b"\n")
        for i in range(n):
            boxed = [{"id": i + 1, "image_id": i + 1, "category_id": 1, **_annotation(i)}]
            file.write(orjson.dumps({"image": {"id": i + 1, **_image(i)}, "annotations": boxed}) + b"\n")
            if i % MERGED_AFTER == MERGED_AFTER - 1 or i == n - 1:
                file.write(b'{"merged":true}\n')
        # Else the first append would wait for all of this to reach the disk.
        file.flush()
        os.fsync(file.fileno())


def _image(i: int) -> dict:
    return {
        "file_name": f"images/{i + 1:08d}.png", "width": 1920, "height": 1080, "scenery": "hills",
        "position": i // 5, "shot": i % 5, "world_from_camera": POSE, "fov_x_deg": 50.0,
    }  # fmt: skip


def _annotation(i: int) -> dict:
    return {
        "category": "tank", "bbox": [812.25, 403.5, 180.125 + i % 7, 96.75],
        "bbox_amodal": [812.25, 403.5, 181.0, 96.75],
        "visible_fraction": 0.93, "truncated_fraction": 0.0, "vehicle": "tank_a", "world_from_vehicle": POSE,
        "articulation": {"turret": 0.5}, "area": 9000, "iscrowd": 0,
        "segmentation": {"size": [1080, 1920], "counts": "Xi_h0" * 60},
    }  # fmt: skip
