"""Formats of other programs: read, written, read back; what is left out is named."""

import json
import os
import shutil
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from conftest import STUDY_DATA
from small_warehouse import ROWS, TILES

import qdenv as package
from qdenv.cli.main import run as qdenv
from qdenv.domains.base import find_domain
from qdenv.grid import parse
from qdenv.io.formats import FORMATS
from qdenv.io.guidance import weights_of
from qdenv.io.layouts import Drawing, read_drawing
from qdenv.study.plans import read_plan
from qdenv.types import InputError

EVEN = find_domain("warehouse-even")
FILES = STUDY_DATA / "formats"
LAYOUTS = sorted((STUDY_DATA / "layouts").glob("*.json"))
MAPS = sorted(FILES.glob("*.map"))
there = pytest.mark.skipif(not FILES.exists(), reason="no files here (QDENV_STUDY_DATA names them)")


@pytest.fixture
def plan(tmp_path):
    """A small warehouse with costs of moves, a fact, and robots."""
    path, free = tmp_path / "plan.json", EVEN.drivable(parse(ROWS, TILES))
    costs = np.where(free, np.random.default_rng(0).integers(1, 9, (5, *free.shape)), np.inf)
    content = {"name": "mine", "layout": ROWS, "weights": weights_of(costs), "domain": EVEN.name}
    content |= {"starts": [1, 2], "tasks": [[2, 1], [1]]}
    path.write_text(json.dumps(content))
    return path


def convert(*words):
    assert qdenv(["convert", *map(str, words)]) == 0


def same(path, other, form=None, **changes):
    """Compare two files, as commands read them, and what is beside the tiles."""
    drawings = read_drawing(path), read_drawing(other, form)
    one, two = read_plan(path), read_plan(other, drawing=drawings[1])
    assert one.layout.tolist() == two.layout.tolist()
    for name in {"weights", "starts", "tasks", "details"} - {*changes}:
        assert getattr(drawings[0], name) == getattr(drawings[1], name), name
    for name, value in changes.items():
        assert getattr(drawings[1], name) == value, name


@pytest.mark.parametrize(
    ("name", "form", "changes"),
    [
        ("a.json", None, {}),
        ("a.csv", None, {"starts": (), "tasks": (), "details": {}}),
        ("a.txt", None, {"weights": None, "starts": (), "tasks": (), "details": {}}),
        ("a.map", "rhcr", {"weights": None, "tasks": (), "details": {"maxtime": 5000}}),
        ("a.map", "lorr", {"weights": None, "starts": (), "tasks": (), "details": {}}),
        ("a.json", "lorr", {"weights": None, "details": {"name": "mine", "numTasksReveal": 1.5}}),
    ],
)
def test_a_warehouse_comes_back_and_what_is_lost_is_named(name, form, changes, plan, capsys):
    target = plan.with_name(name)
    convert(plan, target, *(["--format", form] if form else []))
    said = capsys.readouterr().out
    words = {"weights": "costs of moves are left out", "starts": "the robots' starts are left out"}
    words |= {"tasks": "tasks are left out", "details": "facts (name) are left out"}
    for part, line in words.items():
        gone = (part in changes and not changes[part]) or (part, form) == ("details", "rhcr")
        assert (f": {line}\n" in said) == gone, part
    same(plan, target, **changes)


def test_costs_of_moves_survive_a_grid(plan):
    convert(plan, plan.with_name("a.grid"))
    again = read_drawing(plan.with_name("a.grid"))
    assert again.weights == read_drawing(plan).weights and again.starts == (1, 2)
    assert plan.with_name("a.grid").read_text().startswith("Grid size (x, y)\n7,11\nid,type,x,y,")
    (plan.parent / "sort.txt").write_text("i..\n..o\n")
    convert(plan.parent / "sort.txt", plan.with_name("b.grid"))
    _, _, head, first, *others = plan.with_name("b.grid").read_text().splitlines()
    assert head.startswith("id,type,station,x,y,") and first.startswith("0,Induct,0,0,0,")
    assert others[0].startswith("1,Travel,None,") and others[-1].startswith("5,Eject,5,")
    assert read_drawing(plan.with_name("b.grid")).rows == ["i..", "..o"]


