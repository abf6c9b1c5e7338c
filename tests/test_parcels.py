"""What a node is sent is data, checked on arrival."""

import dataclasses
import math

import msgspec
import pytest

from render.messages import CameraInput, LightInput, RenderJob, SceneryInput, Settings, VehicleInput, WeatherInput
from render.parcels import AssetNote, FileNote, Order, Parcel, Versions, decode_parcel, encode, encode_parcel

POSE = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
JOB = RenderJob(
    scenery=SceneryInput("/field.blend", POSE, ["ground"], []),
    vehicles=[VehicleInput("/tank.blend", [POSE])],
    camera=CameraInput(POSE, 1.0, 96, 54, 0.1, 0.0, 0.0),
    light=LightInput("/sky.exr", 0.0, 1.0, None),
    weather=None,
    seed=1,
    settings=Settings(2, True, 0.0, 4),
    output="/dataset/.unfinished/0.png",
)
NUMBERS = ("visibility_m", "rain_mm_h", "exposure_s", "ground_cover", "vehicle_cover")
RAIN = {"kind": "rain", "wind_m_s": (0.0, 0.0), **dict.fromkeys(NUMBERS, 0.5)}
ASSETS = [AssetNote(FileNote(path, "0" * 64, 1)) for path in ("/field.blend", "/tank.blend", "/sky.exr")]


def parcel(job=JOB, **changes):
    return msgspec.structs.replace(Parcel([Order(0, job)], ASSETS, "cpu"), **changes)


def test_what_is_sent_arrives():
    assert decode_parcel(encode_parcel(parcel())) == parcel()


def test_the_objects_of_a_scenery_are_sent_once():
    """With sceneries of thousands of objects, their names were nearly all that the scheduler had to pass on."""
    other = dataclasses.replace(JOB, scenery=dataclasses.replace(JOB.scenery, standing=["hill"]))
    several = parcel(orders=[Order(i, (JOB, other)[i % 2]) for i in range(6)])
    sent = encode_parcel(several)
    assert decode_parcel(sent) == several
    assert (sent.count(b"ground"), sent.count(b"hill")) == (1, 1)


@pytest.mark.parametrize("which", [[], [1], [0, 0]])
def test_each_image_has_a_scenery(which):
    told = msgspec.msgpack.decode(encode_parcel(parcel())) | {"which": which}
    with pytest.raises(ValueError, match="a scenery for each of 1 images"):
        decode_parcel(encode(told))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"camera": dataclasses.replace(JOB.camera, width=0)}, "sides from 1 to 65536"),
        ({"camera": dataclasses.replace(JOB.camera, height=10**6)}, "sides from 1 to 65536"),
        ({"camera": dataclasses.replace(JOB.camera, fov_x=math.nan)}, "finite"),
        ({"scenery": dataclasses.replace(JOB.scenery, scenery_from_file=POSE[:3])}, r"poses of \(4, 4\)"),
        ({"vehicles": [VehicleInput("/tank.blend", [[[math.inf] * 4] * 4])]}, "finite"),
        *(
            ({"weather": WeatherInput(**{**RAIN, key: wrong})}, "finite")
            for key, wrong in [*((key, math.nan) for key in NUMBERS), ("wind_m_s", (0.0, math.inf))]
        ),
        ({"light": dataclasses.replace(JOB.light, hdri="/etc/passwd")}, "'/etc/passwd' is not among its files"),
    ],
)
def test_a_job_that_no_plan_could_have_is_refused(changes, says):
    job = dataclasses.replace(JOB, **changes)
    with pytest.raises(ValueError, match=says):
        decode_parcel(encode_parcel(parcel(job)))


def test_a_number_that_is_none_is_refused():
    told = msgspec.msgpack.decode(encode_parcel(parcel()))
    told["parcel"]["orders"][0]["job"]["seed"] = "one"
    with pytest.raises(msgspec.ValidationError, match="Expected `int`, got `str`"):
        decode_parcel(encode(told))


@pytest.mark.parametrize("changes", [{"device": "; rm -rf /"}, {"image_s": -1.0}])
def test_a_parcel_that_no_client_could_send_is_refused(changes):
    with pytest.raises(msgspec.ValidationError):
        decode_parcel(encode_parcel(parcel(**changes)))


@pytest.mark.parametrize(
    ("node", "says"),
    [
        (Versions("0.1.0 (ab)", "5.0.1", "6.3"), ""),
        (Versions("0.1.0 (ab)", "", "6.3"), "has no bpy"),
        (Versions("0.1.0 (cd)", "5.0.1", "6.3"), "has hulldown 0.1.0 (cd), and the client 0.1.0 (ab)"),
        (Versions("0.1.0 (ab)", "5.0.2", "6.3"), "has bpy 5.0.2, and the client 5.0.1"),
        (Versions("0.1.0 (ab)", "5.0.1", "7.3"), "has cache 7.3, and the client 6.3"),
    ],
)
def test_a_node_of_another_version_is_refused(node, says):
    assert node.difference(Versions("0.1.0 (ab)", "5.0.1", "6.3")) == says


@pytest.mark.parametrize(
    "path", ["sky.exr", "/skies/../../etc/sky.exr", "//skies/sky.exr", "/skies/./sky.exr", "/a\0b"]
)
def test_a_file_is_sent_under_an_absolute_path_without_detours(path):
    asset = AssetNote(ASSETS[0].file, [FileNote(path, "0" * 64, 1)])
    with pytest.raises(ValueError, match="absolute path without detours"):
        decode_parcel(encode_parcel(parcel(assets=[*ASSETS, asset])))
