"""Layouts side by side and up to their peaks: oracles, closed forms, one line per mistake."""

import csv
from pathlib import Path

import numpy as np
import pytest

import qdenv
from experiments.traffic import name_layouts
from qdenv import grid
from qdenv.cli import main as cli
from qdenv.domains.base import find_domain
from qdenv.io.layouts import write_layout
from qdenv.simulation.mapf.fleet import FleetConfig
from qdenv.simulation.mapf.settings import PibtConfig
from qdenv.stats import paired_difference, wilson_interval
from qdenv.study.engine import Simulated, run_seeds
from qdenv.study.options import parse_counts
from qdenv.study.table import Row, Trial, climb, compare, find_capacity, find_peak, write_rows
from qdenv.types import InputError, Traffic

pytestmark = pytest.mark.slow

WAREHOUSE = find_domain("warehouse-even")
TASKS = WAREHOUSE.simulator.tasks
# The plainest planner compiles fast; layouts of one size and one largest fleet share a program.
CONFIG = FleetConfig(agents=60, timesteps=60, planner=PibtConfig())
SEEDS = (0, 1, 2)


def row(agents: int, mean: float, name: str = "a") -> Row:
    return Row(name, 9, 12, agents, 3, mean, 0.1, 1.0, 0.4, 1.0, mean, 0.0)


@pytest.fixture(scope="module")
def layouts() -> dict[str, np.ndarray]:
    human = WAREHOUSE.resized(9, 12).human()
    narrow = grid.parse(
        ["............", "w..........w", *["..@@@@@@@@..", "..eeeeeeee.."] * 3, "............"],
        WAREHOUSE.tiles,
    )
    return {"human": human, "narrow": narrow}


@pytest.fixture
def paths(layouts, tmp_path) -> list[str]:
    """Files of the layouts."""
    files = {name: tmp_path / f"{name}.json" for name in layouts}
    for name, path in files.items():
        write_layout(path, layouts[name], WAREHOUSE.tiles)
    return [*map(str, files.values())]


def test_rows_agree_with_the_runs_they_summarise(layouts):
    told = []
    rows = compare(layouts, Trial(TASKS, CONFIG, (12, 60), SEEDS), told.append)
    names = [(found.layout, found.agents) for found in rows]
    assert names == [("human", 12), ("human", 60), ("narrow", 12), ("narrow", 60)]
    assert told == rows
    for found in rows:
        assert (found.rows, found.cols) == (9, 12)
        layout, agents = layouts[found.layout], found.agents
        runs = run_seeds(layout, TASKS, CONFIG, SEEDS, agents).runs
        every = np.array([run.throughput for run in runs])
        good = np.array([not run.congested for run in runs])
        assert found.mean_of_all == pytest.approx(every.mean())
        assert found.success_rate == pytest.approx(good.mean())
        low, high = wilson_interval(int(good.sum()), 3)
        assert (found.success_low, found.success_high) == (low, high)
        if good.any():
            assert found.throughput == pytest.approx(every[good].mean())
        if good.sum() > 1:
            error = every[good].std(ddof=1) / np.sqrt(good.sum())
            assert found.standard_error == pytest.approx(error)


def test_one_agent_alone_takes_two_to_six_steps_from_goal_to_goal():
    tiny = grid.parse(["w...e", ".@@..", "e...w"], WAREHOUSE.tiles)
    trial = Trial(TASKS, FleetConfig(timesteps=40, planner=PibtConfig()), (1, 3, 6), SEEDS)
    first, *others = compare({"tiny": tiny}, trial)
    assert 40 / 6 - 1 <= 40 * first.throughput <= 20
    assert [found.agents for found in others] == [3, 6]


def test_a_climb_stops_at_the_first_drop(layouts, monkeypatch):
    throughput = {10: 1.0, 20: 1.9, 30: 2.4, 40: 2.3, 50: 9.0}

    def runs_of(layout, tasks, config, seeds, agents, progress):
        assert config.agents == 50  # one program for all numbers
        nothing = np.zeros(8)
        runs = [
            Traffic(throughput[agents] + seed, False, 8, nothing, None, 0.0, 0.0) for seed in seeds
        ]
        return Simulated(tuple(seeds), runs, [], 0.0, 0.0)

    monkeypatch.setattr("qdenv.study.engine.run_seeds", runs_of)
    told = []
    counts = [30, 10, 20, 40, 50, 5000]
    way = climb("a", layouts["human"], Trial(TASKS, CONFIG, counts, (0, 1)), told.append)
    assert [found.agents for found in way] == [10, 20, 30, 40]
    assert told == way
    assert find_peak(way)[3:] == (30, pytest.approx(2.9), 1.0, True)


def test_numbers_that_do_not_fit_are_left_out(layouts):
    way = climb("human", layouts["human"], Trial(TASKS, CONFIG, (12, 60, 5000), (0,)))
    assert {found.agents for found in way} <= {12, 60}
    with pytest.raises(InputError, match="human: 500 agents need as many free cells"):
        climb("human", layouts["human"], Trial(TASKS, CONFIG, (500,), (0,)))
    with pytest.raises(InputError, match=r"human: .*fewer agents"):
        compare(layouts, Trial(TASKS, CONFIG, (500,), (0,)))


def test_peaks_of_made_up_ways():
    assert find_peak([row(50, 1.0), row(100, 3.0), row(150, 2.0)])[3:5] == (100, 3.0)
    assert find_peak([row(50, 1.0), row(100, 3.0)]).dropped is False


def test_names_are_short_where_they_can_be():
    one, other, third = Path("runs/a/best.json"), Path("runs/b/best.json"), Path("x/human.json")
    names = name_layouts([one, other, third])
    assert names == {str(one): one, str(other): other, "human": third}


