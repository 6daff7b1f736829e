"""Commands about layout files: render, symbols, check, repair and what it says of a plan."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import facts_of, read_layout, refusal
from matplotlib.image import imread

import qdenv
from qdenv.cli.main import run
from qdenv.domains.base import find_domain
from qdenv.io.layouts import write_layout
from qdenv.repairs import recipe

PAGE = Path(__file__).parents[1] / "notebooks" / "how_to" / "layout_files.md"
TILES = ".@ew"
EVEN = ["--domain", "warehouse-even"]
PLAN = [
    "..............",
    "..............",
    "..eee.eee.ee..",
    "..@@@.@@@.@@..",
    "..eee.eee.ee..",
    "..............",
    "..............",
    "..w..w..w..w..",
]
DOORS = ["??????????????"] * 7 + ["??!??!??!??!??"]
WALLS = ["!!!!!!!!!!!!!!", *["!????????????!"] * 6, "!!!!!!!!!!!!!!"]


@pytest.fixture
def folder(folder):
    """A working folder with her plan and her drawings of what must stay."""
    for name, rows in (("plan", PLAN), ("doors", DOORS), ("walls", WALLS)):
        (folder / f"{name}.txt").write_text("\n".join(rows) + "\n")
    return folder


def rows_of(path) -> list[str]:
    return json.loads(path.read_text())["layout"]


def test_a_repair_without_a_drawing_says_that_her_doors_are_gone(folder, capsys):
    assert run(["repair", "plan.txt", *EVEN, "--json", "facts.json"]) == 0
    said = capsys.readouterr().out
    assert "domain warehouse-even" in said
    assert "WARNING: 4 of the plan's 4 workstation cells changed, the first at row 7" in said
    assert "--keep" in said
    assert said.splitlines()[-2:] == ["plan_repaired.json", "facts.json"]
    after = rows_of(folder / "plan_repaired.json")
    assert after[7] == "." * 14 and "".join(after).count("w") == 4
    facts = json.loads((folder / "facts.json").read_text())
    stations = next(one for one in facts["changes"] if one["tile"] == "w")
    assert stations["removed"] == [[7, column] for column in (2, 5, 8, 11)]
    assert stations["placed"] == [[1, 0], [1, 13], [4, 0], [4, 13]]
    assert (stations["before"], stations["after"], stations["name"]) == (4, 4, "workstation")
    assert facts["hamming"] == 8 and facts["valid"] and facts["settings"]["layout"] == "plan.txt"
    # Every listed cell and no other one changed.
    listed = {tuple(cell) for one in facts["changes"] for cell in one["removed"]}
    pairs = ((row, col) for row in range(8) for col in range(14))
    assert listed == {(row, col) for row, col in pairs if PLAN[row][col] != after[row][col]}


def test_her_doors_stay_where_a_drawing_keeps_them(folder, capsys):
    command = ["repair", "plan.txt", *EVEN, "--keep", "doors.txt", "--out"]
    assert run([*command, "kept.txt"]) == 0 and run([*command, "kept.json"]) == 0
    said = capsys.readouterr().out
    assert "WARNING" not in said and "note: 4 new workstation cells" in said
    after = rows_of(folder / "kept.json")
    assert after[7] == PLAN[7] and "".join(after).count("w") == 8
    assert run(["check", "kept.json", "--keep", "doors.txt"]) == 0
    assert run(["check", "kept.txt"]) == 0  # the drawing is beside it
    (folder / "kept.toml").unlink()
    assert run(["check", "kept.txt", *EVEN]) == 1
    assert "in a drawing, --keep FILE" in capsys.readouterr().out


def test_a_repaired_file_remembers_what_must_stay(folder, capsys):
    assert run(["repair", "plan.txt", *EVEN, "--keep", "doors.txt"]) == 0
    content = json.loads((folder / "plan_repaired.json").read_text())
    assert content["keep"] == [*["?" * 14] * 7, "??w??w??w??w??"]
    assert run(["check", "plan_repaired.json"]) == 0
    rows = [row.replace("@", ".", 2) for row in content["layout"]]
    (folder / "later.json").write_text(json.dumps(content | {"layout": rows}))
    capsys.readouterr()
    assert run(["repair", "later.json", "--out", "again.json"]) == 0
    assert "WARNING" not in capsys.readouterr().out
    assert rows_of(folder / "again.json")[7] == PLAN[7]
    for keep in (["??"], ["q" * 14] * 8):
        (folder / "wrong.json").write_text(json.dumps(content | {"keep": keep}))
        assert "its file says must stay" in refusal(["check", "wrong.json"], capsys)


def test_a_drawing_keeps_stations_out_too(folder, capsys):
    """With nothing but her plan on the walls, the frame's own stations are not demanded."""
    assert run(["repair", "plan.txt", "--keep", "walls.txt"]) == 0
    assert "nothing changed" in capsys.readouterr().out
    assert rows_of(folder / "plan_repaired.json") == PLAN


