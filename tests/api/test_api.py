"""`import hulldown`: its names, its lazy imports, and displays of plans and datasets."""

import importlib
import io
import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import hulldown as hd
from hulldown.dataset.coco import CocoDataset
from hulldown.demo.project import create_project
from hulldown.planning.write import write_plan
from hulldown.tests.builders.editing import append
from hulldown.tests.builders.planning_assets import small_assets, small_config

NOTEBOOK = Path(__file__).parents[2] / "docs" / "first_dataset.ipynb"

HEAVY = {"bpy", "torch", "dask", "distributed", "numpy", "scipy", "PIL", "pandas", "matplotlib", "pydantic", "psutil"}
# Besides the names of `import hulldown`.
PROMISED = ["camera.intrinsics.Intrinsics", "camera.cameras.Cameras", "annotate.boxes.surface_box"]
PROMISED += ["annotate.boxes.VehicleBoxes", "dataset.coco.CocoDataset"]


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    return write_plan(small_config(), small_assets(), tmp_path_factory.mktemp("plan") / "plan.jsonl")


@pytest.fixture
def dataset(tmp_path):
    with CocoDataset.open(tmp_path / "dataset", categories=["tank", "truck"]) as writer:
        for i in range(8):
            label = {"category": "tank", "bbox": [8, 8, 40, 30]}
            append(writer, f"{i}.png", Image.new("RGB", (64, 48), (30 * i, 90, 90)), [label])
    return hd.Dataset.read(tmp_path / "dataset")


@pytest.mark.parametrize(
    "code", ["import hulldown; dir(hulldown); hulldown.HulldownError", "from hulldown import cli; assert cli.main([]) == 0"]
)
def test_import_and_help_load_nothing_heavy(code):
    code += f"; import sys; sys.exit(' '.join({HEAVY} & set(sys.modules)) or 0)"
    ran = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (0, "")


@pytest.mark.parametrize("name", PROMISED)
def test_relied_on_names_have_an_example(name):
    module, _, attribute = name.rpartition(".")
    assert ">>>" in getattr(importlib.import_module(f"hulldown.{module}"), attribute).__doc__


@pytest.mark.parametrize("name", hd.__all__)
def test_every_public_name_exists_and_has_an_example(name):
    assert name in dir(hd)
    assert ">>>" in getattr(hd, name).__doc__


def test_every_public_name_exists_without_the_training_extra():
    code = """
import sys
sys.modules |= dict.fromkeys(("torch", "cv2", "albumentations", "pytorch_lightning", "rfdetr"))
from pydoc import render_doc
import hulldown as hd
render_doc(hd)
assert all(not isinstance(getattr(hd, name), type(sys)) for name in hd.__all__)
"""
    subprocess.run([sys.executable, "-P", "-c", code], check=True)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'trian'"):
        _ = hd.trian


def test_a_plan_is_a_sequence(plan):
    assert [row.index for row in plan[2:8:3]] == [2, 5]
    assert plan[-1].index == len(plan) - 1
    assert [row.index for row in plan] == list(range(len(plan)))
    for beyond in (len(plan), -len(plan) - 1):
        with pytest.raises(IndexError):
            plan[beyond]


def test_a_table_of_a_plan_has_the_keys_of_its_lines(plan):
    table = plan.to_pandas()
    line = json.loads(plan.path.read_bytes().splitlines()[4])
    assert len(table) == len(plan)
    assert table["vehicle"][3] == line["planned"][0]["vehicle"]
    assert table["fov_x_deg"][3] == line["fov_x_deg"]


def test_without_pandas_the_error_tells_what_to_install(plan, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(hd.HulldownError, match="pip install pandas"):
        plan.to_pandas()


def test_a_plan_without_its_assets_can_be_displayed(plan):
    page = plan._repr_html_()
    assert "tank" in page
    assert "<img" not in page
    assert plan._repr_png_() is None


def test_a_dataset_displays_counts_and_pictures(dataset):
    page = dataset._repr_html_()
    assert "<th>labels of tank</th><td>8</td>" in page
    assert "<img" in page
    with Image.open(io.BytesIO(dataset._repr_png_())) as picture:
        assert picture.width > 900


def test_displays_escape_html_in_files(tmp_path):
    with CocoDataset.open(tmp_path, categories=["<script>"]) as writer:
        writer.append({"file_name": "none.png", "width": 64, "height": 48}, [])
    page = hd.Dataset.read(tmp_path)._repr_html_()
    assert "<script>" not in page
    assert "none.png" in page  # an unreadable picture


def test_datasets_and_plans_are_path_like(dataset, plan, tmp_path):
    assert hd.verify_dataset(dataset) == []
    assert hd.join_datasets([dataset], tmp_path / "joined").added == 8
    assert sum(hd.export_dataset(dataset, tmp_path / "out").values()) == 8
    assert len(hd.read_plan(plan)) == len(plan)
    with pytest.raises(hd.HulldownError):
        hd.render_plan(plan, tmp_path / "rendered")
    assert not (tmp_path / "rendered").exists()


def test_files_are_named_by_strings_too(dataset, plan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(hd.HulldownError, match=r"^none\.toml: no such file"):
        hd.plan_dataset("none.toml", "plan.jsonl")
    with pytest.raises(hd.HulldownError, match=r"^none: no such file"):
        hd.plan_dataset(plan.config, "plan.jsonl", poses="none")
    with pytest.raises(hd.HulldownError):
        hd.render_plan(str(plan.path), "rendered", cache="cache")


@pytest.mark.parametrize("wrong", [{"threshold": "bset"}, {"threshold": 50}, {"iou": 0}])
def test_a_threshold_out_of_range_is_refused(dataset, wrong):
    with pytest.raises(ValueError, match=f"^{next(iter(wrong))}: expected a number"):
        hd.evaluate_detections(dataset, "found.json", "report", **wrong)


@pytest.mark.blender
@pytest.mark.thorough
def test_the_example_notebook_runs_and_its_plan_can_be_displayed_and_rendered_in_parts(tmp_path, monkeypatch):
    create_project(tmp_path / "project", small=True)
    monkeypatch.chdir(tmp_path)
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    shared = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for cell in cells:
            if cell["cell_type"] == "code":
                exec("".join(cell["source"]), shared)
    plan = shared["plan"]
    assert len(shared["dataset"]) == len(plan) > 2
    assert not [finding for finding in shared["findings"] if finding.severity == "error"]
    assert np.ptp(np.asarray(plan.preview([0, 1], width=64).convert("L"))) > 100
    assert "<img" in plan._repr_html_()
    from hulldown.render.supervisor import Part

    for limit in (1, 2):
        assert len(hd.render_plan(plan, tmp_path / "parts", part=Part(limit=limit), device="cpu")) == limit
        assert [one for one in hd.verify_dataset(tmp_path / "parts", plan) if one.severity == "error"] == []
