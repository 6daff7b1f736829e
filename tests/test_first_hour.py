"""An engineer's first hour as commands: her own plan, looked at, checked, mended, judged."""

import json

import numpy as np
import pytest

from qdenv.cli.main import run
from qdenv.domains.base import find_domain
from qdenv.io.layouts import read_layout
from qdenv.repair.audit import audit

pytestmark = pytest.mark.slow

# Doors in the bottom wall, dead ends between the shelves, and two shelves that nobody can serve.
PLAN = """\
................
..e@@e@@e@@e@@..
..e@@e@@e@@e@@..
..e@@e@@e@@e@@..
..@@@@@@@@@@@@..
................
..e@e@e@e@e@@@..
................
..w...w..w...w..
"""
DOORS = [(8, 2), (8, 6), (8, 9), (8, 13)]
TILES = ".@ew"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("office")
    (folder / "plan.txt").write_text(PLAN)
    keep = [["?"] * 16 for _ in range(9)]
    for row, column in DOORS:
        keep[row][column] = "!"
    # Nobody wants other doors: the outer columns and the wall with the doors stay as they are.
    for row in range(9):
        keep[row][0] = keep[row][15] = "!"
    keep[8] = ["!"] * 16
    (folder / "keep.txt").write_text("\n".join("".join(row) for row in keep))
    return folder


@pytest.fixture(autouse=True)
def there(folder, monkeypatch):
    monkeypatch.chdir(folder)


def test_she_looks_at_it(folder, capsys):
    assert run(["render", "plan.txt", "--out", "plan.png"]) == 0
    assert (folder / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert "plan.png" in capsys.readouterr().out


def test_she_checks_it(folder, capsys):
    assert run(["check", "plan.txt", "--json", "check.json"]) == 1
    said = capsys.readouterr().out
    assert "row" in said and "rules broken" in said
    assert json.loads((folder / "check.json").read_text())["valid"] is False


def test_she_asks_where_it_jams(folder, capsys):
    command = ["simulate", "plan.txt", "--agents", "20", "--timesteps", "100", "--seeds", "2"]
    command += ["--plot", "--json", "facts.json", "--seconds-per-step", "2"]
    assert run(command) == 0
    said = capsys.readouterr().out
    facts = json.loads((folder / "facts.json").read_text())
    assert facts["valid"] is True and facts["domain"] == "warehouse-even"
    assert "tasks per timestep" in said and "tasks per hour" in said
    assert facts["verdict"] and len(facts["worst_cells"]) == 10
    pictures = [path for path in folder.glob("*.png") if path.name != "plan.png"]
    assert len(pictures) == 1 and pictures[0].name in said


def test_she_mends_it_and_her_doors_stay(folder, capsys):
    assert run(["repair", "plan.txt", "--keep", "keep.txt", "--out", "new.json"]) == 0
    said = capsys.readouterr().out
    before, after = (read_layout(folder / name, TILES) for name in ("plan.txt", "new.json"))
    assert (before != after).any() and "new.json" in said
    assert (after == TILES.index("w")).sum() == len(DOORS)
    assert all(after[door] == TILES.index("w") for door in DOORS)
    # Every rule holds but where stations stand, which is as she drew it.
    rules = find_domain("warehouse-even").fitted(before).rules()
    kept = np.ones(before.shape, bool)
    kept[:8, 1:15] = False
    allowed = np.where(kept[..., None], np.eye(4, dtype=bool)[before], rules.allowed)
    assert audit(after, rules._replace(allowed=allowed)) == []


def test_without_a_drawing_she_is_told_that_her_doors_moved(capsys):
    assert run(["repair", "plan.txt", "--out", "other.json"]) == 0
    said = capsys.readouterr().out
    assert "workstation" in said and "--keep" in said


def test_she_asks_whether_that_is_better(folder, capsys):
    command = ["compare", "plan.txt", "new.json", "--agents", "20", "--timesteps", "100"]
    assert run([*command, "--seeds", "3", "--out", "compare.csv"]) == 0
    said = capsys.readouterr().out
    assert "%" in said and "compare.csv" in said
    assert (folder / "compare.png").exists()
