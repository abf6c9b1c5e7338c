"""The config: defaults from the paper; errors name key, value, and what is allowed."""

import pickle
import re
import tomllib

import pytest

from hulldown.base.errors import ConfigError
from hulldown.plan.config.config_keys import (
    CONFIG_PAGE,
    ENTRY_SECTIONS,
    config_sections,
    config_text,
    documented_section_keys,
    example_config_text,
    fill_key_tables,
)
from hulldown.plan.config.schema import Config
from hulldown.plan.library import hdri_paths_by_name
from hulldown.plan.rejection import Rejection
from hulldown.weather.kinds import WEATHER_KINDS

MINIMAL = """
[[assets.vehicles]]
path = "vehicles/t72.blend"
category = "tank"
[[assets.sceneries]]
path = "hills.blend"
[budget]
images_per_class = 140
"""


@pytest.fixture
def read(tmp_path):
    def from_text(text):
        path = tmp_path / "config.toml"
        path.write_text(text)
        return Config.read(path)

    return from_text


def test_the_template_has_the_defaults_and_backgrounds(read):
    values = tomllib.loads(example_config_text())
    assert values["budget"].pop("background_share") == 0.25
    assert values["budget"].pop("background_distractors") == 1.0
    values["assets"] = {"hdris": ["hdris/*.exr"], **tomllib.loads(MINIMAL)["assets"]}
    assert Config.of(values).model_dump() == read(MINIMAL).model_dump()


def test_the_template_has_every_key():
    text = example_config_text()
    for section, kind in {"": Config, **config_sections()}.items():
        part = text.split(f"[{section}]\n")[-1] if section else text
        for key in documented_section_keys(kind):
            assert re.search(rf"(?m)^(# )?(\[\[assets\.)?{key.name}( =|\]\])", part), f"{section}.{key.name}"


def test_every_key_has_a_description_in_the_docs():
    for kind in (Config, *config_sections().values(), *ENTRY_SECTIONS.values()):
        assert all(key.meaning for key in documented_section_keys(kind)), kind
        assert all(key.default or key.example or key.required or key.name == "name" for key in documented_section_keys(kind)), (
            kind
        )
    text = CONFIG_PAGE.read_text(encoding="utf-8")
    assert text.count("<!-- keys of ") == len(config_sections()) + len(ENTRY_SECTIONS) + 1
    assert fill_key_tables(text) == text, "run python -m hulldown.plan.config.config_keys"


def test_the_docs_of_limits_have_every_reason_and_existing_keys():
    rows = re.findall(r"(?m)^\| `(\w+)` \|(.*)\|.*\|$", CONFIG_PAGE.with_name("limits.md").read_text(encoding="utf-8"))
    assert sorted(reason for reason, _ in rows) == sorted(each.key for each in Rejection if each)
    for section, key in re.findall(r"`(\w+)\.(\w+)`", " ".join(keys for _, keys in rows)):
        assert key in config_sections()[section].model_fields


def test_examples_of_keys_without_a_default_are_allowed(read):
    vehicle = [f"{key.name} = {key.example}" for key in documented_section_keys(ENTRY_SECTIONS["vehicle"]) if key.example]
    assert len(vehicle) >= 8
    read(MINIMAL.replace('category = "tank"', "\n".join(['category = "tank"', *vehicle])))


def test_the_template_for_given_assets(read):
    text = config_text(
        vehicles=[{"path": 'v/"a".blend', "category": "tank", "forward": "-y", "drop": ["floor", "lamp*"]}],
        sceneries=[{"path": "s.blend", "weight": 2.5}],
        hdris=["a.exr", "b/*.hdr"],
        values={"budget.images_per_class": 3, "camera.target_fraction": [0.2, 0.5], "render.profile": "fast"},
    )
    config = read(text)
    assert config.assets.vehicles[0].path == 'v/"a".blend'
    assert config.assets.vehicles[0].drop == ("floor", "lamp*")
    assert config.assets.sceneries[0].weight == 2.5
    assert config.assets.hdris == ("a.exr", "b/*.hdr")
    assert config.budget.images_per_class == 3
    assert config.camera.target_fraction == (0.2, 0.5)
    assert (config.render.profile, config.render.samples) == ("fast", 32)


