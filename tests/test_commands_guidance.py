"""--guidance: which costs of moves a study drives by, in all commands that simulate a fleet."""

from pathlib import Path

import numpy as np
import pytest
from conftest import facts_of

import qdenv
from qdenv.cli.main import run
from qdenv.domains.base import find_domain
from qdenv.grid import parse
from qdenv.guidance import crisscross, existing_moves

WAREHOUSE = find_domain("warehouse-even")
ROWS = ["w..........", "w..e@@e....", ".....e..e@.", "w..@.e..@e.", "w..........", "..e@e..e@e."]
HALL = parse(ROWS, WAREHOUSE.tiles)
QUICK = ["--planner", "pibt", "--timesteps", "60", "--seeds", "2"]


@pytest.fixture
def plans(folder) -> Path:
    """A folder with a floor, without costs and with them."""
    qdenv.Layout(HALL, WAREHOUSE).save("plain.json")
    qdenv.Layout(HALL, WAREHOUSE, costs=crisscross(HALL)).save("guided.json")
    qdenv.Layout(HALL, WAREHOUSE, costs=crisscross(HALL)).save("costs.csv")
    return folder


@pytest.mark.slow
def test_the_same_costs_give_the_same_runs_wherever_they_are_stated(plans, capsys):
    simulate = ["--agents", "8", *QUICK, "--no-verdict"]
    plain = facts_of("simulate", "plain.json", *simulate)
    assert "guidance" not in plain["settings"] and "guidance" not in capsys.readouterr().out
    seen = {}
    for layout, guidance in (
        ("guided.json", None),
        ("costs.csv", None),
        ("plain.json", "crisscross"),
        ("plain.json", "guided.json"),
        ("plain.json", "costs.csv"),
    ):
        more = [] if guidance is None else ["--guidance", guidance]
        facts, used = facts_of("simulate", layout, *simulate, *more), guidance or layout
        assert facts["settings"]["guidance"] == used and facts["valid"]
        assert capsys.readouterr().out.splitlines()[0].endswith(f"; guidance: {used}")
        seen[used] = facts["runs"]
    assert all(runs == seen["crisscross"] != plain["runs"] for runs in seen.values())
    off = facts_of("simulate", "guided.json", *simulate, "--guidance", "none")
    assert off["runs"] == plain["runs"] and "guidance" not in off["settings"]
    options = dict(agents=8, planner="pibt", timesteps=60, seeds=2)
    for guidance in ("crisscross", Path("costs.csv"), crisscross(HALL)):
        found = qdenv.simulate("plain.json", guidance=guidance, **options)
        assert found["runs"] == qdenv.simulate("guided.json", **options)["runs"]
    layout = qdenv.render("guided.json")
    np.testing.assert_array_equal(qdenv.read_plan(layout).costs, layout.costs)


@pytest.mark.slow
def test_tables_pages_and_reports_name_their_guidance(plans, capsys):
    rows = qdenv.compare(["plain.json", "guided.json"], 8, planner="pibt", timesteps=60, seeds=2)
    assert rows.facts["settings"]["guidance"] == "none, guided.json"
    assert rows[0].throughput != rows[1].throughput
    guided = ["--guidance", "crisscross", "--agents", "4,8", *QUICK, "--out", "t.csv"]
    for command in ("sweep", "compare", "scalability"):
        facts = facts_of(command, "plain.json", *guided)
        assert facts["settings"]["guidance"] == "crisscross"
        assert "; guidance: crisscross\n" in capsys.readouterr().out
    both = qdenv.compare(
        ["plain.json", "guided.json"], 8, guidance="crisscross", planner="pibt", timesteps=60
    )
    assert both[0].throughput == both[1].throughput
    page = facts_of("replay", "plain.json", "--guidance", "crisscross", "--agents", "4", *QUICK[:4])
    assert page["guidance"] == "crisscross"
    assert "guidance: crisscross" in Path("plain_replay.html").read_text()
    facts = facts_of("report", "guided.json", "--agents", "4", *QUICK)
    assert facts["settings"]["guidance"] == "guided.json"
    assert "guidance: guided.json" in Path("report.html").read_text()


def test_a_repaired_plan_keeps_its_costs(plans):
    made = np.asarray(qdenv.repair("guided.json", out="mended.json", polish="none"))
    costs, moves = qdenv.read_plan("mended.json").costs, existing_moves(made != 1)
    assert (made != HALL).any() and (np.isfinite(costs) == moves).all()
    both = moves & existing_moves(HALL != 1)
    np.testing.assert_array_equal(costs[both], crisscross(HALL)[both])


def test_a_planner_that_reads_no_costs_is_refused_before_anything_runs(plans, capsys, monkeypatch):
    monkeypatch.setattr("qdenv.study.table._simulate", lambda *inputs: pytest.fail("simulated"))
    planner = qdenv.PLANNERS.make(qdenv.PibtConfig())._replace(reads_costs=False)
    monkeypatch.setattr(qdenv.PLANNERS, "make", lambda settings: planner)
    assert run(["compare", "plain.json", "guided.json", "--planner", "pibt"]) == 2
    assert "knows no costs of moves" in capsys.readouterr().err