def test_a_plan_that_breaks_rules_is_mended_around_what_is_kept(folder):
    rows = [row.replace("eee.eee.ee", "..e.eee.ee") for row in PLAN]
    (folder / "broken.csv").write_text("\r\n".join(";".join(row) for row in rows))
    assert run(["check", "broken.csv", "--keep", "walls.txt"]) == 1
    command = ["repair", "broken.csv", "--keep", "walls.txt", "--out", "mended.txt", "--shelves"]
    assert run([*command, "9"]) == 0
    after = (folder / "mended.txt").read_text().splitlines()
    assert after[0] == PLAN[0] and after[7] == PLAN[7] and "".join(after).count("@") == 9
    assert run(["check", "mended.txt", "--keep", "walls.txt", "--shelves", "9"]) == 0


def test_a_failed_repair_writes_its_facts_and_no_layout(folder, capsys, monkeypatch):
    real = recipe.repair_layout
    monkeypatch.setattr(recipe, "repair_layout", lambda *how: real(*how)._replace(layout=how[0]))
    command = ["repair", "plan.txt", *EVEN, "--polish", "none", "--json"]
    assert "no feasible layout" in refusal([*command, "facts.json"], capsys)
    facts = json.loads((folder / "facts.json").read_text())
    assert facts["valid"] is False and facts["changes"] == [] and facts["command"] == "repair"
    assert run([*command, "-"]) == 2
    assert json.loads(capsys.readouterr().out)["settings"]["polish"] == "none"
    assert not (folder / "plan_repaired.json").exists()


def test_results_have_a_name_of_their_own_and_replace_nothing_by_themselves(folder, capsys):
    assert run(["repair", "plan.txt", "--keep", "walls.txt"]) == 0
    first = (folder / "plan_repaired.json").read_bytes()
    assert run(["repair", "plan.txt", *EVEN]) == 0
    assert (folder / "plan_repaired.json").read_bytes() == first
    assert (folder / "plan_repaired-2.json").read_bytes() != first
    capsys.readouterr()
    assert run(["repair", "plan.txt", "--out", "plan_repaired.json"]) == 0
    assert "plan_repaired.json (replaced)" in capsys.readouterr().out
    assert "that is what is read" in refusal(["repair", "plan.txt", "--out", "plan.txt"], capsys)
    keep = ["repair", "plan.txt", "--keep", "doors.txt", "--out", "doors.txt"]
    assert "that is what is read" in refusal(keep, capsys)


def test_every_format_is_checked_alike(folder, capsys):
    layout = find_domain("warehouse-even").resized(12, 14).human()
    meanings = find_domain("warehouse-even").meanings
    for ending in (".json", ".txt", ".csv"):
        write_layout(folder / f"human{ending}", layout, TILES, meanings)
        facts = facts_of("check", f"human{ending}")
        assert facts["valid"] and facts["broken"] == [] and facts["command"] == "check"
        assert facts["settings"]["domain"] == "hall"
    capsys.readouterr()
    assert run(["check", "plan.txt", *EVEN, "--json", "facts.json"]) == 1
    assert "1 rule broken" in capsys.readouterr().out
    (broken,) = json.loads((folder / "facts.json").read_text())["broken"]
    assert (broken["row"], broken["column"]) == (1, 0)
    assert broken["message"].startswith(
        "floor where only workstations may stand: 4 cells, the first at row 1, column 0"
    )


