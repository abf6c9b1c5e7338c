"""Files from outside are opened and parsed in one place, and whatever they contain ends soon."""

import ast
import re
import subprocess
import sys
from pathlib import Path

from hulldown.base.outside import parse_yaml
from hulldown.conftest import PACKAGES

ROOT = Path(__file__).parents[2]
# What opens a file for reading, or parses one.
OPENS = re.compile(
    r"open|.*\.(open|read_text|read_bytes|imread|VideoCapture|fromfile|memmap|from_video_path|model_validate_json)"
    r"|(json|orjson|pickle|np|torch|yaml|tomllib|marshal)\.(load|loads)"
    r"|msgspec\.(convert|(json|yaml|toml|msgpack)\.(decode|Decoder))"
    r"|ElementTree\.(parse|fromstring|XML|iterparse)|expat\.ParserCreate"
)
# Modules with their own calls.
ALLOWED = {
    # Open regular files, and read them.
    **dict.fromkeys(("base/files.py", "base/outside.py"), ""),
    # Parse what was opened there, by a library of their own.
    "assets/bundle.py": "np.load",
    "assets/picture_files.py": "Image.open",
    "plan/row.py": "msgspec.json.Decoder",
    "plan/lines.py": "msgspec.json.decode",
    "reading/confinement/blocks.py": "gzip.open",
    "training/detectors/detector.py": "torch.load",
    # Give paths of regular files to a library.
    "reading/scenery/geotiff.py": "rasterio.open",
    "training/input_pictures.py": "cv2.VideoCapture",
    # Read what this process or a part of hulldown wrote.
    **dict.fromkeys(("base/child.py", "base/code.py", "plan/config/config_keys.py", "training/onnx_model.py"), ""),
    **dict.fromkeys(("dataset/store/document.py", "dataset/store/placed_pictures.py", "reading/hdri.py"), ""),
    **dict.fromkeys(("cluster/workers.py", "verbs/output.py"), ""),
    "reading/confinement/landlock.py": "the standard library alone",
}
OURS = {"CocoDataset", "cls"}  # whose `open` is no file's


def opened(path):
    """Line and name of each call in a module that opens a file for reading, or parses one."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            name, owner = ast.unparse(node.func), ast.unparse(getattr(node.func, "value", node.func))
            writes = any(isinstance(a, ast.Constant) and str(a.value)[:1] in "wx" for a in node.args)
            encoded = node.args and ast.unparse(node.args[0]).startswith(("encode_line(", "io.BytesIO("))
            if OPENS.fullmatch(name) and not (writes or encoded or owner in OURS):
                yield node.lineno, name


def test_files_are_opened_and_parsed_in_one_place():
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for package in PACKAGES
        for path in ([ROOT / package] if package.endswith(".py") else sorted((ROOT / package).rglob("*.py")))
        if "blender" not in path.parts and package not in ("py.typed", "demo")
        if str(path.relative_to(ROOT)) not in ALLOWED
        for line, name in opened(path)
    ]
    assert found == []


# Three threads meet a type that holds five others, 30 times. Without the lock of `convert_value`, msgspec crashes.
MEETING = """
import sys, threading
import msgspec
from hulldown.base.outside import convert_value

sys.setswitchinterval(1e-7)
VALUE = 1
for _ in range(6):
    VALUE = {**dict.fromkeys(map(str, range(10)), 1), "of": VALUE}
for _ in range(30):
    kind = int
    for depth in range(6):
        named = [(str(i), int) for i in range(10)]
        kind = msgspec.defstruct(f"Level{depth}", [("of", kind), *((f"n{i}", int) for i in range(10))],
                                 rename={f"n{i}": str(i) for i in range(10)})
    together = threading.Barrier(3)
    threads = [threading.Thread(target=lambda: (together.wait(), convert_value(VALUE, kind))) for _ in range(3)]
    for thread in threads: thread.start()
    for thread in threads: thread.join()
"""


def test_threads_meet_a_type_for_the_first_time_together():
    subprocess.run([sys.executable, "-P", "-c", MEETING], check=True)


def test_yaml_has_no_numbers_to_the_base_of_60():
    assert parse_yaml("ratio: 1:36") == {"ratio": "1:36"}