def test_a_map_loses_stations_in_one_line_and_needs_no_flag(plan, capsys):
    convert(plan, plan.with_name("a.map"))
    lines = capsys.readouterr().out.splitlines()
    assert "movingai: what tells floor, endpoint, workstation apart ('.') is left out" in lines
    rows = read_drawing(plan.with_name("a.map")).rows
    assert rows == ["".join(".#"[one == "@"] for one in row) for row in ROWS]
    convert(plan, plan.with_name("p.txt"), "--format", "pogema")
    assert read_drawing(plan.with_name("p.txt"), "pogema").rows == rows


def test_what_stands_beside_a_file_is_not_what_is_read(plan, capsys):
    folder = plan.parent
    convert(plan, folder / "a.json", "--format", "lorr")
    before = (folder / "a.map").read_bytes()
    assert qdenv(["convert", str(folder / "a.map"), str(folder / "a.scen")]) == 2
    assert "a.map: that is what is read" in capsys.readouterr().err
    assert (folder / "a.map").read_bytes() == before


def test_every_file_that_is_written_is_named_and_replaces_none_of_another_kind(plan, capsys):
    target, road = plan.with_name("a.json"), plan.with_name("h.yaml")
    for replaced in ("", " (replaced)"):
        convert(plan, target, "--format", "lorr")
        lines = capsys.readouterr().out.splitlines()
        assert lines[-3:] == [
            f"{target.with_suffix(one)}{replaced}" for one in (".map", ".agents", ".tasks")
        ]
    convert(plan, road, "--format", "rmf")
    before = road.read_bytes()
    assert qdenv(["convert", str(plan), str(plan.with_name("h.pgm"))]) == 2
    assert f"{road}: " in capsys.readouterr().err and road.read_bytes() == before


def test_starts_and_tasks_go_from_one_benchmark_to_another(plan):
    folder = plan.parent
    convert(plan, folder / "a.json", "--format", "lorr")
    convert(folder / "a.json", folder / "b.scen")
    scenario = read_drawing(folder / "b.scen")
    assert scenario.starts == (1, 2) and scenario.tasks == ((2,), (1,))
    assert scenario.lost == ("buckets and lengths of paths are",)
    (folder / "p.txt").write_text("a.#B\nb.#A\n")
    robots = read_drawing(folder / "p.txt", "pogema")
    assert robots == Drawing(["..#.", "..#."], starts=(0, 4), tasks=((7,), (3,)))


def test_blocks_without_a_service_point_are_walls(tmp_path):
    path = tmp_path / "a.map"
    path.write_text("type octile\nheight 3\nwidth 7\nmap\n@@.@@SE\n@T.@@..\n...@@..\n")
    assert read_drawing(path).rows == ["##.@@ew", "##.@@..", "...@@.."]


def test_what_a_map_of_the_league_cannot_say_is_named(tmp_path, capsys):
    plan = tmp_path / "plan.txt"
    for rows, lost in [("@e.\n..w", ""), ("@e.\n...", "endpoint, shelf"), ("@.e\n..w", "shelf")]:
        plan.write_text(rows)
        convert(plan, tmp_path / "a.map", "--format", "lorr")
        line = f"lorr: what some cells are ({lost}) is left out\n"
        assert (line in capsys.readouterr().out) == bool(lost)
        assert (read_drawing(tmp_path / "a.map").rows == rows.split()) == (not lost)


def test_a_layout_may_come_through_a_pipe(tmp_path):
    reading, writing = os.pipe()
    os.write(writing, "\n".join(ROWS).encode())
    os.close(writing)
    convert(f"/dev/fd/{reading}", tmp_path / "plan.json", "--input-format", "text")
    os.close(reading)
    assert read_drawing(tmp_path / "plan.json").rows == ROWS


def test_python_converts_an_array_without_a_file(tmp_path):
    found = package.convert(parse(ROWS, TILES), tmp_path / "a.map", "rhcr", domain="warehouse-even")
    assert found["format"] == "rhcr" and found["left_out"] == []
    assert read_drawing(tmp_path / "a.map").rows == ROWS


@pytest.mark.slow
@there
@pytest.mark.parametrize("path", LAYOUTS, ids=lambda path: path.stem)
def test_published_layouts_come_back_with_all_their_keys(path, tmp_path):
    convert(path, tmp_path / "a.json")
    ours, theirs = (json.loads(one.read_text()) for one in (tmp_path / "a.json", path))
    rows = theirs["layout"]
    assert ours == theirs | {"n_row": len(rows), "n_col": len(rows[0])}
    for name in ("a.csv", "a.txt"):
        convert(path, tmp_path / name)
        same(tmp_path / name, path, details=read_drawing(path).details)


