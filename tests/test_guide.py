"""`qdenv guide`: what it writes, that it pauses and goes on, that models serve other floors."""

import csv
import json
from typing import get_args

import numpy as np
import pytest
from small_warehouse import ROWS

import qdenv
from qdenv.cli.main import run
from qdenv.generators import Base
from qdenv.guidance import NUM_SMOOTH
from qdenv.ops.guidance import FILE, PICTURE
from qdenv.study.elites import make_costs_drawer
from qdenv.study.guides import JUDGES, read_solutions
from qdenv.types import InputError

pytestmark = pytest.mark.slow
FLEET = {"agents": 8, "timesteps": 40, "progress": False}


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "hall.json"
    path.write_text(json.dumps({"layout": ROWS}))
    return path


@pytest.fixture(scope="module")
def found(plan, tmp_path_factory):
    path = tmp_path_factory.mktemp("guide") / "run"
    return qdenv.guide(plan, path=path, guidance="crisscross", evaluations=80, **FLEET), path


@pytest.fixture(scope="module")
def further(found, plan, tmp_path_factory):
    """A search that begins at what the other found."""
    path = tmp_path_factory.mktemp("further") / "run"
    qdenv.guide(plan, path=path, guidance=found[1] / FILE, evaluations=80, **FLEET)
    return qdenv.RunDirectory.open(path)


