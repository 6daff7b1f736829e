"""Configurations: to JSON and back for every preset, one line for every mistake."""

import json
from pathlib import Path

import pytest

from qdenv.configurations import PRESETS
from qdenv.run.config import config_from_json, config_to_json, override
from qdenv.run.directory import Metrics, RunDirectory
from qdenv.simulation.mapf.settings import PbsConfig, PibtConfig
from qdenv.types import InputError

SOURCE = Path("RUN/config.json")


def through_json(content: dict) -> dict:
    return json.loads(json.dumps(content))


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_returns_from_json(name):
    config = PRESETS[name]
    assert config_from_json(through_json(config_to_json(config)), SOURCE) == config


def test_settings_that_older_files_lack_are_what_held_then():
    content = through_json(config_to_json(PRESETS["manufacturing-quick"]))
    evaluation = content["evaluation"]
    assert evaluation["generator"].pop("arithmetic") == "exact"
    assert evaluation["domain"].pop("goal_odds") == "endpoints"
    old = config_from_json(content, SOURCE)
    former = {"arithmetic": "float", "goal_odds": "stations"}
    assert old == override(PRESETS["manufacturing-quick"], former)
    assert config_from_json(through_json(config_to_json(old)), SOURCE) == old


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (PibtConfig("xla"), {"name": "pibt", "backend": "xla"}),
        (PbsConfig(rule="plain"), {"name": "pbs", "rule": "plain"}),
    ],
)
def test_another_planner_returns_from_json(settings, said):
    config = override(PRESETS["quick"], {"agents": 3, "planner": settings})
    content = config_to_json(config)
    planner = content["evaluation"]["domain"]["fleet"]["planner"]
    assert planner.items() >= said.items()
    assert config_from_json(through_json(content), SOURCE) == config


def changed(path: str, value: object) -> dict:
    content = through_json(config_to_json(PRESETS["quick"]))
    *way, last = path.split(".")
    inner = content
    for key in way:
        inner = inner[key]
    inner[last] = value
    return content


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({}, "evaluation"),
        (changed("evaluation.domain.name", "moon"), "unknown domain 'moon'"),
        (changed("evaluation.domain.fleet.planner.name", "moon"), "unknown planner 'moon'"),
        (changed("algorithm.name", "luck"), "unknown algorithm 'luck'"),
        (changed("evaluation.domain.rows", "many"), "rows"),
        (changed("evaluation.domain.towers", 3), "towers"),
        (changed("evaluation.domain.fleet.agents", 0), "agents must be at least 1, not 0"),
    ],
)
def test_mistakes_give_one_line_that_names_the_file(content, said):
    with pytest.raises(InputError, match=said) as refusal:
        config_from_json(content, SOURCE)
    assert str(SOURCE) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_metrics_of_an_older_run_are_read_and_damaged_ones_refused(tmp_path):
    run = RunDirectory(tmp_path)
    table = tmp_path / "metrics.csv"
    table.write_text(
        "iteration,evaluations,qd_score,coverage,best_objective,seconds\n1,8,2.5,0.1,0.7,3.25\n"
    )
    assert run.read_metrics() == [Metrics(1, 8, 2.5, 0.1, 0.7, 3.25)]
    for text in ("iteration\nmany\n", "speed\n3\n", table.read_text()[:-6].replace("0.7", "")):
        table.write_text(text)
        with pytest.raises(InputError, match="cannot be read"):
            run.read_metrics()
