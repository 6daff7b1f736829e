"""Commands about traffic: what they print, write, draw and refuse."""

import csv
import json
from pathlib import Path

import pytest
from conftest import facts_of
from matplotlib.image import imread

from qdenv.cli.main import run
from qdenv.domains.base import find_domain
from qdenv.grid import parse
from qdenv.io.layouts import write_layout

WAREHOUSE = find_domain("warehouse-even")
LANE = parse(["w...@@@@@...e", "w.........e.e", "w...@@@@@...e"], WAREHOUSE.tiles)
HALL = parse(["w...........e", "w.........e.e", "w...........e"], WAREHOUSE.tiles)
QUICK = ["--planner", "pibt", "--timesteps", "120", "--seeds", "3"]


@pytest.fixture
def plans(folder) -> Path:
    """A folder with two plans to work in."""
    for name, layout in (("lane", LANE), ("hall", HALL)):
        tiles = WAREHOUSE.tiles
        write_layout(Path(f"{name}.json"), layout, tiles, domain="warehouse-even")
    return folder


@pytest.mark.slow
def test_simulate_says_where_it_jams_and_whether_more_would_help(plans, capsys):
    command = ["simulate", "lane.json", "--agents", "20", *QUICK, "--json", "f.json", "--plot"]
    assert run([*command, "--seconds-per-step", "0.5"]) == 0
    said, facts = capsys.readouterr().out, json.loads(Path("f.json").read_text())
    assert said.startswith(
        "20 agents, 120 timesteps, 3 seeds, domain warehouse-even; planner: pibt, swap False\n"
    )
    assert facts["verdict"] == "congested"
    assert "verdict      congested: in 3 of 3 runs" in said
    assert "never congested" not in said
    assert f"waiting      {facts['waiting_share']:.1%} of the agents' time, half of it on " in said
    assert facts["tasks_per_hour"] == pytest.approx(7200 * facts["mean_of_all"], rel=1e-5)
    assert f"{facts['tasks_per_hour']:,.0f} tasks per hour" in said
    worst = [line.split()[:3] for line in said.splitlines() if "% of time" in line]
    spots = [one for one in facts["worst_cells"] if one["waiting"] >= 0.005]  # 1%, rounded
    assert len(facts["worst_cells"]) == 10 and spots
    assert [line[1:] for line in worst] == [[str(one["row"]), str(one["column"])] for one in spots]
    assert facts["settings"]["seeds"] == [0, 1, 2] and facts["command"] == "simulate"
    assert imread("lane_traffic.png").shape[2] == 4
    assert said.splitlines()[-2:] == ["lane_traffic.png", "f.json"]


@pytest.mark.slow
def test_a_run_that_goes_on_after_congestion_counts_all_its_tasks(plans, capsys):
    command = ["simulate", "lane.json", "--agents", "20", *QUICK]
    ended = facts_of(*command)
    capsys.readouterr()
    whole = facts_of(*command, "--no-stop", "--plot", "p.svg")
    said = capsys.readouterr().out
    assert ended["success_rate"] == whole["success_rate"] == 0 and whole["valid"] is True
    for one, other in zip(ended["runs"], whole["runs"], strict=True):
        assert one["congested_at"] == one["end_timestep"] == other["congested_at"] < 120
        assert other["end_timestep"] == 120 and other["congested"]
        assert other["finished_tasks"] >= one["finished_tasks"]
        line = f"{other['throughput']:.3f} tasks per timestep, congested at {one['congested_at']}"
        assert line in said
    assert ended["mean_throughput"] is None
    assert whole["mean_throughput"] == whole["mean_of_all"] >= ended["mean_of_all"]
    assert "congested    100% of the runs, and went on" in said
    assert whole["verdict"] == "congested"
    assert "3 of 3 runs congested, and went on" in Path("p.svg").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["sweep", "compare", "scalability"])
def test_tables_of_runs_that_go_on_average_all_of_them(plans, capsys, command):
    def rows_of(*more):
        assert run([command, "lane.json", "--agents", "4,20", *QUICK, "--out", "t.csv", *more]) == 0
        return list(csv.DictReader(Path("t.csv").read_text().splitlines()))

    ended, whole = rows_of(), rows_of("--no-stop")
    assert [float(row["success_rate"]) for row in whole] == [1, 0]
    assert whole[0]["throughput"] == ended[0]["throughput"]
    assert ended[1]["throughput"] == "nan"
    assert whole[1]["throughput"] == whole[1]["mean_of_all"]
    assert whole[1]["standard_error"] == whole[1]["error_of_all"]
    assert "no stop at congestion" in capsys.readouterr().out


@pytest.mark.slow
def test_simulate_without_verdict_and_audit_gives_the_same_numbers(plans, capsys):
    command = ["simulate", "lane.json", "--agents", "6", *QUICK]
    whole, bare = facts_of(*command), facts_of(*command, "--no-verdict", "--no-audit")
    assert whole["runs"] == bare["runs"] and whole["valid"] is True and bare["valid"] is None
    assert [point["agents"] for point in whole["evidence"]] == [6, 4, 8]
    assert not {"verdict", "worst_cells"} & bare.keys()
    capsys.readouterr()
    drawn = facts_of(*command, "--no-audit", "--plot", "p.svg")
    assert drawn["worst_cells"] == whole["worst_cells"]
    assert Path("p.svg").read_text().count("time in which one waits here") == 1


