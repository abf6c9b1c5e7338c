"""A plan of cubes without scenery, and its assets, for runs with a stand-in for Blender."""

from dataclasses import replace
from pathlib import Path

from hulldown.assets.plan_assets import Assets
from hulldown.assets.skylight import EVEN_SKYLIGHT
from hulldown.dataset.store.document import read_coco
from hulldown.plan.library import Library
from hulldown.reading.hdri import Hdri
from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.reader_process import Exported
from hulldown.tests.builders.plan_lines import row, write_lines
from hulldown.tests.builders.shapes import box, scenery_of, vehicle_of


def moved(exported, path, **changes):
    """An export as if it were of the .blend file `path`, which is its own tidy twin."""
    return replace(exported, report=replace(exported.report, path=str(path)), tidy=Path(path), **changes)


def library_of(assets, folder=Path()):
    """Assets whose files have their names and are in `folder`."""
    exported = Exported(FileReport("vehicle", "", (2.0, 2.0, 2.0), 12, 1.0, "z"), Path(), Path(), None, None, ())

    def files(names):
        return {name: moved(exported, folder / f"{name}.blend") for name in names}

    hdris = {name: Hdri(folder / f"{name}.exr", "", EVEN_SKYLIGHT) for name in assets.hdris}
    return Library(assets, files([*assets.vehicles, *assets.distractors]), files(assets.sceneries), hdris)


def cube_library(folder=Path(), hdris=("sky",)):
    cube = vehicle_of(box((-1, -1, 0), (1, 1, 2)), name="cube")
    return library_of(Assets({"cube": cube}, {"cube": "box"}, {"void": scenery_of("void")}, hdris), folder)


CUBES = cube_library()


def make_row(i, **changes):
    """A cube whose near face is 10 m before a camera that looks along +x."""
    camera = [[0.0, 0.0, 1.0, -11.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]]
    cube = {
        **{"vehicle": "cube", "category": "box", "articulation": {}, "paint": [], "bounds": [[-1.0] * 3, [1.0] * 3]},
        **{"bbox": [6.0, 6.0, 4.0, 4.0], "bbox_amodal": [6.0, 6.0, 4.0, 4.0], "truncated_fraction": 0.0},
        **{"visible_fraction": 1.0, "air_contrast": 1.0, "scenery": "void", "hdri": "sky", "sample_seed": i},
        **{"world_from_camera": camera, "fov_x_deg": 53.13010235415598, "width": 16, "height": 16, "position": i},
    }
    return row(i, **{**cube, **changes})


def write_plan(folder, rows):
    config = {
        "assets": {"vehicles": [{"path": "cube.blend", "category": "box"}], "sceneries": [{"path": "void.blend"}]},
        "budget": {"images_per_class": len(rows)},
        "render": {"samples": 1, "denoise": False, "adaptive_threshold": 0.0, "bounces": 1},
    }
    return write_lines(
        folder / "plan.jsonl",
        rows,
        config=config,
        vehicles={"cube": {"path": "cube.blend", "sha256": "", "category": "box"}},
        sceneries={"void": {"path": "void.blend", "sha256": "", "origin": [0, 0, 0]}},
        hdris={"sky": {"path": "sky.exr", "sha256": ""}},
    )


def contents(folder):
    """Records and pictures of a dataset."""
    pictures = {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*.png"))}
    coco = read_coco(folder)
    return coco["images"], coco["annotations"], coco["categories"], pictures
