"""Values that Python functions take and give: layouts, plans, numbers of numpy, and wrong ones."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

import qdenv
from qdenv.ops.output import UnsolvedError
from qdenv.types import InputError

HALL = """+++
robots = 4
cell = 2.5
keep = "0:5,0:3"
shelves = "2:4"
+++
w........
..@e..@e.
..@e..@e.
.........
........w
"""


@pytest.fixture
def hall(tmp_path):
    path = tmp_path / "hall.txt"
    path.write_text(HALL)
    return path


def test_a_layout_means_what_its_file_means(hall, tmp_path):
    drawn = qdenv.render(hall)
    plan, again = qdenv.read_plan(hall), qdenv.read_plan(drawn)
    assert (again.facts.robots, again.facts.cell, again.facts.shelves) == (4, 2.5, "2:4")
    assert again.keep == plan.keep and again.fitted() == plan.fitted()
    for name in ("a.json", "a.txt"):
        saved = qdenv.read_plan(drawn.save(tmp_path / name))
        assert (saved.facts.robots, saved.facts.cell, saved.keep) == (4, 2.5, plan.keep)
    farthest = []
    for number, one in enumerate((hall, plan, drawn)):
        qdenv.convert(one, tmp_path / f"{number}.lif")
        nodes = json.loads((tmp_path / f"{number}.lif").read_text())["layouts"][0]["nodes"]
        farthest.append(max(node["nodePosition"]["x"] for node in nodes))
    assert farthest == [8.5 * 2.5] * 3


def test_one_plan_is_no_list_of_plans_and_its_tiles_are_checked(hall):
    plan = qdenv.read_plan(hall)
    with pytest.raises(InputError, match="1000 agents need as many free cells"):
        qdenv.compare(plan, 1000)
    wide = qdenv.Layout(plan.layout.astype(np.int64), plan.domain)
    assert qdenv.read_plan(wide).layout.dtype == np.int8
    with pytest.raises(InputError, match="tiles of hall are 0 to"):
        qdenv.check(qdenv.Layout(plan.layout + 9, plan.domain))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda plan: qdenv.layout_human(15.0, 20), "rows must be an integer, not 15.0"),
        (lambda plan: qdenv.simulate(plan, "4"), "agents must be a number"),
        (lambda plan: qdenv.simulate(plan, 4, planner=("pibt", "pbs")), "planner"),
        (lambda plan: qdenv.simulate(plan, robots=4), "choose one of agents, "),
        (lambda plan: qdenv.guide(plan, 4, minutes=0), "minutes must be above 0"),
        (lambda plan: qdenv.make_environment(plan, agents=2.5), "agents must be an integer"),
        (lambda plan: qdenv.explore(None), "None: no run here"),
    ],
)
def test_what_python_gives_wrong_is_answered_in_a_line(call, message, hall):
    with pytest.raises(InputError, match=message):
        call(qdenv.read_plan(hall))
    assert qdenv.layout_human(15, 20).layout.shape == (15, 20)


def test_numbers_of_numpy_are_numbers(hall, small_run, tmp_path):
    drawn = replace(qdenv.render(hall), details={"objective": np.float32(0.5)})
    assert json.loads(drawn.save(tmp_path / "a.json").read_text())["objective"] == 0.5
    best = small_run.best
    assert small_run.elite(measures=best.measures).cell == best.cell
    with pytest.raises(InputError, match="give a number for each of"):
        small_run.elite(measures=[1, "a"])


def test_a_failure_survives_pickling_and_results_show_their_lists():
    error = pickle.loads(pickle.dumps(UnsolvedError("no", {"a": 1})))
    assert str(error) == "no" and error.facts == {"a": 1}
    assert "warehouse-even" in qdenv.layout_symbols()._repr_html_()
    assert qdenv.check([[0]], domain="map")._repr_html_() == "<p>no rows</p>"
