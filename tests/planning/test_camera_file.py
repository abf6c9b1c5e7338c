"""Calibrations of OpenCV and ROS as configs: `init --camera`."""

import json
import tomllib

import pytest

from hulldown import cli
from hulldown.base.errors import ConfigError
from hulldown.plan.config.schema import Config
from hulldown.planning.inputs.camera_file import read_calibration_as_config

MATRIX = [1420.0, 0.0, 963.7, 0.0, 1418.5, 545.2, 0.0, 0.0, 1.0]
LENS = [-0.21, 0.07, 3e-4, -1e-4, 0.0]
# As written by `cv::FileStorage`.
OPENCV = f"""%YAML:1.0
---
calibration_time: "Mon Nov 23 06:00:00 2026"
image_width: 1920
image_height: 1080
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1420., 0., 9.6370000000000005e+02, 0., 1.4185e+03, 545.2, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: {LENS}
avg_reprojection_error: 2.1e-01
"""
ROS = f"""image_width: 1920
image_height: 1080
camera_name: narrow_stereo
camera_matrix: {{rows: 3, cols: 3, data: {MATRIX}}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [-0.21, 0.07, 3e-4, -1e-04, 0]}}
projection_matrix: {{rows: 3, cols: 4, data: [1, 0, 9, 0, 0, 1, 5, 0, 0, 0, 1, 0]}}
"""
MESSAGE = f"""header: {{frame_id: camera}}
height: 1080
width: 1920
distortion_model: plumb_bob
d: {LENS}
k: {MATRIX}
"""
JSON = json.dumps(
    {
        "camera_matrix": {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": MATRIX},
        "distortion_coefficients": [LENS],
        "image_width": 1920,
        "image_height": 1080,
    }
)
FOUR = json.dumps({"K": [MATRIX[:3], MATRIX[3:6], MATRIX[6:]], "D": LENS[:4], "width": 1920, "height": 1080})


@pytest.mark.parametrize("text", [OPENCV, ROS, MESSAGE, JSON, FOUR], ids=["opencv", "ros", "message", "json", "four"])
def test_a_calibration_becomes_a_config(tmp_path, text):
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    assert cli.main(["init", str(tmp_path / "project"), "--bare", "--camera", str(path)]) == 0
    config = Config.read(tmp_path / "project" / "hulldown.toml")
    assert (config.render.width, config.render.height) == (1920, 1080)
    camera = [1420.0, 0.0, 964.2, 0.0, 1418.5, 545.7, 0.0, 0.0, 1.0]  # from the corner of the first pixel
    assert config.calibrated_intrinsics.matrix.ravel().tolist() == pytest.approx(camera)
    assert config.calibrated_intrinsics.distortion == pytest.approx(LENS)


def test_a_lens_without_distortion_has_none(tmp_path):
    path = tmp_path / "camera.json"
    path.write_text(json.dumps({"K": MATRIX, "D": [], "width": 1920, "height": 1080}))
    assert "camera.distortion" not in read_calibration_as_config(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "isn't a calibration"),
        ("[1, 2", "neither YAML nor JSON"),
        ("!!python/object/apply:os.system [ls]", "neither YAML nor JSON"),
        ("image_width: 640", "has no camera matrix"),
        (FOUR.replace("width", "breadth"), "has no image width"),
        (FOUR.replace("1920", "0"), "isn't a camera"),
        (FOUR.replace("1420.0, 0.0", "1420.0, 2.0"), "isn't .fx, 0, cx"),
        (FOUR.replace("1420.0", '"?"'), "isn't made of numbers"),
        (FOUR.replace("-0.21", "-1.2"), "isn't a camera"),
        (ROS.replace("plumb_bob", "equidistant"), "model 'equidistant'"),
        (MESSAGE.replace("0.0]\nk", "0.0, 0.1, 0, 0]\nk"), "more coefficients"),
    ],
)
def test_a_file_without_a_calibration_is_refused(tmp_path, text, message):
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_calibration_as_config(path)
    assert cli.main(["init", str(tmp_path / "project"), "--bare", "--camera", str(path)]) == 2
    assert not (tmp_path / "project").exists()


def test_the_demo_can_use_the_camera(tmp_path):
    from hulldown.demo.project import demo_config_text

    path = tmp_path / "camera.yaml"
    path.write_text(ROS)
    values = tomllib.loads(demo_config_text(small=True, values=read_calibration_as_config(path)))
    assert (values["render"]["width"], values["camera"]["intrinsics"]["cx"]) == (1920, 964.2)
