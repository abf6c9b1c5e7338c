"""Files from outside are opened and parsed by base/outside.py alone, and whatever they contain ends soon."""

import ast
import os
from functools import partial
from pathlib import Path

import pytest

from hulldown.base.errors import HulldownError
from hulldown.base.outside import json_of, read_file, read_json, read_text, toml_of, xml_of, yaml_of
from hulldown.conftest import PYPROJECT

ROOT = Path(__file__).parents[1]
# What opens or parses a file, by the end of its name in code.
OPENING = {
    "open", "read_text", "read_bytes", "loads", "load", "decode_json", "Decoder", "model_validate_json", "from_file",
    "ElementTree.parse", "fromstring", "VideoCapture", "imread", "fromfile", "memmap", "VideoInfo.from_video_path",
}  # fmt: skip
PARSERS = {"yaml", "tomllib", "pickle", "shelve", "marshal", "xml.sax", "xml.dom"}
# Exceptions, with their reasons.
ALLOWED = {
    "base/files.py": "opens files itself",
    "base/outside.py": "opens and parses files itself",
    "base/child.py": "its own log",
    "base/code.py": "hulldown's own code",
}


def calls(path):
    """The dotted names of what a module calls, and the modules that it imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Call):
            yield node.lineno, ast.unparse(node.func)
        elif isinstance(node, ast.Import):
            yield from ((node.lineno, f"import {name.name}") for name in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.lineno, f"import {node.module}"