@pytest.mark.parametrize("key", ["render.pixels", "budget.width"])
def test_the_template_refuses_values_without_a_line(key):
    with pytest.raises(ValueError, match=key):
        config_text(vehicles=[], sceneries=[], hdris=[], values={key: 1})


def test_a_profile_sets_missing_values(read):
    fast = read(MINIMAL + '[render]\nprofile = "fast"\nbounces = 7\n').render
    assert fast.samples < 128
    assert fast.bounces == 7
    train = read(MINIMAL + '[render]\nprofile = "train"\n').render
    assert (train.samples, train.denoise) == (8, True)


CALIBRATED = """
intrinsics = { fx = 900.0, fy = 900.0, cx = 960.0, cy = 540.0 }
distortion = { k1 = -0.05 }
"""


@pytest.mark.parametrize("camera", ["fov_x_deg = 50\n", CALIBRATED])
def test_a_resolved_config_round_trips(read, camera):
    config = read(MINIMAL + "[light]\nhdris = ['noon', { name = 'dusk*', weight = 2 }]\n[camera]\n" + camera)
    assert Config.of(config.model_dump(mode="json")).model_dump() == config.model_dump()
    assert pickle.loads(pickle.dumps(config)) == config
    assert pickle.loads(pickle.dumps(config)).path == config.path


WEATHER = "[weather]\nfog = 0.6\nrain = 0.5"
WRONG = [  # the addition, the key in the error, and its text
    ("[placement]\nmax_slope = 20", "unknown key placement.max_slope", "did you mean placement.max_slope_deg?"),
    ("[placement]\nfov_x_deg = 20", "unknown key placement.fov_x_deg", "did you mean camera.fov_x_deg?"),
    ("[placment]\nmargin = 1", "unknown key placment", "did you mean placement?"),
    ("[ground]\ninclude = ['Hills']", "ground.include is gone; ", "`ground` of each scenery"),
    ("[ground]\nqwerty = 1", "unknown key ground.qwerty", "known here: fallback_z"),
    (WEATHER, "weather", f"{', '.join(WEATHER_KINDS)} are 1.1 together; expected shares of at most 1 in all"),
    *((f"[camera]\nfov_x_deg = {x}", f"camera.fov_x_deg = {x}", "0.1 <= low <= high <= 179")
      for x in ("[50, 40]", "'wide'", "nan", "[1, 2, 3]")),
    ("[light]\nstrength = [0, inf]", "light.strength = [0, inf]", "0 <= low <= high <= 1e+09"),
    ("[placement]\nvehicles_per_image = [1, 2.5]", "placement.vehicles_per_image = [1, 2.5]", "a whole number or"),
    *((f"[render]\nsamples = {x}", f"render.samples = {x}", "expected") for x in ("1.5", "'9'", "0")),
    ("[render]\nprofile = 'best'", "render.profile = 'best'", "expected 'paper', 'fast' or 'train'"),
    ("[render]\ndenoise = 1", "render.denoise = 1", "expected true or false"),
    ("[placement]\nmargin = inf", "placement.margin = inf", "expected a finite number"),
    ("[placement]\nmax_slope_deg = 90", "placement.max_slope_deg = 90", "expected less than 90"),
    ("[light]\nhdris = [3]", "light.hdris[0] = 3", "expected a name or { name = ..., weight = ... }"),
    ("[light]\nhdris = 'noon'", "light.hdris = 'noon'", "expected a list"),
    *((f"[light]\nexposure = {x}", "light.exposure = ", "expected 'auto' or EV from -32 to 32")
      for x in ("'bright'", "33", "true", "[0, 1]")),
    ("[sensor]\npreset = 'camera'", "sensor is gone; ", "`train`"),
    ("[placement]\nfootprint = 9", "placement.footprint is gone; ", "5 x 5 rays"),
    ("[placement]\nrule = 'least_squares'", "placement.rule = 'least_squares' is gone; ", 'use "support"'),
    ("background_share = 1.0", "budget.background_share = 1.0", "expected less than or equal to 0.99"),
    ("[annotate]\nmin_box_px = 9.0", "annotate.min_box_px = 9", "expected at most camera.min_box_px, 8"),
    ("[annotate]\nmin_visible_fraction = 0.4", "annotate.min_vis", "at most the least camera.visible_fraction, 0.3"),
    ("[annotate]\nmax_truncated_fraction = 0.1\n[camera]\ntruncated_fraction = [0, 0.5]", "annotate.max_truncated",
     "expected at least the largest camera.truncated_fraction, 0.5"),
    ("[[assets.distractors]]\npath = 'a.blend'\nsceneries = ['sea']", "assets: ", "'sea' matches none of ['hills']"),
    ("[[assets.distractors]]\npath = 't72.blend'", "assets: ", "2 vehicles and distractors are called 't72'"),
]  # fmt: skip


