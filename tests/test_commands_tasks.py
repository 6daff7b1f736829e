"""What robots do at their goals: settings of a domain as options of commands that simulate."""

from pathlib import Path

import numpy as np
import pytest
from conftest import facts_of

from qdenv.cli.main import run
from qdenv.configurations import find_preset
from qdenv.domains.base import find_domain
from qdenv.io.layouts import write_layout
from qdenv.ops.output import Layout
from qdenv.ops.studies import compare
from qdenv.ops.traffic import simulate
from qdenv.run.config import RunConfig, config_from_json, config_to_json
from qdenv.settings import EvaluationConfig
from qdenv.simulation.mapf.audit import audit
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.study.engine import run_seeds
from qdenv.study.plans import read_plan, resolve_plan, with_tasks
from qdenv.types import InputError

QUICK = {"planner": "pibt", "timesteps": 100, "seeds": 2}
WORDS = ["--planner", "pibt", "--timesteps", "100", "--seeds", "2", "--agents", "8"]


@pytest.fixture
def factory(folder) -> Path:
    """A folder with a factory to work in."""
    domain = find_domain("manufacturing").resized(12, 13)
    write_layout(Path("factory.json"), domain.human(), domain.tiles, domain="manufacturing")
    return folder


@pytest.mark.slow
def test_stays_of_a_factory_are_options_and_arguments(factory, capsys):
    def finished(*more):
        facts = facts_of("simulate", "factory.json", *WORDS, *more)
        assert facts["valid"] is True
        return [one["finished_tasks"] for one in facts["runs"]], facts["settings"].get("tasks")

    usual, stated = finished()
    assert stated is None and finished("--stays", "2", "5", "10") == (usual, None)
    slow, _ = finished("--stays", "25", "25", "25", "--no-stop")
    assert 0 < sum(slow) < sum(usual) / 1.5
    tasks = {"stays": (25, 25, 25)}
    facts = simulate("factory.json", 8, tasks=tasks, verdict=False, stop=False, **QUICK)
    assert [one["finished_tasks"] for one in facts["runs"]] == slow
    assert run(["compare", "factory.json", *WORDS, "--stays", "-1", "0", "0"]) == 2
    assert "stays must be at least 0, not -1" in capsys.readouterr().err


def test_a_domain_without_such_a_setting_says_which_it_has(factory):
    with pytest.raises(InputError, match="manufacturing has no setting 'pick' of tasks: it has st"):
        simulate("factory.json", 8, tasks={"pick": 3}, **QUICK)


DRAWING = """\
##########
#.e@.@e..i
w.e@.@e..#
#.e@.@e..o
w.e@.@e..#
#.......##
##########
"""


@pytest.fixture
def hall(folder) -> Path:
    """A folder with a plan to work in."""
    Path("plan.txt").write_text(DRAWING)
    return folder


def goals_of(tasks):
    """Simulate robots ten times; count how often each cell was a goal, and all tasks."""
    plan = with_tasks(read_plan("plan.txt"), tasks)
    config = FleetConfig(3, 2000, stop_when_congested=False)
    rule, counts = plan.domain.simulator.tasks, np.zeros(plan.layout.size, int)

    def read(seed, traffic, recording):
        assert audit(plan.layout, rule, recording, traffic) == []
        np.add.at(counts, recording.goals[:-1][recording.finished], 1)

    done = run_seeds(plan.layout, rule, config, range(10), read=read)
    return counts.reshape(plan.layout.shape), sum(run.finished.sum() for run in done.runs)


@pytest.mark.slow
def test_demand_shares_and_times_of_a_hall(hall):
    plain, tasks = goals_of({})
    assert plain.sum() == tasks
    demand = np.ones(plain.shape)
    demand[:3] = 3  # the endpoints of two of four rows
    counts, fewer = goals_of({"demand": demand, "shares": "i=1,o=3", "pick": 4, "drop": "i=20,o=2"})
    near, far = counts[:3, [2, 6]].sum(), counts[3:, [2, 6]].sum()
    assert near / (near + far) == pytest.approx(0.75, abs=0.04)
    assert counts[[2, 4], 0].sum() == 0, "shares leave no task to workstations"
    assert counts[3, 9] / (counts[1, 9] + counts[3, 9]) == pytest.approx(0.75, abs=0.05)
    assert fewer < tasks


def test_options_of_a_hall_are_its_settings(hall, capsys):
    Path("orders.csv").write_text("row,column\n1,2\n1,3\n2,6\n")
    command = ["simulate", "plan.txt", "--agents", "3", "--timesteps", "200", "--seeds", "2"]
    more = ["--pick", "3", "--drop", "i=9,o=4", "--shares", "i=1", "--demand", "orders.csv"]
    facts = facts_of(*command, *more, "--no-verdict")
    assert facts["valid"] is True
    tasks = facts["settings"]["tasks"]
    assert (tasks["pick"], tasks["drop"], tasks["shares"]) == (3, "i=9,o=4", "i=1")
    said = capsys.readouterr().out
    assert "a hall, pick 3, drop i=9,o=4, shares i=1, demand by place; planner" in said
    assert tasks["demand"][1].split()[:4] == ["2", "2", "2", "2"]
    assert tasks["demand"][3] == "0 0 0 0 0 0 0 0 0 0".replace("0", tasks["demand"][3][0])
    plan = with_tasks(read_plan("plan.txt"), facts["settings"]["tasks"] | {"demand": "orders.csv"})
    assert plan.fitted().config.demand == tuple(tasks["demand"])
    assert plan.fitted().resized(9, 9).config.demand == ()
    assert config_from_json(config_to_json(in_a_run(plan)), Path("x")) == in_a_run(plan)