def test_compare_says_how_surely_layouts_differ(plans, capsys):
    command = ["compare", "lane.json", "hall.json", "--agents", "3,12", *QUICK, "--json", "f.json"]
    assert run([*command, "--seconds-per-step", "1"]) == 0
    said, facts = capsys.readouterr().out, json.loads(Path("f.json").read_text())
    last = facts["rows"][-1]
    assert (last["layout"], last["agents"]) == ("hall", 12)
    ratio = last["mean_of_all"] / facts["rows"][1]["mean_of_all"]
    assert last["difference_percent"] == pytest.approx(100 * (ratio - 1), rel=1e-4)
    assert last["significant"] and 0 < last["difference_low"] < last["difference_percent"]
    line = (
        f"hall, 12 agents: {last['difference_percent']:+.1f} % ({last['difference_low']:+.1f} to "
    )
    assert line in said and "significant" in said
    table = list(csv.DictReader(Path("compare.csv").read_text().splitlines()))
    assert float(table[-1]["difference_high"]) == pytest.approx(last["difference_high"], rel=1e-4)
    assert table[-1]["significant"] == "True"
    hours = [float(line["tasks_per_hour"]) for line in table]
    assert hours == pytest.approx([3600 * float(line["mean_of_all"]) for line in table])
    assert facts["settings"]["layouts"] == {"lane": "lane.json", "hall": "hall.json"}
    assert "compare.csv, compare.png\nf.json\n" in said


def test_a_plan_with_few_robots_is_compared_with_about_as_many(plans):
    write_layout(Path("few.txt"), LANE, WAREHOUSE.tiles)
    Path("few.toml").write_text('domain = "warehouse-even"\nrobots = 3\n')
    assert run(["compare", "few.txt", *QUICK]) == 0
    table = csv.DictReader(Path("compare.csv").read_text().splitlines())
    assert [line["agents"] for line in table] == ["3"]


def test_sweep_says_where_the_peak_is_and_how_many_are_worth_it(plans, capsys):
    facts = facts_of("sweep", "lane.json", "--agents", "14,2,4", *QUICK)
    said = capsys.readouterr().out
    assert facts["peak"]["agents"] == facts["worth_it_up_to"] == 4
    assert facts["peak"]["dropped"] is True
    assert f"lane: peak {facts['peak']['throughput']:.3f} tasks per timestep at 4 agents\n" in said
    assert "agents worth having: up to 4, " in said
    assert [row["agents"] for row in facts["rows"]] == [2, 4, 14]
    assert run(["sweep", "lane.json", "--agents", "2", *QUICK]) == 0
    assert "peak" not in capsys.readouterr().out  # one number shows none


def test_throughput_that_falls_with_time_asks_for_more_timesteps(plans, capsys, monkeypatch):
    monkeypatch.setattr("qdenv.study.table.fading", lambda runs: 0.12)
    assert run(["compare", "lane.json", "--agents", "3", *QUICK]) == 0
    said = capsys.readouterr().out
    assert "lane: with 3 agents a jam builds up, throughput falls by 12% with time: more" in said
    (line,) = csv.DictReader(Path("compare.csv").read_text().splitlines())
    assert line["fading"] == "0.12"


def test_scalability_reports_peaks_as_facts(plans, capsys):
    command = ["scalability", "lane.json", "hall.json", "--agents", "2,4,900", *QUICK]
    facts = facts_of(*command, "--plot", "s.pdf")
    said = capsys.readouterr().out
    assert [peak["layout"] for peak in facts["peaks"]] == ["lane", "hall"]
    assert "hall: peak " in said and "still rising at the last number of agents: try more" in said
    assert Path("s.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("command", ["simulate", "sweep", "compare", "scalability"])
def test_facts_alone_go_to_standard_output(plans, capsys, command):
    assert run([command, "hall.json", "--agents", "2", *QUICK, "--json", "-"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["command"] == command
    assert "tasks per timestep" in said.err or "throughput (s.e.)" in said.err


@pytest.mark.slow
def test_nothing_is_written_over_unless_it_is_named(plans, capsys):
    for name in ("compare.csv", "compare.png", "lane_traffic.png"):
        Path(name).write_text("mine")
    assert run(["compare", "lane.json", "--agents", "2", *QUICK]) == 0
    assert "compare-2.csv, compare-2.png" in capsys.readouterr().out
    assert run(["simulate", "lane.json", "--agents", "2", *QUICK, "--plot"]) == 0
    assert "lane_traffic-2.png" in capsys.readouterr().out
    for name in ("compare.csv", "compare.png", "lane_traffic.png"):
        assert Path(name).read_text() == "mine"
    assert run(["compare", "lane.json", "--agents", "2", *QUICK, "--out", "compare.csv"]) == 0
    assert "compare.csv (replaced), compare.png (replaced)" in capsys.readouterr().out