@pytest.mark.parametrize(("extra", "key", "problem"), WRONG)
def test_the_error_of_a_wrong_value_names_what_is_allowed(read, tmp_path, extra, key, problem):
    with pytest.raises(ConfigError) as caught:
        read(MINIMAL + extra)
    assert str(caught.value).startswith(f"{tmp_path / 'config.toml'}: {key}")
    assert problem in str(caught.value)


TANK, HILLS, COUNT = 'category = "tank"', 'path = "hills.blend"', "images_per_class = 140"
INSTEAD = [  # a line of the config, its replacement, and the error
    (COUNT, "", "budget: expected exactly one of images_per_class and positions_per_vehicle"),
    (COUNT, COUNT + "\npositions_per_vehicle = 1", "budget: expected exactly one of"),
    (COUNT, "images_per_class = -1", "budget.images_per_class = -1: expected a whole number"),
    (COUNT, f"images_per_class = {{ tank = {2**63} }}", "budget.images_per_class"),
    (COUNT, f"positions_per_vehicle = {2**63}", "budget.positions_per_vehicle = 9"),
    (COUNT, f"{COUNT}\nimages_per_position = {2**63}", "budget.images_per_position = 9"),
    ("[budget]\n" + COUNT, "", "budget is missing"),
    (TANK, "", "assets.vehicles[0].category is missing"),
    (TANK, 'category = ""', "assets.vehicles[0].category = '': expected at least 1 character"),
    (TANK, TANK + "\ngun_limits_deg = [20, -5]", "assets.vehicles[0].gun_limits_deg = [20, -5]"),
    (TANK, TANK + "\nturret_limits_deg = 400", "assets.vehicles[0].turret_limits_deg = 400"),
    (TANK, TANK + '\nforwrd = "-x"', "unknown key assets.vehicles[0].forwrd; did you mean"),
    (TANK, TANK + '\nforward = "x"', "assets.vehicles[0].forward = 'x': expected '+x', '-x'"),
    (TANK, f"{TANK}\nforward = 1{'0' * 400}", f"assets.vehicles[0].forward = 1{'0' * 59}: expected"),
    (TANK, f"{TANK}\ngun_pivot = [0, 0, 1{'0' * 400}]", "expected the name of an object, or [x, y, z]"),
    *(
        (TANK, f"{TANK}\npaint = {paint}", f"assets.vehicles[0].paint{message}")
        for paint, message in (
            ("{}", "[0].materials is missing"),
            ("{ materials = ['camo'] }", "[0].colors is missing"),
            ("{ materials = ['camo'], colors = [] }", "[0].colors = []: expected at least one"),
            ("{ colors = ['own'] }", "[0].materials is missing"),
            ("{ materials = [], colors = ['own'] }", "[0].materials = []: expected at least one"),
            (
                "{ materials = ['*'], colors = ['green'] }",
                "[0].colors[0] = 'green': expected a color such as '#4b5320', or 'own'",
            ),
            ("{ materials = ['*'], colors = ['#4b53'] }", "[0].colors[0] = '#4b53': expected a color"),
            ("{ materials = ['*'], colors = [7] }", "[0].colors[0] = 7: expected a color"),
            ("{ materials = ['*'], colors = ['own'], value = 2 }", "[0].value is gone; delete it: list the `colors`"),
            ("'green'", " = 'green': expected a list"),
        )
    ),
    (
        TANK,
        TANK + "\npaint = { materials = ['*'], colors = ['own'], colours = ['own'] }",
        "did you mean assets.vehicles.paint.colors?",
    ),
    (TANK, f'{TANK}\n[[assets.vehicles]]\npath = "b/t72.blend"\n{TANK}', "assets: 2 vehicles are called 't72'"),
    *(("140", x, "isn't TOML: ") for x in ("9" * 5000, "[" * 2000)),
    ("140", f"[0x{'f' * 5000}]", "budget.images_per_class = an integer of thousands of digits"),
    (HILLS, "path = 3", "assets.sceneries[0].path = 3: expected a string"),
    (HILLS, HILLS + "\nweight = 0", "assets: all sceneries have weight 0"),
    ("[[assets.sceneries]]\n" + HILLS, "[assets]\nsceneries = []", "assets.sceneries = []: expected at least one"),
    ("[[assets.vehicles]]", "[assets]\nhdris = []\n[[assets.vehicles]]", "assets.hdris = []: expected at least one"),
    (MINIMAL, f"seed = {2**63}\n{MINIMAL}", f"seed = {2**63}: expected less than {2**63}"),
]


