"""Files from other programs, read in one process: their interpretation, and messages to the user."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from hulldown.assets.bundle import load_scenery
from hulldown.assets.skylight import SkyLight
from hulldown.base.color import LUMINANCE_WEIGHTS
from hulldown.base.errors import HulldownError
from hulldown.geometry.meshes import Mesh, merge_meshes_with_sources
from hulldown.plan.config.schema import Config
from hulldown.plan.library import load_library
from hulldown.planning.appearance import count_hdri_land_images
from hulldown.planning.write import write_plan
from hulldown.reading.doubts import scenery_doubts, vehicle_doubts
from hulldown.reading.hdri import read_hdris
from hulldown.reading.pieces.asset_report import By, FileReport, MaterialRow, Missing, ObjectRow, refuse_missing_files
from hulldown.reading.pieces.doubt import DoubtKind, file_warnings
from hulldown.reading.pieces.options import Options
from hulldown.reading.pieces.roles import PieceRole
from hulldown.reading.reader_process import finished_export, reader_job, run_reader_jobs
from hulldown.reading.surroundings import shows_land
from hulldown.reading.vehicle.parts import unnamed_part_doubts
from hulldown.reading.vehicle.seen_colors import color_doubts
from hulldown.reading.vehicle.solids import PlacedPieces, find_solids
from hulldown.tests.builders.planning_assets import small_assets, small_config
from hulldown.tests.builders.shapes import surface
from hulldown.tests.reading.test_build import box, tube
from hulldown.tests.reading.test_roles import piece
from hulldown.weather.kinds import airlight_radiance

MAX_MATERIAL = "newmtl body\n\tNi 1.5\n\td 1\n\tTr 0\n\tTf 1 1 1\n\tillum 2\n\tKd 0.3 0.32 0.2\n"
GLASS = "newmtl window\nTf 1 1 1\nillum 7\nd 1\n"
MOVED = "newmtl body\nmap_Kd model://car/materials/textures/skin.png\nnewmtl tire\nmap_Kd C:\\art\\Tire.PNG\n"
CAR = {
    "hull": box([6, 3, 1], [0, 0, 1]), "cabin": box([2, 2, 1], [1, 0, 2]),
    **{f"wheel_{x}_{y}": tube((x, y - 0.15, 0.5), (x, y + 0.15, 0.5), 0.5) for x in (-2, 0, 2) for y in (-1.2, 1.2)},
}  # fmt: skip
HOUSES = [box([6, 6, 20], [x, y, 10]) for x in range(-24, 25, 12) for y in range(-24, 25, 12)]
NAMELESS = {f"Mesh_{k}": mesh for k, mesh in enumerate(CAR.values())}
ON_ATLAS = {name: (0.3, 0.5) if name == "Mesh_0" else (0.75, 0.5) for name in NAMELESS}
HDR = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 64\n"
ATLAS = "newmtl m\nillum 2\nmap_Kd atlas.png\n"


def write_obj(path, parts, materials, mtl, uv=None):
    """Write named meshes with z up as OBJ with y up; each has one texture coordinate, from `uv` or 0."""
    path.parent.mkdir(parents=True)
    path.with_suffix(".mtl").write_text(mtl)
    lines, count = [f"mtllib {path.stem}.mtl"], 1
    for k, (name, mesh) in enumerate(parts.items(), start=1):
        lines.append("vt {} {}".format(*(uv or {}).get(name, (0, 0))))
        lines += [f"o {name}", f"usemtl {materials.get(name, materials['*'])}"]
        lines += [f"v {x:.6f} {z:.6f} {-y:.6f}" for x, y, z in mesh.vertices]
        lines += [f"f {a}/{k} {b}/{k} {c}/{k}" for a, b, c in mesh.faces + count]
        count += len(mesh.vertices)
    path.write_text("\n".join(lines) + "\n")
    return path


def hills():
    x = np.linspace(-250, 250, 51)
    return surface(x, x, 2 * np.outer(np.sin(x / 60), np.cos(x / 50)))


def curb(radius, width):
    """A closed strip around the origin, 0.2 m high."""
    ring = trimesh.creation.annulus(radius - width, radius, 0.2)
    return Mesh(ring.vertices - [0, 0, ring.vertices[:, 2].min()], ring.faces)


@pytest.fixture(scope="module")
def read(tmp_path_factory):
    """The assets read from each file, by its name."""
    folder = tmp_path_factory.mktemp("strangers")
    tree = box([1, 1, 6], [100, 100, 3])
    village, _ = merge_meshes_with_sources([box([60, 60, 0.1], [0, 0, 0]), *HOUSES])
    sceneries = {
        "sheet": {"Terrain": hills(), "Grass": box([500, 500, 0], [0, 0, 6])},
        "pit": {"Terrain": hills(), "Terrain_low": box([120, 120, 1], [0, 0, -194]), "tree": tree},
        "track": {"Terrain": hills(), "Object_7": curb(200, 0.8)},
        "lawn": {"stadium_dirt": curb(35, 4), "stadium_grass": box([82, 82, 0], [0, 0, -0.02])},
        "upright": {"Terrain": hills().with_vertices(hills().vertices[:, [0, 2, 1]] * [1, -1, 1])},
        "village": {"Ground": village},
    }
    # Meshes by name, then arguments of `write_obj`.
    made = {
        "max": (CAR, {"*": "body", "cabin": "window"}, MAX_MATERIAL + GLASS),
        "clear": (CAR, {"*": "window"}, GLASS),
        "ghost": (CAR, {"*": "body"}, "newmtl body\nKd 0.5 0.5 0.5\nillum 2\nd 0.502\n"),
        "doubled": ({**CAR, "hull_copy": CAR["hull"]}, {"*": "body"}, "newmtl body\nKd 0.5 0.5 0.5\n"),
        "outlined": (CAR, {"*": "body"}, "newmtl body\nKd 0 0 0\n"),
        "atlas": (NAMELESS, {"*": "m"}, ATLAS, ON_ATLAS),
        "pointer": (NAMELESS, {"*": "m"}, ATLAS, ON_ATLAS),
        "glass": (NAMELESS, {"*": "m"}, ATLAS, ON_ATLAS),
        "plain": (NAMELESS, {"*": "m"}, "newmtl m\nKd 0.5 0.5 0.5\nillum 2\n"),
        "white": (NAMELESS, {"*": "m"}, "newmtl m\nKd 0.8 0.8 0.8\nillum 2\n"),
        "moved": (CAR, {"*": "tire", "hull": "body"}, MOVED),
        "bare": (NAMELESS, {"*": "body"}, ""),
        "colored": (NAMELESS, {"*": "body"}, ""),
        **{name: (parts, {"*": "body"}, "") for name, parts in sceneries.items()},
    }
    files = {
        name: write_obj(folder / name / ("meshes" * (name == "moved")) / f"{name}.obj", *how) for name, how in made.items()
    }
    text = files["colored"].read_text().replace("usemtl", "#").replace("mtllib", "#")
    files["colored"].write_text(re.sub(r"(?m)^(v .*)$", r"\1 0.2 0.5 0.1", text))
    textures = {"materials/textures/skin.png": 90, "textures/a/tire.png": 20, "meshes/b/tire.png": 30}
    for name, level in textures.items():
        (folder / "moved" / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (4, 4), (level, level, level)).save(folder / "moved" / name)
    Image.new("RGB", (4, 4)).save(folder / "white/Diffuse.png")
    atlas = Image.new("RGB", (8, 8), "white")  # with a white border that no face uses
    atlas.paste((60, 66, 40), (1, 1, 4, 7))
    atlas.paste((25, 25, 27), (5, 1, 7, 7))
    atlas.save(folder / "atlas/atlas.png")
    atlas.paste((95, 100, 110), (5, 1, 7, 7))
    atlas.save(folder / "glass/atlas.png")
    (folder / "pointer/atlas.png").write_text("version https://git-lfs.github.com/spec/v1\nsize 12345\n")
    jobs = []
    for name, path in files.items():
        out = folder / "out" / name
        out.mkdir(parents=True)
        jobs.append(reader_job(path, out, kind="scenery" if name in sceneries else "vehicle"))
    run_reader_jobs(jobs)
    return {name: finished_export(job) for name, job in zip(files, jobs, strict=True)}


def test_only_materials_that_an_mtl_names_glass_are_glass(read):
    assert {row.name: row.clear for row in read["max"].report.materials} == {"body": False, "window": True}


@pytest.mark.parametrize(
    ("name", "doubt", "sound", "kind"),
    [
        pytest.param("clear", "of its surface is transparent", ("max",), DoubtKind.TRANSPARENT, id="made of glass"),
        pytest.param("ghost", "'body' has alpha 0.502", ("max",), DoubtKind.TRANSPARENT, id="half transparent"),
        pytest.param("doubled", "faces on top of each other", ("max",), DoubtKind.BLACK, id="doubled faces"),
        pytest.param("outlined", "a shell for an outline", ("max", "ghost"), DoubtKind.BLACK, id="an outline's shell"),
        pytest.param("sheet", "'Grass' is a level sheet", ("pit",), DoubtKind.SHEET_ABOVE, id="a sheet"),
        pytest.param("village", "'Ground' is ground, and 5", ("sheet", "pit"), DoubtKind.STEEP_GROUND, id="houses"),
        # Robot simulators write .obj files with z up.
        pytest.param("upright", 'set up = "z"', ("sheet", "pit"), DoubtKind.UP, id="an upright terrain"),
    ],
)
def test_a_file_that_looks_wrong_has_a_doubt_about_it(read, name, doubt, sound, kind):
    (found,) = (one for one in read[name].report.doubts if one.kind == kind)
    assert doubt in found.text
    assert not any(one.kind == kind for other in sound for one in read[other].report.doubts)


@pytest.mark.parametrize(("share", "missing", "found"), [(0.05, False, True), (0.01, False, False), (0.05, True, False)])
def test_magenta_in_a_vehicles_picture_is_a_doubt_unless_its_missing_file_is_named(share, missing, found):
    picture = np.zeros((102, 102, 4))
    picture[1:-1, 1:-1] = (0.2, 0.3, 0.1, 1.0)
    picture[1 : 1 + round(100 * share), 1:-1, :3] = (0.9, 0.02, 0.9)
    lost = (Missing("a.png", "missing", ("hull",)),) if missing else ()
    report = FileReport("vehicle", "", (6.0, 3.0, 2.0), 0, 1.0, "z", missing=lost)
    kinds = [doubt.kind for doubt in color_doubts(picture, report, beside=list)]
    assert kinds == [DoubtKind.MAGENTA] * found


def test_colors_at_vertices_are_worn_where_there_is_no_material(read):
    assert [row.name for row in read["colored"].report.materials] == ["vertex colors"]
    assert not {DoubtKind.PALE, DoubtKind.NO_MATERIAL} & {doubt.kind for doubt in read["colored"].report.doubts}
    picture = np.asarray(Image.open(read["colored"].picture).convert("RGB")).astype(int)
    assert ((picture[..., 1] > 1.5 * picture[..., 0]) & (picture[..., 1] > 1.5 * picture[..., 2])).mean() > 0.1


@pytest.mark.parametrize(
    ("rows", "level", "kind", "words"),
    [
        ([MaterialRow("m", 0.9, color=(1, 1, 1), metal=True)], 0.4, DoubtKind.PALE, "white metal"),
        ([MaterialRow("m", 0.9, color=(0.05, 0.06, 0.03), metal=True)], 0.04, DoubtKind.BLACK, "a dark metal"),
        ([MaterialRow("m", 0.7), MaterialRow("w", 0.3, clear=True)], 0.0, DoubtKind.BLACK, "the glass 'w'"),
        ([MaterialRow("m", 0.6), MaterialRow("n", 0.4)], 0.0, DoubtKind.BLACK, "faces on top of each other"),
        ([MaterialRow("m", 1.0, color=(0.8, 0.4, 0.06))], 0.3, DoubtKind.PALE, "all of it has one color"),
        ([MaterialRow("m", 1.0, color=(0.7, 0.7, 0.7), metal=True), MaterialRow("n", 0.0)], 0.4, None, ""),
    ],
)
def test_odd_colors_of_a_vehicle_have_their_cause(rows, level, kind, words):
    picture = np.zeros((9, 9, 4))
    picture[1:-1, 1:-1] = (level, 0.9 * level, 0.8 * level, 1.0)
    report = FileReport("vehicle", "", (6.0, 3.0, 2.0), 0, 1.0, "z", materials=tuple(rows))
    doubts = color_doubts(picture, report, beside=list, mapped=True)
    assert [(doubt.kind, words in doubt.text) for doubt in doubts] == [(kind, True)] * bool(kind)


def test_a_picture_that_cannot_be_read_is_named(read):
    (lost,) = read["pointer"].report.missing
    assert (Path(lost.path).name, lost.problem) == ("atlas.png", "unreadable")
    with pytest.raises(HulldownError, match=r"atlas.png is unreadable, used by"):
        refuse_missing_files([read["pointer"].report], strict=False)


def test_a_white_vehicle_is_a_doubt_about_lost_textures(read):
    doubts = {name: [d.text for d in read[name].report.doubts if d.kind == DoubtKind.PALE] for name in read}
    assert [len(doubts[name]) for name in ("max", "atlas", "bare", "white", "plain")] == [0, 0, 1, 1, 1]
    assert "all of it has one color" in doubts["plain"][0]
    assert "'Diffuse.png'" in doubts["white"][0]
    assert "beside it" not in doubts["bare"][0]


def test_an_unambiguous_texture_near_the_file_is_found(read):
    doubts = [doubt.text for doubt in read["moved"].report.doubts]
    assert any("skin.png" in doubt and "'../materials/textures/skin.png' is used in its place" in doubt for doubt in doubts)
    assert any("Tire.PNG" in doubt and "differ" in doubt for doubt in doubts)
    assert [missing.path.endswith("Tire.PNG") for missing in read["moved"].report.missing] == [True]
    picture = np.asarray(Image.open(read["moved"].picture).convert("RGB")).astype(int)
    dark = (np.ptp(picture, axis=2) < 8) & (picture.max(axis=2) < 120)
    assert dark.mean() > 0.05, "as skin.png is"


def test_ground_far_below_the_main_ground_is_dropped(read):
    uses = {row.name: row.use for row in read["pit"].report.rows}
    assert uses == {"Terrain": "ground", "Terrain_low": "obstacle", "tree": "obstacle"}
    assert load_scenery(read["pit"].bundle).ground.vertices[:, 2].min() > -3.0
    assert any("'Terrain_low' isn't used as ground" in doubt.text for doubt in read["pit"].report.doubts)


def test_an_hdri_with_a_one_colored_sun_is_a_doubt(tmp_path):
    pixels = np.full((32, 64, 4), (128, 128, 128, 128), dtype=np.uint8)
    for name, sun in (("white", (200, 200, 200, 142)), ("blue", (0, 0, 200, 142))):
        pixels[6, 10] = sun
        (tmp_path / f"{name}.hdr").write_bytes(HDR + pixels.tobytes())
    white, blue = read_hdris([tmp_path / "white.hdr", tmp_path / "blue.hdr"], tmp_path / "cache")
    assert white.doubts == ()
    assert [doubt.kind for doubt in blue.doubts] == [DoubtKind.TINTED]


def test_serious_doubts_come_first_in_one_warning_per_file(read):
    doubts = {name: read[name].report.doubts for name in ("max", "moved", "clear", "sheet", "pit")}
    lines = file_warnings(doubts)
    assert [line.partition("\n")[0] for line in lines] == ["sheet", "moved", "clear", "max", "pit"]
    assert all(line.count("\n") <= 4 for line in lines)
    assert "missing: " in lines[1].splitlines()[1]


def test_land_in_an_hdri_is_hidden_or_reported_where_the_terrain_ends(tmp_path):
    plain = np.full((64, 128, 3), 0.3)
    grass = plain * np.where(np.arange(128) % 2, 1.0, 0.4)[:, None]
    assert shows_land(grass)
    assert not shows_land(plain)
    assets = replace(small_assets(), skies={"noon": SkyLight(shows_land=True)})
    seen = {}
    for backdrop in ("hdri", "auto"):
        config = small_config(light={"backdrop": backdrop, "hdris": ["noon"]}, camera={"elevation_deg": [20.0, 40.0]})
        plan = write_plan(config, assets, tmp_path / f"{backdrop}.jsonl")
        seen[backdrop] = count_hdri_land_images(plan, assets)
    images = len(plan)
    assert images > seen["hdri"][0] > 0, "hills end, the fallback plane doesn't"
    assert seen == {"hdri": (seen["hdri"][0], images), "auto": (0, images)}


@pytest.mark.parametrize(
    ("light", "kept"), [((0.54, 0.8, 1.08), 0.0), ((1.0, 1.0, 1.0), 0.0), ((1.0, 0.45, 0.12), 1.0), ((0.1, 0.1, 1.0), 1.0)]
)
def test_fog_is_gray_unless_the_light_has_a_color(light, kept):
    light = np.array(light)
    gray = light @ LUMINANCE_WEIGHTS * np.ones(3)
    np.testing.assert_allclose(airlight_radiance("fog", light), gray + kept * (light - gray))
    assert not airlight_radiance("fog", np.zeros(3)).any()


def test_a_vehicle_of_odd_size_or_without_textures_is_refused_unless_allowed(tmp_path):
    big = {name: part.with_vertices(1000 * part.vertices) for name, part in CAR.items()}
    write_obj(tmp_path / "cars/suv.obj", big, {"*": "tire"}, MOVED)
    write_obj(tmp_path / "land/land.obj", {"Terrain": hills()}, {"*": "body"}, "")
    pixels = np.full((32, 64, 4), (128, 128, 128, 128), dtype=np.uint8)
    pixels[:8, :, 2] = 160
    (tmp_path / "sky.hdr").write_bytes(HDR + pixels.tobytes())

    def load(**more):
        vehicles = [{"path": "cars/suv.obj", "category": "car", "name": name, **more} for name in ("suv", "twin")]
        assets = {"hdris": ["sky.hdr"], "vehicles": vehicles, "sceneries": [{"path": "land/land.obj"}]}
        config = Config.of({"assets": assets, "budget": {"images_per_class": 1}}, path=tmp_path / "hulldown.toml")
        return load_library(config)

    with pytest.raises(HulldownError, match=r"2 to 9 m; of unusual length are also twin .6,000 m.; set scale = 0.001"):
        load()
    with pytest.raises(HulldownError, match="allow_missing"):
        load(scale=0.001)
    load(scale=0.001, allow_missing=True)
    (doubts,) = load(scale=0.02, allow_missing=True).doubts(backdrop=False).values()
    assert any("with its scale of 0.02 it is 120 m long, and a car has 2 to 9 m" in doubt.text for doubt in doubts)


def test_dropping_the_hull_is_a_doubt_and_many_pieces_get_a_pattern():
    base = ObjectRow("base", "MESH", "dropped", "", 1, 12, (6.0, 3.0, 1.0), By.CONFIG)
    rows = base, ObjectRow("turret", "MESH", "hull", "", 1, 500, (2.0, 1.0, 1.0))
    report = FileReport("vehicle", "", (2.0, 1.0, 1.0), 512, 1.0, "z", rows=rows)
    doubts = vehicle_doubts(report, Options(drop=("base",)))
    assert any("drops 'base', the largest piece" in doubt.text for doubt in doubts)
    tiles = [piece(f"TERR{i:04d}", size=(100, 100, 3), at=(100 * i, 0, 0), level=0.9) for i in range(40)]
    posts = [piece(f"POST{i}", size=(1, 1, 9), at=(50 * i, 0, 5)) for i in range(9)]
    roles = [PieceRole("obstacle", "", By.DEFAULT)] * 49
    report = FileReport("scenery", "", (4000.0, 100.0, 9.0), 0, 1.0, "z")
    doubts = scenery_doubts(report, [*tiles, *posts], roles, Options())
    assert 'ground = ["TERR*"]' in doubts[0].text
    road = piece("road", size=(4000, 8, 0), level=1.0)
    doubts = scenery_doubts(report, [*tiles, road], [*roles[:40], PieceRole("ground", "", By.NAME)], Options())
    (kept,) = [doubt.text for doubt in doubts if doubt.kind == DoubtKind.NOT_GROUND]
    assert 'ground = ["TERR*"]' in kept
    far = [replace(tile, bounds=np.add(tile.bounds, (0, 5000, 0))) for tile in tiles]
    doubts = scenery_doubts(report, [*far, road], [*roles[:40], PieceRole("ground", "", By.NAME)], Options())
    assert not any(doubt.kind == DoubtKind.NOT_GROUND for doubt in doubts)


def test_a_curb_around_a_track_is_not_water(read):
    uses = {row.name: row.use for row in read["track"].report.rows}
    assert uses == {"Terrain": "ground", "Object_7": "obstacle"}


def test_a_lawn_as_wide_as_the_scenery_is_ground(read):
    uses = {row.name: row.use for row in read["lawn"].report.rows}
    assert uses == {"stadium_dirt": "ground", "stadium_grass": "ground"}
    assert any("taken as ground: 'stadium_grass'" in doubt.text for doubt in read["lawn"].report.doubts)
    assert {row.name: row.use for row in read["sheet"].report.rows}["Grass"] == "obstacle"


@pytest.mark.parametrize(("group", "asked"), [("Grp_Upper", 1), ("Grp_Door_FL", 0), ("Interior", 0)])
def test_a_group_can_turn_unless_its_name_excludes_it(group, asked):
    pieces = [piece("lower", size=(6, 3, 1), at=(0, 0, 0.5))]
    pieces += [piece(name, group, size=(1, 1, 1), at=(0, 0, 2)) for name in ("left", "right")]
    doubts = unnamed_part_doubts(PlacedPieces(pieces, [one.bounds for one in pieces], find_solids((), ()), (), np.eye(4)))
    assert sum(f"hang from {group!r}" in doubt.text for doubt in doubts) == asked
