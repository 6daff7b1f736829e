"""The import rules of the package: stages never import one another, and so on."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "qdenv"

FREE = {"cli", "commands", "bench", "__init__", "__main__"}  # may import everything
BASE = {"types", "grid", "files"}
STAGES = {"generate", "repair", "simulate", "score"}
ALLOWED = {
    "types": set(),
    "grid": {"types"},
    "files": {"types"},
    "native": set(),
    "formats": BASE,
    "generate": {"types", "grid"},
    "repair": {"types", "grid", "native"},
    "simulate": {"types", "grid", "native"},
    "score": {"types", "grid"},
    "agent": BASE | {"simulate", "score"},
    "domains": STAGES | BASE,
    "pipeline": STAGES | BASE | {"domains.base"},
    "search": BASE,
    "run": BASE | STAGES | {"search", "pipeline", "domains", "formats"},
    "presets": {"domains", "search", "run", "types"},
    "plots": BASE | {"run.records"},
    "report": BASE | {"run.records", "plots"},
}


def unit(path: Path) -> str:
    """Name the unit a file belongs to: its folder, or its own name at the top."""
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def imported(path: Path) -> list[tuple[int, str]]:
    """List (line, dotted name) of everything a file imports."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno} imports relatively"
            found += [(node.lineno, f"{node.module}.{alias.name}") for alias in node.names]
    return found


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path))
def test_import_rules(path: Path):
    own = unit(path)
    for line, name in imported(path):
        parts = name.split(".")
        assert parts[0] not in ("experiments", "notebooks", "tests"), f"{path}:{line}"
        if parts[0] != "qdenv" or len(parts) == 1 or own in FREE:
            continue
        target = ".".join(parts[1:])
        allowed = ALLOWED[own] | {own}
        ok = any(target == rule or target.startswith(f"{rule}.") for rule in allowed)
        assert ok, f"{path}:{line}: {own} may not import {name}"


def test_every_unit_has_a_rule():
    units = {unit(path) for path in PACKAGE.rglob("*.py")}
    assert units <= set(ALLOWED) | FREE


def test_no_pickle_and_no_fork():
    for path in PACKAGE.rglob("*.py"):
        for line, name in imported(path):
            # The converter of published checkpoints restricts an Unpickler; nothing else may.
            if name.split(".")[0] == "pickle":
                assert path.name == "convert.py", f"{path}:{line} imports pickle"
            assert name.split(".")[0] != "multiprocessing", f"{path}:{line}"
        assert "os.fork" not in path.read_text(), path
