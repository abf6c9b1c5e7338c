"""Output and pictures of `hulldown inspect`."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hulldown.geometry.errors import AssetError, HulldownError
from hulldown.planning.inputs.inspection import inspect_file
from hulldown.reading.inspect import COLORS, PAGE, Inspected, draw, write_pictures
from hulldown.reading.report import FileReport
from hulldown.tests.blender_plans import run_python
from hulldown.tests.shapes import box, scenery_of, vehicle_of

FILE = """
import bpy
from hulldown.tests.blend_parts import cuboid, fresh, save
fresh()
bpy.context.scene.unit_settings.scale_length = 0.01
cuboid("Hull", (4, 4, 4), (0, 0, 2))
cuboid("Turret", (2, 2, 2), (0, 0, 4.5))
material = bpy.data.materials.new("paint")
image = bpy.data.images.new("gone", 1, 1)
image.source, image.filepath = "FILE", "//gone.png"
material.node_tree.nodes.new("ShaderNodeTexImage").image = image
bpy.data.objects["Hull"].data.materials.append(material)
save("tiny.blend")
"""


VEHICLE = vehicle_of(box((-3, -1.5, 0), (3, 1.5, 1)), box((-1, -1, 1), (1, 1, 2)))


def hue_of(pixels: np.ndarray) -> np.ndarray:
    """Index of the part color of each shaded pixel, -1 for paper and ink."""
    length = np.linalg.norm(pixels, axis=-1, keepdims=True)
    near = (pixels / np.maximum(length, 1)) @ (COLORS / np.linalg.norm(COLORS, axis=1, keepdims=True)).T
    return np.where(near.max(axis=-1) > 0.995, near.argmax(axis=-1), -1)


def test_the_picture_shows_each_part_in_its_color() -> None:
    size = 200
    image = np.asarray(draw(VEHICLE, size=size)).astype(float)
    assert image.shape == (2 * size, 2 * size, 3)
    scale = size / (6 * 1.25)  # pixels per meter in the view from the left, which the length fills
    left = hue_of(image[:size, :size])
    middle = left[:, size // 2 + 20]
    # From top to bottom: turret (upper meter), hull (lower meter).
    assert (middle == 1).sum() == pytest.approx(scale, abs=2)
    assert (middle == 0).sum() == pytest.approx(scale, abs=2)
    assert np.flatnonzero(middle == 1).max() < np.flatnonzero(middle == 0).min()
    for view in (image[:size, size:], image[size:, :size], image[size:, size:]):
        assert {0, 1} <= set(np.unique(hue_of(view)))


def test_a_model_is_drawn_whose_bar_of_meters_is_rounded_below_a_power_of_ten() -> None:
    # 0.24 m * 1.25 / 3 is 0.09999999999999999 m, whose logarithm is -1: fuzzing found it.
    model = vehicle_of(box((-0.12, -0.06, 0), (0.12, 0.06, 0.04)), box((-0.04, -0.04, 0.04), (0.04, 0.04, 0.08)))
    assert draw(model, size=120).width == 240


@pytest.mark.parametrize("ground", [True, False])
def test_a_scenery_is_drawn(ground: bool) -> None:
    land = box((-50, -50, -1), (50, 50, 0)) if ground else None
    scenery = scenery_of("s", land, obstacles=[box((0, 0, 0), (5, 5, 5))], which=[0], poses=np.eye(4))
    image = np.asarray(draw(scenery, size=120)).astype(float)
    green = hue_of(image[120:, 120:])[30:, :] == 3
    assert bool(green.sum() > 1000) is ground


@pytest.mark.blender
def test_a_file_is_inspected(tmp_path: Path) -> None:
    path = tmp_path / "tiny.blend"
    run_python("-c", FILE, cwd=tmp_path)
    (inspected,) = inspect_file(path, pictures=True)
    found = inspected.report
    assert found.kind == "vehicle"
    assert found.unit == 0.01
    assert found.size == pytest.approx((0.04, 0.04, 0.055))
    assert [(row.name, row.use, row.triangles) for row in found.rows] == [
        ("Hull", "hull", 12),
        ("Turret", "turret", 12),
    ]
    assert [Path(m.path).name for m in found.missing] == ["gone.png"]
    assert found.missing[0].wanted_by == ("Hull",)
    assert any("5.5 cm long; set scale = 1 (now 0.01)" in doubt for doubt in found.doubts)
    write_pictures([inspected], tmp_path / "tiny.png")
    with Image.open(tmp_path / "tiny.png") as image:
        assert image.size == (960, 960)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["tiny.blend", "tiny.png"]
    with pytest.raises(AssetError, match=r"gone\.png is missing, used by Hull"):
        inspect_file(path, strict=True)
    with pytest.raises(AssetError, match="cannot be written"):
        write_pictures([inspected], tmp_path / "none" / "x.png")


def test_many_pictures_are_split_into_pages(tmp_path: Path) -> None:
    # One sheet with all of the demo's assets had 3,000 x 8,000 pixels.
    report = FileReport("vehicle", "a.blend", (1.0, 1.0, 1.0), 12, 1.0, "z")
    many = [Inspected(f"v{k}", report, Image.new("RGB", (96, 96))) for k in range(PAGE + 1)]
    (tmp_path / "all-2.png").write_bytes(b"of somebody else")
    with pytest.raises(HulldownError, match=r"all-2\.png: exists and wasn't drawn by hulldown"):
        write_pictures(many, tmp_path / "all.png")
    (tmp_path / "all-2.png").unlink()
    assert [page.name for page in write_pictures(many, tmp_path / "all.png")] == ["all.png", "all-2.png"]
    with Image.open(tmp_path / "all.png") as full, Image.open(tmp_path / "all-2.png") as last:
        assert full.height > 4 * 96 > 2 * 96 > last.height
    assert [page.name for page in write_pictures(many[:PAGE], tmp_path / "few.png")] == ["few.png"]
