"""The rooms import in one direction: studies -> geometry, problems -> iga; sources never import each other."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {
    "iga": {"iga"},
    "geometry": {"iga", "geometry"},
    "problems": {"iga", "problems"},
    "studies": {"iga", "geometry", "problems", "studies"},
}
SOURCES = {path.parent.name for path in (ROOT / "geometry").glob("*/source.py")}
FILES = sorted(path for room in ALLOWED for path in (ROOT / room).rglob("*.py"))


def imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} uses a relative import"
            names.add(node.module or "")
    return names


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_one_way(path: Path) -> None:
    parts = path.relative_to(ROOT).parts
    for name in imports(path):
        top = name.split(".")[0]
        if top in ALLOWED:
            assert top in ALLOWED[parts[0]], f"{name} must not be imported here"
        if parts[0] == "geometry" and len(parts) > 2 and top == "geometry" and name.count("."):
            other = name.split(".")[1]
            assert other == parts[1] or other not in SOURCES, f"source {other} must not be imported"


def test_rooms_are_at_most_two_folders_deep() -> None:
    for path in FILES:
        assert len(path.relative_to(ROOT).parts) <= 3


def test_no_nameless_modules() -> None:
    assert not {path.name for path in FILES} & {"utils.py", "base.py", "common.py", "helpers.py", "misc.py"}
