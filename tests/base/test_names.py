"""Names carry their nouns (CONTRIBUTING.md, "Names"): what can be counted doesn't grow."""

import ast
from pathlib import Path

from hulldown.conftest import PACKAGES

ROOT = Path(__file__).parents[2]
MODULES = [
    path
    for package in [*PACKAGES, "benchmarks"]
    for path in ([ROOT / package] if package.endswith(".py") else sorted((ROOT / package).rglob("*.py")))
]
MAX_ONE_WORD_SHARE = 0.24  # mostly methods and properties, whose object has the noun
PREPOSITIONS = """
    about above across after against along around at before behind below beside between beyond by for from in into near
    of off on onto out over per through to under until up upon via with within without
"""
# Names that end in a preposition, and why.
ALLOWED = {
    "of": "a second constructor, `GroundFaces.from_mesh(mesh)`, which the type completes",
    "out": "Blender's word for a node's output",
    "has_look_at": "the field `look_at` of a user's file",
    "first_face_below": "the face below each point",
    "_start_above": "rays start above each point",
}


def functions():
    for path in MODULES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not node.name.startswith("__"):
                yield f"{path.relative_to(ROOT)}:{node.lineno}", node.name


def test_few_functions_have_one_word():
    names = [name for _, name in functions()]
    assert sum("_" not in name.strip("_") for name in names) <= MAX_ONE_WORD_SHARE * len(names)


def test_no_function_ends_in_a_preposition():
    names = [(place, name) for place, name in functions() if name not in ALLOWED]
    assert [name for name in names if name[1].split("_")[-1] in PREPOSITIONS.split()] == []


def is_number(value):
    parts = list(ast.walk(value))
    constants = [part.value for part in parts if isinstance(part, ast.Constant)]
    arithmetic = ast.Constant | ast.BinOp | ast.UnaryOp | ast.operator | ast.unaryop
    return all(isinstance(part, arithmetic) for part in parts) and all(type(value) in (int, float) for value in constants)


def test_a_number_has_its_quantity_and_its_unit_or_bound():
    bare = [
        (path.relative_to(ROOT), name.id)
        for path in MODULES
        for node in ast.parse(path.read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and is_number(node.value)
        for name in node.targets
        if isinstance(name, ast.Name) and name.id.isupper() and "_" not in name.id.strip("_") and name.id != "GIB"
    ]
    assert bare == []