def test_nothing_is_simulated_before_all_layouts_are_checked(layouts):
    told = []
    cut = layouts["human"].copy()
    cut[1:, 5] = WAREHOUSE.tiles.index("@")
    cut[0, 5] = WAREHOUSE.tiles.index("@")
    with pytest.raises(InputError, match="cut: the free cells fall into"):
        compare({**layouts, "cut": cut}, Trial(TASKS, CONFIG, (12,), SEEDS), told.append)
    assert told == []


def test_progress_grows_to_the_whole_and_names_what_is_simulated(layouts):
    told = []
    trial = Trial(TASKS, CONFIG, (12, 60), SEEDS)
    compare(layouts, trial, progress=lambda *state: told.append(state))
    shares = [share for _, share, _ in told]
    assert shares == sorted(shares) and shares[-1] == pytest.approx(1)
    assert any("narrow, 60 agents, run 3 of 3" in note for _, _, note in told)


def test_the_table_holds_every_number(tmp_path):
    rows = [row(50, 1.5), row(50, 7.654321987, "b")]
    write_rows(tmp_path / "a.csv", rows, {"tasks_per_hour": [5400, 9000]})
    table = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    found = [(line["layout"], line["throughput"]) for line in table]
    assert found == [("a", "1.5"), ("b", "7.65432")]  # six digits
    assert [line["tasks_per_hour"] for line in table] == ["5400", "9000"]
    assert list(table[0]) == [*Row._fields[:-2], "tasks_per_hour"]


def test_agents_are_worth_it_while_each_further_one_brings_half_of_an_average_one():
    """One more brings 0.9, 0.57 and 0.4 of what an average one does; the third is too little."""
    rows = [row(50, 1.0), row(100, 1.9), row(150, 2.44), row(200, 2.76)]
    assert find_capacity(rows) == 150
    assert find_capacity(rows[:2]) == 100
    assert find_capacity([row(50, 1.0), row(100, 1.2), row(150, 2.0)]) == 50


def test_numbers_of_agents_are_read():
    assert parse_counts("200") == (200,)
    assert parse_counts("50,100") == (50, 100)
    assert parse_counts("50:400:50") == tuple(range(50, 401, 50))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1:99999999999", "choose a larger step"),
        (f"1:{10**30}", "choose a larger step"),
        ("1,1,1", "names a number twice"),
        ("-5,10", "numbers must be above zero"),
        ("0", "numbers must be above zero"),
        ("5:10:0", "numbers must be above zero"),
        ("10:5", "ranges must rise"),
        *((text, "write 200, or 50,100, or") for text in ("", "many", "1:2:3:4")),
    ],
)
def test_numbers_that_make_no_study_are_refused_at_once(text, said):
    with pytest.raises(InputError, match=said):
        parse_counts(text)


def test_commands_compare_and_climb(paths, tmp_path, capsys):
    out = f"--timesteps 60 --seeds 1 --planner pibt --out {tmp_path / 't.csv'}".split()
    assert cli.run(["compare", *paths, "--agents", "2,60", *out]) == 0
    lines = [line.split()[:3] for line in capsys.readouterr().out.splitlines()[2:6]]
    assert lines == [[n, "9x12", a] for n in ("human", "narrow") for a in ("2", "60")]
    assert (tmp_path / "t.png").stat().st_size > 5000
    assert cli.run(["scalability", *paths, "--agents", "2,60", *out]) == 0
    assert "human: peak " in capsys.readouterr().out
    assert len((tmp_path / "t.csv").read_text().splitlines()) == 5


def test_planners_are_compared_seed_by_seed_on_each_layout(layouts, paths, tmp_path, capsys):
    words = "--timesteps 40 --seeds 4 --agents 12 --planner pibt,negotiated".split()  # noqa: SIM905
    words = ["compare", *paths, *words, "--out", str(tmp_path / "t.csv")]
    assert cli.run([*words, "--runs", str(tmp_path / "r.csv")]) == 0
    said = capsys.readouterr().out
    assert "planner: pibt, swap False | negotiated, high effort" in said
    assert "against pibt, over all runs, with 95 % interval (seed by seed" in said
    assert "human, negotiated, 12 agents: " in said and "human, pibt, 12 agents: " not in said
    runs = list(csv.DictReader((tmp_path / "r.csv").read_text().splitlines()))
    assert list(runs[0]) == ["layout", "planner", "agents", "seed", "throughput", "congested"]
    each = {
        (name, planner): [
            float(run["throughput"]) for run in runs if run["layout"] == name
            and run["planner"] == planner
        ]
        for name in layouts for planner in ("pibt", "negotiated")
    }  # fmt: skip
    assert {len(every) for every in each.values()} == {4}
    table = list(csv.DictReader((tmp_path / "t.csv").read_text().splitlines()))
    for line in table:
        own = each[line["layout"], line["planner"]]
        assert float(line["mean_of_all"]) == pytest.approx(np.mean(own), rel=1e-4)
        expected = paired_difference(own, each[line["layout"], "pibt"])
        if line["planner"] == "pibt":
            assert line["difference_low"] == ""
        else:
            assert float(line["difference_low"]) == pytest.approx(expected.low, rel=1e-3)
            assert (line["significant"] == "True") == expected.significant
    # In Python a list of names and settings; without another planner nothing changes.
    planners = [PibtConfig(swap=True), PibtConfig()]
    size = {"agents": 12, "timesteps": 40, "seeds": 4}
    both = qdenv.compare(paths[:1], planner=planners, **size)
    assert [row.planner for row in both] == ["pibt 1", "pibt 2"]
    assert [run.throughput for run in both[1].each] == pytest.approx(each["human", "pibt"])
    assert qdenv.compare(paths[:1], planner="pibt", **size)[0].each == both[1].each
