"""Who plans: a planner and its settings by command or function, and what reports call it."""

import re
from dataclasses import dataclass, fields, replace
from pathlib import Path

import pytest
from conftest import facts_of
from small_warehouse import ROWS as PLAN
from small_warehouse import TILES

import qdenv
from qdenv.cli.main import run
from qdenv.configurations import PRESETS
from qdenv.grid import parse
from qdenv.registry import Entry
from qdenv.run.config import override
from qdenv.simulation.mapf.negotiated.settings import HIGH, LOW
from qdenv.simulation.mapf.settings import (
    PLANNERS,
    PbsConfig,
    PibtConfig,
    describe_planner,
    find_planner,
    record_planner,
)
from qdenv.types import InputError

STUDIES = ["simulate", "sweep", "compare", "scalability"]
SPARSE = PbsConfig(rule="plain", nodes_per_agent=5.0)
CHOSEN = ["--planner", "pbs", "--planner.rule", "plain", "--planner.nodes-per-agent", "5"]


class CaughtError(Exception):
    """Thrown where a simulation or a search would begin."""


@pytest.fixture
def caught(tmp_path, monkeypatch) -> list:
    """The settings that simulations and searches begin with, in a folder with a plan."""
    monkeypatch.chdir(tmp_path)
    Path("plan.txt").write_text("\n".join(PLAN))
    found = []

    def catch(*given, **named):
        found.append(given)
        raise CaughtError

    monkeypatch.setattr("qdenv.study.traffic.run_seeds", catch)  # binds the other one's, so first
    monkeypatch.setattr("qdenv.study.engine.run_seeds", catch)
    monkeypatch.setattr("qdenv.run.loop.train", catch)
    return found


@pytest.mark.parametrize("planner", PLANNERS.names())
@pytest.mark.parametrize("command", [*STUDIES, "train"])
def test_help_lists_the_settings_of_the_planner_that_is_named_and_no_others(
    command, planner, capsys
):
    with pytest.raises(SystemExit):
        run([command, "--planner", planner, "--help-all"])
    listed = set(re.findall(r"--planner\.([a-z][\w-]*)", capsys.readouterr().out))
    own = {field.name.replace("_", "-") for field in fields(PLANNERS.config(planner))}
    assert {one.removeprefix("no-") for one in listed} == own


@pytest.mark.parametrize("command", STUDIES)
def test_every_study_hands_the_planners_settings_to_the_simulation(command, caught):
    with pytest.raises(CaughtError):
        run([command, "plan.txt", "--agents", "4", *CHOSEN, "--no-stop"])
    with pytest.raises(CaughtError):
        run([command, "plan.txt", "--agents", "4", "--effort", "low", "--planner.no-remember"])
    with pytest.raises(CaughtError):
        run([command, "plan.txt", "--agents", "4"])
    given = [config for _, _, config, *_ in caught]
    assert [one.planner for one in given] == [SPARSE, replace(LOW, remember=False), HIGH]
    assert [one.stop_when_congested for one in given] == [False, True, True]


@dataclass(frozen=True)
class LimitedConfig:
    """Settings of somebody else's planner, one of which a repair has, too."""

    node_limit: int = 3


@pytest.fixture
def limited(monkeypatch):
    monkeypatch.setitem(PLANNERS._entries, "limited", Entry(LimitedConfig, "nowhere:nothing"))


def test_a_search_keeps_settings_of_the_planner_and_of_the_repair_apart(caught, limited):
    with pytest.raises(CaughtError):
        command = ["train", "quick", "--planner", "limited", "--planner.node-limit", "5"]
        run([*command, "--node-limit", "9"])
    ((config, *_),) = caught
    assert config.evaluation.domain.fleet.planner == LimitedConfig(5)
    assert config.evaluation.repair.node_limit == 9


