"""What must stay, in words: tiles, rectangles, drawings and several of them; plans in searches."""

import json
from pathlib import Path

import pytest

from qdenv.cli.main import run
from qdenv.configurations import find_preset
from qdenv.grid import draw
from qdenv.ops.options import read_plan
from qdenv.study.options import keep_from
from qdenv.study.plans import resolve_plan
from qdenv.types import InputError

ROWS = ("w.........#", "..e@e.e@e.#", "..e@e.e@e.i", "o.........#")
STAYS = ("w?????????#", "??????????#", "??????????i", "o?????????#")
SMALL = "--agents 4 --timesteps 20 --simulations 1 --steps 6 --hidden 4 --emitters 1 --batch 4"


@pytest.fixture
def plan(folder):
    Path("plan.txt").write_text("\n".join(ROWS))
    return read_plan("plan.txt")


def kept(plan, keep):
    return plan.fitted(keep=keep).config.keep


def test_walls_and_stations_stay_by_themselves(plan):
    assert plan.fitted().config.keep == STAYS


def test_tiles_and_rectangles_add_to_what_stays(plan):
    assert kept(plan, "w") == kept(plan, []) == STAYS
    assert kept(plan, "@")[1] == "???@???@??#"
    # Rows and columns as in Python: the last ones are not included, left out means to the end.
    assert kept(plan, "1:3,2:4")[1] == "??e@??????#" and kept(plan, "1:3,2:4")[3] == STAYS[3]
    assert kept(plan, "3:,:2")[3] == "o.????????#"
    assert kept(plan, "@+3:,:2") == kept(plan, ["3:,:2", "@"])


def test_a_drawing_decides_about_every_cell_and_can_free_a_station(plan):
    Path("keep.csv").write_text("\n".join(["!" + "?" * 10, "?" * 11, "??e????????", "?" * 11]))
    drawn = ("w??????????", "???????????", "??e????????", "???????????")
    for keep in ("keep.csv", Path("keep.csv"), [Path("keep.csv")]):
        assert kept(plan, keep) == drawn
    # Whatever the order, a drawing frees nothing that tiles or rectangles keep.
    for keep in ("keep.csv+io", "i+keep.csv+o"):
        assert kept(plan, keep) == (*drawn[:2], "??e???????i", "o??????????")


@pytest.mark.parametrize(
    ("keep", "reason"),
    [
        ("zz", "give tiles like w#, rows and columns like 0:7,33:40, or the file"),
        ("", "give tiles like w#"),
        ("w++@", "give tiles like w#"),
        ("9:12,0:3", "9:12,0:3: rows FIRST:END up to 4 and columns up to 11, counted from 0"),
        ("3:1,0:3", "3:1,0:3: rows FIRST:END up to 4"),
        ("1:2:3,4", "give tiles like w#"),
        ("1" * 5000 + ":2,0:1", "give tiles like w#"),
        ("gone.txt", "gone.txt: cannot be read"),
        (
            "small.txt",
            "small.txt: the drawing of cells to keep has 1 x 11 cells, the layout 4 x 11",
        ),
        ("other.txt", "'@' is to stay, but the plan holds 'w' there"),
        ("odd.txt", "row 0, column 0: 'q' is not a tile of hall"),
        ("0:4,0:11+@", "no layout obeys the rules with these cells kept"),
    ],
)
def test_what_cannot_stay_is_refused_in_one_line(keep, reason, plan, capsys):
    Path("small.txt").write_text("?" * 11)
    Path("other.txt").write_text("@" + "?" * 10 + ("\n" + "?" * 11) * 3)
    Path("odd.txt").write_text("q" + "?" * 10 + ("\n" + "?" * 11) * 3)
    assert run(["repair", "plan.txt", "--keep", keep, "--shelves", "3"]) == 2
    said = capsys.readouterr().err
    assert reason in said and said.count("\n") == 1


def test_without_a_plan_a_drawing_of_tiles_is_all(plan):
    domain = plan.domain.resized(4, 11, {"shelves": 2})
    with pytest.raises(InputError, match="keep w: this needs a plan: give --plan FILE"):
        keep_from("w", domain)
    Path("keep.txt").write_text("!" + "?" * 10 + ("\n" + "?" * 11) * 3)
    with pytest.raises(InputError, match="'!' stands for a plan's tile: add --plan FILE"):
        keep_from("keep.txt", domain)
    Path("keep.txt").write_text("w" + "?" * 10 + ("\n" + "?" * 11) * 3)
    assert keep_from("keep.txt", domain).config.keep[0] == "w??????????"


@pytest.mark.slow
def test_a_zoo_generator_draws_in_a_hall_under_its_rules(plan):
    grow = ["generate", "zoo:warehouse-even/best", "--plan", "plan.txt", "--keep", "0:2,0:6"]
    assert run([*grow, "--out", "new.json"]) == 0
    new = read_plan("new.json")
    rows = draw(new.layout, new.domain.tiles)
    assert new.domain.name == "hall" and "".join(rows).count("@") == 4
    pairs = zip("".join(kept(plan, "0:2,0:6")), "".join(rows), strict=True)
    assert all(must in ("?", holds) for must, holds in pairs)
    assert run(["check", "new.json"]) == 0
    assert run([*grow, "--rows", "9", "--out", "other.json"]) == 2


def test_a_search_has_the_plans_size_numbers_and_rules(plan):
    config, scaled = resolve_plan(find_preset("quick"), {"evaluations": 9}, plan, "1:2,2:5")
    domain = config.evaluation.domain
    assert (domain.rows, domain.cols, domain.shelves) == (4, 11, 4)
    assert domain.keep == kept(plan, "1:2,2:5") and config.evaluations == 9
    # Four of the preset's forty shelves: a tenth of its axis, and its robots by the area.
    assert config.archive == ((0, 4, 20), (0, 1, 20)) and "4 to" not in scaled
    assert domain.fleet.agents == round(60 * 44 / (17 * 16))
    config, _ = resolve_plan(find_preset("laptop"), {"shelves": 3, "agents": 5}, plan)
    assert (config.evaluation.domain.shelves, config.evaluation.domain.fleet.agents) == (3, 5)
    with pytest.raises(InputError, match="plan gives the size: leave --rows out"):
        resolve_plan(find_preset("quick"), {"evaluation__domain__rows": 9}, plan)


@pytest.mark.slow
def test_train_takes_a_plan(plan):
    command = ["train", "quick", "--plan", "plan.txt", *SMALL.split(), "--evaluations", "8"]
    assert run([*command, "--no-progress", "--out", "run"]) == 0
    content = json.loads(Path("run/best_layout.json").read_text())
    assert content["domain"] == "hall" and content["keep"] == list(STAYS)
    assert [row[-1] for row in content["layout"]] == list("##i#")
    assert run(["check", "run/best_layout.json"]) == 0
