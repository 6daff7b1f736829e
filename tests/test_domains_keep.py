"""Cells that stay as they are drawn: in the frame, in the rules, after a repair and a search."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.cli import main as cli
from qdenv.configurations import PRESETS
from qdenv.domains.base import Domain, environment_entropy, find_domain, make_domain
from qdenv.grid import draw, parse
from qdenv.repairs.audit import audit
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.rules import impossible
from qdenv.repairs.settings import RepairConfig
from qdenv.run import loop
from qdenv.run.config import config_from_json, config_to_json, override
from qdenv.study.plans import keep_from
from qdenv.types import InputError

WAREHOUSE = find_domain("warehouse-even").resized(9, 12, {"shelves": 8})
FACTORY = find_domain("manufacturing").resized(9, 12)
# Doors in the bottom wall, an aisle down the middle, a shelf, an outer column without stations.
DRAWINGS = {
    "warehouse-even": (
        ".?????.????.",
        ".?????.????.",
        ".?????.????.",
        ".??@??.????.",
        ".?????.????.",
        ".?????.????.",
        ".?????.????.",
        ".?????.????.",
        ".??w??.??w?.",
    ),
    "manufacturing": (
        "0?????.?????",
        "??????.?????",
        "??????.?????",
        "???2??.?????",
        "??????.?????",
        "??????.?????",
        "??????.?????",
        "??????.?????",
        "??e1??.??0e?",
    ),
}
DOMAINS = {"warehouse-even": WAREHOUSE, "manufacturing": FACTORY}
BOTH = pytest.mark.parametrize("name", DOMAINS)


def keeping(domain: Domain, drawing: tuple[str, ...]) -> Domain:
    return make_domain(dataclasses.replace(domain.config, keep=drawing))


def kept_cells(rows: list[str], drawing: tuple[str, ...]) -> list[tuple[str, str]]:
    """Pair what a layout holds with what the drawing demands, where it demands something."""
    assert [len(row) for row in rows] == [len(row) for row in drawing]
    pairs = zip("".join(rows), "".join(drawing), strict=True)
    return [(held, wanted) for held, wanted in pairs if wanted != "?"]


def holds(rows: list[str], drawing: tuple[str, ...]) -> bool:
    cells = kept_cells(rows, drawing)
    assert len(cells) > 8
    return all(held == wanted for held, wanted in cells)


@BOTH
def test_the_frame_stamps_what_is_kept_on_whatever_is_drawn(name):
    domain, drawing = keeping(DOMAINS[name], DRAWINGS[name]), DRAWINGS[name]
    rng = np.random.default_rng(0)
    for _ in range(5):
        area = rng.integers(0, len(domain.generated), domain.generated_shape).astype(np.int8)
        framed = np.asarray(domain.frame(area))
        assert framed.dtype == np.int8
        assert holds(draw(framed, domain.tiles), drawing)
        free = np.array([[symbol == "?" for symbol in row] for row in drawing])
        plain = np.asarray(DOMAINS[name].frame(area))
        np.testing.assert_array_equal(framed[free], plain[free])


@BOTH
def test_a_repair_keeps_every_cell_and_breaks_no_rule(name):
    domain, rng = keeping(DOMAINS[name], DRAWINGS[name]), np.random.default_rng(1)
    rules = domain.rules()
    for seed in range(4):
        start = rng.integers(0, len(domain.tiles), domain.shape).astype(np.int8)
        found = repair_layout(start, rules, seed, RepairConfig("none"))
        layout = np.asarray(found.layout)
        assert found.status < 4 and audit(layout, rules) == []
        assert holds(draw(layout, domain.tiles), DRAWINGS[name])
        # The domain's own rules say the same of all cells that are free.
        wrong = [one.message for one in audit(layout, DOMAINS[name].rules())]
        assert all("where only" in message for message in wrong)


@BOTH
def test_another_size_forgets_the_drawing_and_the_same_size_does_not(name):
    domain = keeping(DOMAINS[name], DRAWINGS[name])
    assert domain.resized(9, 12).config.keep == DRAWINGS[name]
    assert domain.fitted(np.zeros((9, 12), np.int8)).config.keep == DRAWINGS[name]
    assert domain.resized(10, 12).config.keep == ()
    assert domain.resized(9, 12, domain.numbers) is domain


def test_a_configuration_with_a_drawing_survives_json(tmp_path):
    config = run_config("warehouse-even", tmp_path)
    content = json.loads(json.dumps(config_to_json(config)))
    again = config_from_json(content, tmp_path)
    assert again == config and again.evaluation.domain.keep == DRAWINGS["warehouse-even"]
    del content["evaluation"]["domain"]["keep"]  # written before there was such a thing
    assert config_from_json(content, tmp_path).evaluation.domain.keep == ()


def test_kept_stations_count_as_empty_in_the_entropy():
    """Two cells of three kinds of tile, and a fourth kind that no generator draws."""
    measure = environment_entropy(3)
    drawn, kept = parse(["..@e", ".w.@"], ".@ew"), parse(["..@e", "...@"], ".@ew")
    values = [float(measure.value(jnp.asarray(layout), None)) for layout in (drawn, kept)]
    assert values[0] == values[1] > 0


def run_config(name, tmp_path):
    even = name == "warehouse-even"
    small = {"agents": 4, "timesteps": 20, "rows": 9, "cols": 12} | ({"shelves": 8} if even else {})
    short = {"steps": 6, "hidden": 4, "simulations": 1, "emitters": 1, "batch": 6}
    preset = PRESETS["quick" if even else "manufacturing-quick"]
    config = override(preset, small | short | {"evaluations": 12})
    path = tmp_path / "keep.txt"
    path.write_text("\n".join(DRAWINGS[name]) + "\n")
    kept = keep_from(path, make_domain(config.evaluation.domain))
    return override(config, {"keep": kept.config.keep})


@pytest.mark.slow
@BOTH
def test_a_search_and_what_it_grows_keep_every_cell(name, tmp_path, capsys):
    drawing = DRAWINGS[name]
    run = loop.train(run_config(name, tmp_path), tmp_path / "run", progress=False)
    archive = run.archive.columns
    assert len(archive["repaired"]) > 0
    for layout in archive["repaired"]:
        assert holds(draw(layout, run.schema.tiles), drawing)
        assert audit(layout, make_domain(run.config.evaluation.domain).rules()) == []
    best = json.loads((run.path / "best_layout.json").read_text())["layout"]
    assert holds(best, drawing)
    capsys.readouterr()

    out = tmp_path / "grown.json"
    grow = ["generate", str(run.path), "--out", str(out)]
    assert cli.run(grow) == 0
    assert json.loads(out.read_text())["layout"] == best
    assert cli.run(["check", str(out), "--keep", str(tmp_path / "keep.txt")]) == 0
    for path in (out, run.path / "best_layout.json"):
        assert cli.run(["check", str(path)]) == 0  # the files remember what was kept
    # Another size keeps what is drawn for it, and nothing else.
    larger = tuple("?" * 14 for _ in range(10)) + (
        ("???w??w????w??",) if name == "warehouse-even" else ("e0????????????",)
    )
    (tmp_path / "larger.csv").write_text("\n".join(";".join(row) for row in larger))
    size = ["--rows", "11", "--cols", "14"]
    assert cli.run([*grow, *size, "--keep", str(tmp_path / "larger.csv")]) == 0
    cells = kept_cells(json.loads(out.read_text())["layout"], larger)
    assert len(cells) in (2, 3) and all(held == wanted for held, wanted in cells)
    assert cli.run([*grow, *size, "--keep", str(tmp_path / "keep.txt")]) == 2
    assert "has 9 x 12 cells, the layout 11 x 14" in capsys.readouterr().err


@pytest.mark.slow
def test_train_takes_a_drawing(tmp_path, capsys):
    path, out = tmp_path / "keep.txt", tmp_path / "run"
    path.write_text("\n".join(DRAWINGS["warehouse-even"]))
    small = ["--agents", "4", "--timesteps", "20", "--evaluations", "10", "--simulations", "1"]
    small += ["--steps", "6", "--hidden", "4", "--emitters", "1", "--no-progress"]
    command = ["train", "quick", *small, "--keep", str(path), "--out", str(out)]
    assert cli.run(command) == 2
    assert "has 9 x 12 cells, the layout 17 x 16" in capsys.readouterr().err
    assert not out.exists()
    assert cli.run([*command, "--rows", "9", "--cols", "12"]) == 0
    best = json.loads((out / "best_layout.json").read_text())["layout"]
    assert holds(best, DRAWINGS["warehouse-even"])


PLAN = parse(["w..@e..w", "...ee...", "w......w"], ".@ew")
SMALL = find_domain("warehouse-even").fitted(PLAN)


@pytest.mark.parametrize(
    ("rows", "plan", "reason"),
    [
        (["????????"] * 2, True, "has 2 x 8 cells, the layout 3 x 8"),
        (["????????", "???", "????????"], True, "has 3 x 8 cells"),
        (["????????", "??q?????", "????????"], True, "row 1, column 2: 'q' is not a tile of ware"),
        (["????????", "?? ?????", "????????"], True, "row 1, column 2: ' ' is not a tile"),
        (["????????", "??@?????", "????????"], True, r"row 1, column 2: '@' is to stay, but the"),
        (["????????", "??!?????", "????????"], False, "row 1, column 2: '!' stands for a plan"),
        (
            ["????????", "?@@.????", "?@.@????"],
            False,
            "the number of shelves must be at most 1 but 4 are fixed",
        ),
        (
            ["????????", "??@@????", "????????"],
            False,
            "the number of shelves must be at most 1 but 2 are fixed",
        ),
        (["???w????", "??w@w???", "???w????"], False, "at row 1, column 3 needs"),
        (["????????", "@???????", "????????"], False, "at row 1, column 0 needs"),
    ],
)
def test_impossible_drawings_are_refused_in_one_line_that_names_a_cell(
    rows, plan, reason, tmp_path
):
    path = tmp_path / "keep.txt"
    path.write_text("\n".join(rows))
    with pytest.raises(InputError, match=reason) as error:
        keep_from(path, SMALL, PLAN if plan else None)
    assert str(error.value).startswith(f"{path}: ") and "\n" not in str(error.value)


def test_a_drawing_that_cuts_the_floor_in_two_is_refused(tmp_path):
    domain = find_domain("manufacturing").resized(3, 5)
    path = tmp_path / "keep.txt"
    path.write_text(".e0e.\n.e1e.\n.e2e.\n")
    with pytest.raises(InputError, match="fixed obstacles cut row 0, column 3 off"):
        keep_from(path, domain)


def test_rules_whose_fixed_tiles_have_no_neighbour_to_need_are_impossible():
    small = find_domain("manufacturing").resized(3, 3)
    rules = keeping(small, ("???", ".e.", "?.?")).rules()
    assert impossible(rules) is None  # a station may stand above
    rules = keeping(small, ("?.?", ".e.", "?.?")).rules()
    assert impossible(rules) == (
        "endpoint at row 1, column 1 needs station 0, station 1 or station 2 beside it, "
        "which no cell there may hold"
    )
    alone = RepairConfig("none")
    assert int(repair_layout(np.zeros((3, 3), np.int8), rules, 0, alone).status) == 4


def test_a_maze_keeps_walls_without_any_rules(tmp_path):
    domain = find_domain("maze-walls").resized(6, 6)
    path = tmp_path / "keep.txt"
    path.write_text("??????\n?#X???\n??????\n??????\n??????\n??????\n")
    kept = keep_from(path, domain)
    framed = draw(np.asarray(kept.frame(np.zeros((4, 4), np.int8))), domain.tiles)
    assert framed == ["XXXXXX", "XXX  X", "X    X", "X    X", "X    X", "XXXXXX"]