def test_a_search_takes_a_planners_settings_and_says_them(caught, capsys):
    with pytest.raises(CaughtError):
        run(["train", "quick", *CHOSEN])
    with pytest.raises(CaughtError):
        run(["train", "quick", "--planner", "negotiated"])
    said = capsys.readouterr().out.splitlines()
    assert said[0].endswith("; planner: pbs, rule plain, nodes per agent 5")
    assert said[1].endswith("; planner: negotiated, low effort")
    (config, *_), (usual, *_) = caught
    assert config.evaluation.domain.fleet.planner == SPARSE
    assert usual.evaluation == PRESETS["quick"].evaluation  # a search's effort is low


def test_functions_take_a_planners_name_or_its_settings():
    fleet = {"agents": 3, "timesteps": 20, "seeds": 1, "domain": "warehouse-even"}
    layout = parse(PLAN, TILES)
    by_name = qdenv.simulate(layout, planner="pibt", **fleet)
    settings = qdenv.simulate(layout, planner=PibtConfig("host"), stop=False, **fleet)
    assert by_name["runs"] == settings["runs"] and by_name["planner"] == "pibt, swap False"
    assert (by_name["stop"], settings["stop"]) == (True, False)
    (row,) = qdenv.compare([layout], planner=PibtConfig("host"), **fleet)
    assert row.mean_of_all == by_name["mean_of_all"]
    with pytest.raises(InputError, match="pibt has none: leave it out"):
        qdenv.simulate(layout, planner="pibt", effort="low", **fleet)


def test_a_configuration_takes_a_planners_name_its_settings_or_an_effort(limited):
    def planner(**settings):
        return override(PRESETS["quick"], settings).evaluation.domain.fleet.planner

    assert planner(planner="pbs") == PbsConfig() and planner(planner=SPARSE) == SPARSE
    assert planner(effort="high") == HIGH and planner(planner="negotiated") == LOW
    assert planner(planner="pbs", rule="plain") == PbsConfig(rule="plain")
    with pytest.raises(InputError, match="'node_limit': give a whole planner or repair"):
        planner(planner="limited", node_limit=5)


@dataclass(frozen=True)
class NobodyConfig:
    """Settings of no planner."""


def test_an_effort_belongs_to_the_negotiated_planner_alone():
    assert find_planner("low") == LOW and find_planner() == HIGH
    assert find_planner(planner="negotiated", usual="low") == LOW
    assert find_planner(planner=SPARSE) is SPARSE
    with pytest.raises(InputError, match="effort low is for the negotiated planner, and pbs has"):
        find_planner("low", "pbs")
    with pytest.raises(InputError, match="its settings say all"):
        find_planner("low", HIGH)
    with pytest.raises(InputError, match="no planner is registered for NobodyConfig"):
        find_planner(planner=NobodyConfig())


def test_reports_call_a_planner_by_its_name_and_settings():
    assert describe_planner(HIGH) == "negotiated, high effort"
    waiting = replace(LOW, last_resort="wait", backend="host")
    assert describe_planner(waiting) == "negotiated, low effort, last resort wait"
    assert describe_planner(PibtConfig("xla")) == "pibt, swap False"
    assert describe_planner(SPARSE) == "pbs, rule plain, nodes per agent 5"
    record = record_planner(SPARSE)
    assert list(record) == ["name", *(field.name for field in fields(PbsConfig))]
    assert (record["name"], record["nodes_per_agent"]) == ("pbs", 5)


@pytest.mark.slow
def test_facts_of_a_study_hold_all_settings_of_its_planner(folder, capsys):
    Path("plan.txt").write_text("\n".join(PLAN))
    short = ["--agents", "3", "--timesteps", "20", "--seeds", "1", "--planner", "pibt"]
    for command in STUDIES:
        facts = facts_of(command, "plan.txt", *short, "--no-stop")
        said = capsys.readouterr().out
        own = {"name": "pibt", "backend": "auto", "swap": False}
        assert facts["settings"]["planner"] == own
        assert facts["settings"]["stop"] is False
        assert said.splitlines()[0].startswith("3 agents, 20 timesteps, no stop at congestion, ")
        assert said.splitlines()[0].endswith("; planner: pibt, swap False")