def test_it_leaves_costs_a_picture_and_a_table(found, plan):
    table, path = found
    assert {row.layout for row in table} == {"before", "after"}
    assert (path / PICTURE).stat().st_size > 10_000
    guided, bare = qdenv.read_plan(path / FILE), qdenv.read_plan(plan)
    np.testing.assert_array_equal(guided.layout, bare.layout)
    assert guided.costs is not None and bare.costs is None
    with (path / "before_after.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        source = path / FILE if row["layout"] == "after" else plan
        again = qdenv.simulate(
            source, agents=int(row["agents"]), timesteps=40, planner="pibt", seeds=10
        )
        assert again["mean_of_all"] == pytest.approx(float(row["mean_of_all"]), rel=1e-4)


def test_a_search_begins_at_what_moves_most_of_the_guidances_that_any_floor_can_have(
    plan, tmp_path
):
    qdenv.guide(plan, path=tmp_path / "run", evaluations=40, **FLEET)
    config = qdenv.RunDirectory.open(tmp_path / "run").config.evaluation
    moved = {
        name: qdenv.simulate(
            plan, 8, timesteps=40, planner="pibt", seeds=JUDGES[:3], guidance=name, stop=False
        )["mean_of_all"]
        for name in get_args(Base)
    }
    assert moved[config.generator.base] == max(moved.values()) > min(moved.values())


def test_smooth_factors_are_searched_first_and_single_costs_from_there(found, further):
    first = qdenv.RunDirectory.open(found[1])
    assert first.config.evaluation.generator.smooth
    assert first.best.solution.shape == (NUM_SMOOTH,)
    assert not further.config.evaluation.generator.smooth
    costs = qdenv.read_plan(found[1] / FILE).costs
    assert further.best.solution.shape == (np.isfinite(costs).sum(),)


def test_the_better_of_the_mean_and_the_best_is_written(found):
    table, _ = found
    assert set(table.facts["judged"]) == {"mean", "best"}


def test_a_pause_and_going_on_end_where_one_search_does(found, plan, tmp_path):
    _, whole = found
    search = {"guidance": "crisscross", "evaluations": 80, "minutes": 1e-9}
    qdenv.guide(plan, path=tmp_path / "parts", **search, **FLEET)
    run = qdenv.RunDirectory.open(tmp_path / "parts")
    assert run.read_metrics()[-1].evaluations == 40
    run = qdenv.resume(run, progress=False)
    assert run.read_metrics()[-1].evaluations == 80
    one, two = read_solutions(run), read_solutions(qdenv.RunDirectory.open(whole))
    for name, solution in one.items():
        np.testing.assert_array_equal(solution, two[name])
    assert (run.path / FILE).read_bytes() == (whole / FILE).read_bytes()


def test_a_search_goes_on_from_the_costs_of_another(found, further, tmp_path):
    before = found[1] / FILE
    qdenv.guide(before, path=tmp_path / "on", evaluations=80, minutes=1e-9, **FLEET)
    run = qdenv.resume(tmp_path / "on", progress=False)
    assert (run.path / FILE).read_bytes() == (further.path / FILE).read_bytes()
    domain, start = qdenv.make_domain(run.config.evaluation.domain), run.read_start()
    assert start.std() > 0.1
    drawn = make_costs_drawer(run.config.evaluation, domain)(start[None], run.best.layout[None])[0]
    ours = qdenv.read_plan(before).costs
    moves = np.isfinite(ours)
    ratio = drawn[moves] / ours[moves]
    # The drawn ones are whole numbers, a 64th of the mean apart.
    np.testing.assert_allclose(ratio / ratio.mean(), 1, atol=0.5 / drawn[moves].min())


def test_a_search_begins_at_costs_in_an_array(found, further, plan, tmp_path):
    costs = qdenv.read_plan(found[1] / FILE).costs
    qdenv.guide(plan, path=tmp_path, guidance=costs, evaluations=40, **FLEET)
    start = qdenv.RunDirectory.open(tmp_path).read_start()
    np.testing.assert_array_equal(start, further.read_start())


@pytest.mark.parametrize("method", ["smooth", "update"])
def test_what_was_found_serves_a_floor_of_another_size(method, plan, tmp_path):
    qdenv.guide(plan, method=method, path=tmp_path / "model", evaluations=40, **FLEET)
    larger = tmp_path / "larger.json"
    rows = ["." * len(ROWS[0]), *ROWS, *ROWS[1:]]
    larger.write_text(json.dumps({"layout": rows}))
    table = qdenv.guide(larger, model=tmp_path / "model", path=tmp_path / "out", **FLEET)
    assert qdenv.read_plan(tmp_path / "out" / FILE).costs.shape == (5, len(rows), len(rows[0]))
    assert len(table) > 2
    for ignored in ({"evaluations": 40}, {"seed": 0}, {"minutes": 1}, {"method": method}):
        with pytest.raises(InputError, match="model draws the costs: leave out what"):
            qdenv.guide(larger, model=tmp_path / "model", **FLEET, **ignored)


def test_what_makes_no_search_is_refused(found, further, plan, tmp_path):
    _, path = found
    with pytest.raises(InputError, match="holds a run already"):
        qdenv.guide(plan, path=path, **FLEET)
    zoo = qdenv.RunDirectory.open("zoo:warehouse-even/best").path
    with pytest.raises(InputError, match="ships with qdenv"):
        qdenv.guide(plan, path=zoo, model=path, **FLEET)
    (tmp_path / FILE).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="a run would replace it"):
        qdenv.guide(plan, path=tmp_path, model=path, **FLEET)
    for model in (further, "zoo:warehouse-even/best"):  # of costs for single cells, and of none
        with pytest.raises(InputError, match="no costs for other floors"):
            qdenv.guide(plan, model=model, path=tmp_path / "out", **FLEET)
    with pytest.raises(InputError, match="simulate fewer agents"):
        qdenv.guide(plan, path=tmp_path / "out", **FLEET | {"agents": 500})
    with pytest.raises(InputError, match="the method update begins at one of none"):
        other = FLEET | {"method": "update", "guidance": "human-cost"}
        qdenv.guide(plan, path=tmp_path / "out", **other)
    maze = qdenv.read_plan(plan)._replace(domain=qdenv.find_domain("maze-walls"))
    with pytest.raises(InputError, match="no fleet drives in maze-walls"):
        qdenv.guide(maze, path=tmp_path / "out", **FLEET)
    assert not (tmp_path / "out").exists()


def test_a_report_on_a_run_has_its_costs_and_the_stated_tasks(found, monkeypatch):
    class MadeError(Exception):
        """What was to be reported on."""

    def make(subjects, *settings):
        raise MadeError(subjects[0].plan)

    monkeypatch.setattr("qdenv.view.report_fleet.make_request", make)
    with pytest.raises(MadeError) as made:
        qdenv.report(found[1], agents=8)
    best = qdenv.read_plan(found[1] / "best_layout.json")
    np.testing.assert_array_equal(made.value.args[0].costs, best.costs)
    with pytest.raises(MadeError) as made:
        qdenv.report("zoo:manufacturing", agents=8, tasks={"stays": (0, 0, 0)})
    assert made.value.args[0].domain.config.stays == (0, 0, 0)


def test_the_help_names_the_planner_that_is_used(capsys):
    for words, planner in (([], "pibt"), (["--effort", "low"], "negotiated")):
        with pytest.raises(SystemExit):
            run(["guide", *words, "--help"])
        assert f"(default: {planner})" in capsys.readouterr().out
