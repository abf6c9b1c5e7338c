"""Files of other programs, written by hand, as Blender's importers read them."""

import base64
import json
import struct

import pytest

from hulldown.reading.pieces.asset_report import FileReport
from hulldown.reading.reader_process import finished_export, reader_job, run_reader_jobs

# A box of 6 x 3 x 1, and a smaller one on it: corners and faces of four.
HULL = [(x, y, z) for x in (-3, 3) for y in (-1.5, 1.5) for z in (0, 1)]
TURRET = [(x, y, z) for x in (-1, 1) for y in (-0.8, 0.8) for z in (1, 1.6)]
SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def obj_text(separator: str, offset: tuple[float, float, float] = (0, 0, 0)) -> str:
    lines = ["v {} {} {}".format(*(x + zero for x, zero in zip(at, offset, strict=True))) for at in HULL + TURRET]
    for first, name in ((1, "hull"), (9, "turret")):
        lines += [f"{separator} {name}", *("f " + " ".join(str(first + corner) for corner in side) for side in SIDES)]
    return "\n".join(lines) + "\n"


def fbx_text() -> str:
    """An FBX file as text, in meters, z up."""
    text = "; FBX 7.3.0 project file\nFBXHeaderExtension:  {\n\tFBXVersion: 7300\n}\n"
    text += 'GlobalSettings:  {\n\tProperties70:  {\n\t\tP: "UpAxis", "int", "Integer", "",2\n'
    text += '\t\tP: "UnitScaleFactor", "double", "Number", "",100\n\t}\n}\nObjects:  {\n'
    for number, name, corners in ((1, "hull", HULL), (2, "turret", TURRET)):
        flat = ",".join(str(value) for corner in corners for value in corner)
        faces = ",".join(f"{a},{b},{c},{-d - 1}" for a, b, c, d in SIDES)
        text += f'\tGeometry: {number}, "Geometry::{name}", "Mesh" {{\n\t\tVertices: *24 {{\n\t\t\ta: {flat}\n\t\t}}\n'
        text += f"\t\tPolygonVertexIndex: *24 {{\n\t\t\ta: {faces}\n\t\t}}\n\t}}\n"
        text += f'\tModel: {number + 10}, "Model::{name}", "Mesh" {{\n\t}}\n'
    links = "".join(f'\tC: "OO",{k + 10},0\n\tC: "OO",{k},{k + 10}\n' for k in (1, 2))
    return text + "}\nConnections:  {\n" + links + "}\n"


def gltf_text() -> str:
    """A tank in glTF, y up, whose animation begins with the turret turned and the hull shrunk to nothing."""
    corners = [struct.pack("<24f", *(value for x, y, z in solid for value in (x, z, -y))) for solid in (HULL, TURRET)]
    triangles = [corner for a, b, c, d in SIDES for corner in (a, b, c, a, c, d)]
    keys = struct.pack("<2f", 0.0, 1.0) + struct.pack("<6f", 0.01, 0.01, 0.01, 1, 1, 1)
    keys += struct.pack("<8f", 0, 0.5**0.5, 0, 0.5**0.5, 0, 0, 0, 1)
    data = b"".join(corners) + struct.pack("<36H", *triangles) + keys
    spans = [(0, 96), (96, 96), (192, 72), (264, 8), (272, 24), (296, 32)]
    kinds = [("VEC3", 5126, 8), ("VEC3", 5126, 8), ("SCALAR", 5123, 36), ("SCALAR", 5126, 2), ("VEC3", 5126, 2)]
    accessors = [
        {"bufferView": view, "componentType": component, "count": count, "type": kind}
        for view, (kind, component, count) in enumerate([*kinds, ("VEC4", 5126, 2)])
    ]
    for accessor, solid in zip(accessors, (HULL, TURRET), strict=False):
        turned = [(x, z, -y) for x, y, z in solid]
        accessor |= {"min": [*map(min, *turned)], "max": [*map(max, *turned)]}
    channels = [(0, "scale"), (1, "rotation")]
    return json.dumps(
        {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0, 1]}],
            "nodes": [{"name": "hull", "mesh": 0}, {"name": "turret", "mesh": 1}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": k}, "indices": 2}]} for k in (0, 1)],
            "animations": [
                {
                    "name": "spawn",
                    "samplers": [{"input": 3, "output": 4 + k} for k in (0, 1)],
                    "channels": [
                        {"sampler": k, "target": {"node": node, "path": path}} for k, (node, path) in enumerate(channels)
                    ],
                }
            ],
            "accessors": accessors,
            "bufferViews": [{"buffer": 0, "byteOffset": start, "byteLength": size} for start, size in spans],
            "buffers": [
                {"byteLength": len(data), "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode()}
            ],
        }
    )


FILES = {
    "groups.obj": obj_text("g"),
    "objects.obj": obj_text("o"),
    "on a map.obj": obj_text("o", (477123.25, 5412345.5, 312.0)),
    "text.fbx": fbx_text(),
    "animated.gltf": gltf_text(),
}


@pytest.fixture(scope="module")
def reports(tmp_path_factory: pytest.TempPathFactory) -> dict[str, FileReport]:
    folder = tmp_path_factory.mktemp("importers")
    jobs = {}
    for name, text in FILES.items():
        (folder / name).write_text(text)
        out = folder / f"{name}.out"
        out.mkdir()
        jobs[name] = reader_job(folder / name, out, kind="vehicle")
    run_reader_jobs(list(jobs.values()))
    return {name: finished_export(job).report for name, job in jobs.items()}


@pytest.mark.blender
@pytest.mark.parametrize("name", FILES)
def test_hull_and_turret_are_read_as_they_are_in_the_file(reports: dict[str, FileReport], name: str) -> None:
    report = reports[name]
    assert {row.name: row.use for row in report.rows} == {"hull": "hull", "turret": "turret"}
    has_axes = not name.endswith("s.obj")  # OBJ has none, but no height has five digits
    assert report.size == pytest.approx((6, 3, 1.6) if has_axes else report.size, abs=1e-5)
    assert sorted(report.size) == pytest.approx([1.6, 3, 6], abs=1e-5)
    assert [part.name for part in report.parts if part.name == "turret"]