def test_a_check_remarks_on_what_is_risky_without_failing(folder, capsys):
    plan = [".........", "w.@e@...w", ".........", ".........", "........."]
    (folder / "pocket.txt").write_text("\n".join(plan))
    facts = facts_of("check", "pocket.txt", "--plot", "pocket.svg")
    said = capsys.readouterr().out
    assert [one["kind"] for one in facts["remarks"]] == ["narrow"]
    assert f"remark: {facts['remarks'][0]['message']}\n" in said
    assert facts["remarks"][0]["cells"] == [[0, 2], [0, 3], [0, 4], [1, 3]]
    assert "two-way aisles" in (folder / "pocket.svg").read_text()


def test_a_plan_without_endpoints_gets_them_beside_its_shelves(folder, capsys):
    (folder / "racks.txt").write_text("......\n.@@@@.\n......\nw....w\n")
    assert run(["check", "racks.txt"]) == 1
    assert "`qdenv repair --keep @`" in capsys.readouterr().out
    refused = refusal(["simulate", "racks.txt", "--robots", "2"], capsys)
    assert "the layout has no endpoint to drive to: repair it with --keep @" in refused
    assert run(["repair", "racks.txt", "--keep", "@", "--out", "served.txt"]) == 0
    assert run(["check", "served.txt"]) == 0
    assert "@@@@" in (folder / "served.txt").read_text()
    # Nothing could be beside shelves.
    (folder / "bare.txt").write_text("......\n")
    assert run(["check", "bare.txt", "--domain", "hall"]) == 1
    assert "--keep @" not in capsys.readouterr().out
    (folder / "bare.txt").write_text("w....w\n")
    assert "--keep @" not in refusal(["simulate", "bare.txt", "--robots", "2"], capsys)


def test_a_layout_of_another_domain_needs_no_option(folder, capsys):
    factory = find_domain("manufacturing").resized(12, 14)
    write_layout(folder / "factory.csv", factory.human(), factory.tiles)
    assert run(["check", "factory.csv"]) == 0
    assert "read as manufacturing (--domain" in capsys.readouterr().out
    uneven = ["layout", "human", "--rows", "9", "--cols", "12", "--domain", "warehouse-uneven"]
    assert run([*uneven, "--out", "un.json"]) == 0
    capsys.readouterr()
    assert run(["check", "un.json", "--shelves", "16"]) == 0
    assert "domain warehouse-uneven: obeys" in capsys.readouterr().out


def test_a_maze_has_no_rules_to_break(folder, capsys):
    (folder / "maze.txt").write_text("###\n# #\n###\n")
    assert facts_of("check", "maze.txt", "--domain", "maze-walls")["rules"] is False
    assert "have no rules, none is broken" in capsys.readouterr().out