@there
@pytest.mark.parametrize("path", MAPS, ids=lambda path: path.stem)
def test_maps_come_back(path, tmp_path):
    form = {"rhcr": "rhcr", "lorr": "lorr"}.get(path.stem.partition("_")[0], "lorr")
    convert(path, tmp_path / "a.map", "--format", form)
    same(path, tmp_path / "a.map", lost=())
    if form == "rhcr":
        convert(path, tmp_path / "a.grid")
        assert read_drawing(tmp_path / "a.grid").rows == read_drawing(path).rows


@there
def test_problems_and_scenarios_come_back(tmp_path):
    for name in ("maps", "agents", "tasks"):
        (tmp_path / name).mkdir()
        for path in FILES.glob(f"lorr_*.{name.removesuffix('s') if name == 'maps' else name}"):
            shutil.copy(path, tmp_path / name / path.name.removeprefix("lorr_"))
    shutil.copy(FILES / "lorr_maze-example_40.json", tmp_path / "theirs.json")
    convert(tmp_path / "theirs.json", tmp_path / "ours.json", "--format", "lorr")
    same(tmp_path / "theirs.json", tmp_path / "ours.json")
    assert len(read_drawing(tmp_path / "ours.json").tasks) == 160
    for name in ("random-32-32-20.map", "random-32-32-20-random-1.scen"):
        shutil.copy(FILES / f"planviz_{name}", tmp_path / name)
    convert(tmp_path / name, tmp_path / "scenario.scen")
    same(tmp_path / name, tmp_path / "scenario.scen")
    first = (tmp_path / "scenario.scen").read_text().splitlines()[1].split("\t")
    assert first[2:8] == (tmp_path / name).read_text().splitlines()[1].split("\t")[2:8]


BAD = {
    "a.scen": [("", "first line is its version"), ("version 1\n0\tm.map\t1", "a line is bucket")],
    "a.grid": [("", "not a map of RHCR"), ("Grid size (x, y)\n9,9\nid\n0", "a line is not a cell")],
    "a.map": [
        ("2,2\n0\n0\n9\n..\n", "the head says 2 x 2"),
        ("1001,1\n0\n0\n9\n.", "not supported"),
    ],
    "a.json": [
        ('{"mapFile": 1}', "names its mapFile"),
        ('{"layout": [".."], "tasks": 1}', "tasks"),
        ('{"layout": [".."], "keep": "w"}', "keep: cannot be read"),
        ('{"layout": [".."], "facts": 1}', "facts: cannot be read"),
    ],
}


@pytest.mark.parametrize("name", BAD)
def test_wrong_files_are_refused_in_one_line(name, tmp_path):
    path = tmp_path / name
    for content, reason in BAD[name]:
        path.write_text(content)
        with pytest.raises(InputError, match=reason) as error:
            read_drawing(path)
        assert str(path) in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["", "/", "m" * 300])
def test_a_scenario_without_a_name_of_a_map_is_refused(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.scen").write_text(f"version 1\n0\t{name}\t2\t2\t0\t0\t1\t1\t1\n")
    with pytest.raises(InputError, match="cannot be read"):
        read_drawing("a.scen")


@pytest.mark.parametrize("facts", [1, "x", [1]])
def test_facts_of_a_problem_are_an_object(facts, tmp_path):
    for ending, text in ((".map", "type octile\nmap\n..\n"), (".agents", "0"), (".tasks", "0")):
        (tmp_path / f"a{ending}").write_text(text)
    names = {f"{name}File": f"a.{name}s" for name in ("agent", "task")}
    content = {"mapFile": "a.map", **names, "facts": facts}
    (tmp_path / "a.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="facts: cannot be read"):
        read_drawing(tmp_path / "a.json")


def test_a_picture_that_is_too_large_is_refused_without_a_warning(tmp_path, recwarn):
    head = b"IHDR" + struct.pack(">IIBBBBB", 10_000, 10_000, 8, 2, 0, 0, 0)
    chunks = [head, b"IDAT", b"IEND"]
    parts = [struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks]
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))
    with pytest.raises(InputError, match="more than 1000 rows"):
        read_drawing(tmp_path / "a.png")
    assert not recwarn.list


def test_every_format_reads_or_writes():
    assert all(one.read or one.write for one in FORMATS.values())