def in_a_run(plan):
    return RunConfig(EvaluationConfig(plan.fitted().config))


MISTAKES = {
    ("--drop", "x=3"): "drop 'x=3': write one number, or i=20,o=5, of the stations w i o",
    ("--drop", "i=-3"): "drop must be at least 0, not -3",
    ("--drop", "1.5"): "drop must be an integer, not 1.5",
    ("--pick", "1001"): "pick must be at most 1000, not 1001",
    ("--shares", "i=0,o=0"): "shares must be above 0 for one kind of station or more",
    ("--shares", "i=1e39,o=1"): "shares must be at most 1000000.0, not 1e+39",
    ("--shares", "i=1e-9"): "shares must be at least 1e-06, not 1e-09",
    ("--demand", "0:7,0:10=0"): "the demand is 0 everywhere: no robot",
    ("--demand", "0:1,0:1=nan"): "'nan' is not a weight",
    ("--demand", "none.csv"): "none.csv: cannot be read",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_what_no_robot_can_do_is_refused_in_a_line(words, hall, capsys):
    assert run(["simulate", "plan.txt", "--agents", "3", *words]) == 2
    answer = capsys.readouterr().err
    assert MISTAKES[words] in answer and answer.count("\n") == 1


def test_a_search_from_a_plan_has_its_tasks(hall, capsys):
    plan = with_tasks(read_plan("plan.txt"), {"pick": 3, "demand": "0:3,0:10=3"})
    found = resolve_plan(find_preset("quick"), {}, plan)[0].evaluation.domain
    assert (found.pick, found.demand) == (3, plan.domain.config.demand)
    assert run(["train", "quick", "--domain", "hall", "--demand", "0:3,0:10=3"]) == 2
    assert "add --plan FILE" in capsys.readouterr().err


@pytest.mark.parametrize("ending", ["json", "txt", "csv"])
def test_files_remember_the_tasks(ending, hall):
    tasks = {"pick": 3, "drop": "i=9,o=4", "shares": "i=1,o=2", "demand": "0:3,0:10=2.5"}
    plan = with_tasks(read_plan("plan.txt"), tasks)
    Layout(plan.layout, plan.fitted()).save(f"saved.{ending}")
    assert read_plan(f"saved.{ending}").fitted().config == plan.fitted().config


def test_facts_of_a_plan_are_its_tasks_and_comparisons_have_those_of_the_first(hall, capsys):
    Path("orders").mkdir()
    Path("orders/orders.csv").write_text("place\nA1\nA1\nB1\n")
    Path("orders/places.csv").write_text("place,row,column\nA1,1,2\nB1,2,6\n")
    facts = 'pick = 2\ndrop = 3\ndemand = "orders.csv,places.csv"\n'
    Path("orders/plan.txt").write_text(f"+++\n{facts}+++\n{DRAWING}")
    plan = read_plan("orders/plan.txt")
    assert plan.domain.tasks["drop"] == "3" and plan.domain.config.demand[1][:7] == "2 2 2 2"
    both = {}
    for layouts in (["plan.txt", "orders/plan.txt"], ["orders/plan.txt", "plan.txt"]):
        rows = compare(layouts, agents=2, timesteps=100, seeds=2, effort="low").facts["rows"]
        assert rows[0]["throughput"] == rows[1]["throughput"]  # one layout, one kind of tasks
        both[layouts[0]] = rows[0]["throughput"]
    assert both["orders/plan.txt"] < both["plan.txt"]
    Path("small.txt").write_text("w.e@\n..e@\n")
    with pytest.raises(InputError, match="demand has 7 x 10 numbers, the plan 2 x 4 cells"):
        compare(["orders/plan.txt", "small.txt"], agents=2)


@pytest.mark.slow
def test_tasks_that_arrive_at_a_rate_leave_robots_idle(hall, capsys):
    command = ["simulate", "plan.txt", "--agents", "3", "--timesteps", "400", "--seeds", "4"]
    facts = facts_of(*command, "--task-rate", "0.1", "--paths", "p.csv")
    assert facts["valid"] is True and facts["settings"]["tasks"] == {"task_rate": 0.1}
    assert facts["mean_of_all"] == pytest.approx(0.1, rel=0.25)
    assert 0.3 < facts["idle_share"] < 0.9 and 2 < facts["order_wait"] < 20
    said = capsys.readouterr().out
    assert "of their time; one waits" in said
    assert f"flows: agents have no order for {facts['idle_share']:.0%} of their time" in said
    assert Path("p.csv").read_text().splitlines()[1].endswith(",-1,-1,0")
    # More tasks than the robots can do: they move what they always do, and orders wait for ever.
    short = {"agents": 3, "timesteps": 400, "seeds": 4}
    closed, crowded = (
        simulate("plan.txt", **short, stop=False, tasks={"task_rate": rate}) for rate in (0.0, 9.0)
    )
    assert crowded["mean_of_all"] > 0.9 * closed["mean_of_all"]
    assert crowded["idle_share"] < 0.03 and crowded["order_wait"] > 100
    assert "idle_share" not in closed
    Path("plan.toml").write_text("task_rate = 0.1\n")
    assert simulate("plan.txt", **short)["mean_of_all"] == pytest.approx(facts["mean_of_all"])