@pytest.mark.slow
def test_a_repair_draws_what_changed(folder, capsys):
    command = ["repair", "plan.txt", "--polish", "none"]
    assert run([*command, "--diff", "d.png"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "d.png"
    assert run([*command, "--plot", "--repair-seed", "3", "--out", "r.json"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "r.png"
    assert imread("d.png").shape == imread("r.png").shape


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ending", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")]
)
def test_render_draws_a_plan_of_any_format(ending, start, folder, capsys):
    assert run(["render", "plan.txt", "--out", f"p{ending}"]) == 0
    assert f"p{ending}: 8 x 14, a hall" in capsys.readouterr().out
    assert (folder / f"p{ending}").read_bytes().startswith(start)
    if ending == ".svg":
        drawn = (folder / "p.svg").read_text()
        assert ">shelf: 8 cells<" in drawn and ">workstation: 4 cells<" in drawn  # text stays text


def test_render_names_its_picture_after_the_plan(folder, capsys):
    assert run(["render", "plan.txt"]) == 0 and run(["render", "plan.txt"]) == 0
    said = capsys.readouterr().out
    assert "plan.png: " in said and "plan-2.png: " in said and "replaced" not in said
    height, width = imread("plan.png").shape[:2]
    assert 600 < width < 1200 and 300 < height < width


@pytest.mark.slow
@pytest.mark.parametrize("side", [101, 401])
def test_large_plans_are_drawn_a_few_pixels_a_cell(side, folder):
    domain = find_domain("warehouse-even").resized(side, side)
    write_layout("large.json", domain.human(), TILES)
    assert run(["render", "large.json"]) == 0
    height, width = imread("large.png").shape[:2]
    assert 4 * side <= min(height, width) and max(height, width) < 2400


def test_symbols_lists_every_tile_with_its_meaning(capsys):
    assert run(["layout", "symbols"]) == 0
    said = capsys.readouterr().out
    assert "warehouse-even, warehouse-uneven\n" in said and "maze-walls, maze-entropy\n" in said
    for line in (
        r"'@'\s+shelf\s+drive around it\s+'#'",
        r"'w'\s+workstation\s+drive over it",
        r"'2'\s+station 2\s+drive around it",
        r"'X'\s+wall\s+drive around it\s+'#' '@'",
    ):
        assert re.search(line, said), line
    assert run(["layout", "symbols", "--domain", "manufacturing"]) == 0
    assert "workstation" not in capsys.readouterr().out
    assert run(["layout", "symbols", "--domain", "maze-walls", "--json", "-"]) == 0
    tiles = json.loads(capsys.readouterr().out)["symbols"]
    assert [(tile["symbol"], tile["also"]) for tile in tiles] == [(" ", "."), ("X", "#@")]


def test_the_book_lists_the_symbols_as_they_are():
    section = PAGE.read_text()
    rows = re.findall(r"^\| (hall|warehouse|manufacturing|maze) \| (.+) \|$", section, re.MULTILINE)
    listed = [(domain, *(cell.strip() for cell in row.split("|"))) for domain, row in rows]
    known = []
    for domain, name in (
        ("hall", ""),
        ("warehouse", "-even"),
        ("manufacturing", ""),
        ("maze", "-walls"),
    ):
        for tile in qdenv.layout_symbols(domain + name)["symbols"]:
            cells = quote(tile["symbol"]), tile["tile"], quote(tile["also"]), tile["meaning"]
            known.append((domain, *cells))
    assert listed == known


def quote(cell: str) -> str:
    return ", ".join("blank" if one == " " else f"`{one}`" for one in cell)


def test_the_books_plan_is_kept_as_it_says(folder):
    section = PAGE.read_text().partition("**What must stay.**")[2]
    lines = section.partition("```\n")[2].partition("```")[0].splitlines()
    plan, drawing = zip(*(line.split() for line in lines), strict=True)
    (folder / "plan.txt").write_text("\n".join(plan))
    (folder / "keep.txt").write_text("\n".join(drawing))
    repair = ["repair", "plan.txt", "--keep", "keep.txt+1:3,2:6", "--shelves", "6"]
    assert run([*repair, "--polish", "none"]) == 0
    after = rows_of(folder / "plan_repaired.json")
    assert "".join(after).count("@") == 6 and after[0] == "w...........#"
    assert [row[2:6] for row in after[1:3]] == ["eeee", "@@@@"] and after[2][12] == "i"
    assert run(["check", "plan.txt"]) == 0 and run(["check", "plan_repaired.json"]) == 0


@pytest.mark.slow
def test_baselines_go_to_files_of_their_own_and_say_so(folder, capsys):
    human = ["layout", "human", "--rows", "9", "--cols", "12"]
    assert run(human) == 0 and run(human) == 0
    said = capsys.readouterr().out
    assert "layout.json: 9 x 12, " in said and "layout-2.json: 9 x 12" in said
    assert (folder / "layout-2.png").stat().st_size > 1000
    tile = ["layout", "tile", "layout.json", "--rows", "13", "--cols", "16", "--seed", "4"]
    assert run([*tile, "--out", "t.csv"]) == 0 and run([*tile[:-2], "--repair-seed", "4"]) == 0
    one = read_layout("t.csv", TILES)
    np.testing.assert_array_equal(one, read_layout("layout_tiled.json", TILES))