@pytest.mark.parametrize(("old", "new", "message"), INSTEAD)
def test_the_error_of_a_wrong_section_names_it(read, old, new, message):
    with pytest.raises(ConfigError, match=re.escape(message)):
        read(MINIMAL.replace(old, new))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "no such file; `hulldown init`"),
        (b"seed = 0\nx = = 2\n", "isn't TOML: .*line 2"),
        (b"\xff\xfe\x00", "isn't UTF-8 text"),
    ],
)
def test_a_file_that_is_not_a_config_is_refused(tmp_path, content, message):
    if content is not None:
        (tmp_path / "c.toml").write_bytes(content)
    with pytest.raises(ConfigError, match=rf"c.toml: {message}"):
        Config.read(tmp_path / "c.toml")
    with pytest.raises(ConfigError, match="is a folder, not a config"):
        Config.read(tmp_path)


def test_hdris_are_found_by_pattern(read, tmp_path):
    for name in ("b.exr", "a.exr", "night.hdr", "a.txt"):
        (tmp_path / name).touch()
    config = read(f"[assets]\nhdris = ['night.hdr', '*.exr', '{tmp_path}/a.exr']\n" + MINIMAL)
    assert hdri_paths_by_name(config) == {n: tmp_path / f for n, f in (("night", "night.hdr"), ("a", "a.exr"), ("b", "b.exr"))}


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("*/a.exr", ".* have the same name; rename one of them"),
        ("sky/*.exr", r"'sky/\*.exr' matches no file"),
        ("", "'' isn't a file pattern"),
        ("n*", r"'n\*' matches 'notes.txt', which isn't a .exr or .hdr file; narrow the pattern"),
    ],
)
def test_wrong_patterns_are_refused(read, tmp_path, pattern, message):
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
    for name in ("notes.txt", "x/a.exr", "y/a.exr"):
        (tmp_path / name).touch()
    with pytest.raises(ConfigError, match=f"assets.hdris: {message}"):
        hdri_paths_by_name(read(f"[assets]\nhdris = ['{pattern}']\n" + MINIMAL))
