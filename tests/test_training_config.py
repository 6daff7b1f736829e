"""Configurations: to JSON and back for every preset, schema 1, one line for every mistake."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from qdenv.domains.manufacturing import ManufacturingConfig
from qdenv.domains.maze import MazeConfig
from qdenv.domains.warehouse import UnevenWarehouseConfig
from qdenv.generate.nca import NcaConfig
from qdenv.presets import PRESETS
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.simulate.mapf.negotiated.settings import HIGH
from qdenv.simulate.mapf.pbs.settings import PbsConfig
from qdenv.simulate.mapf.pibt.settings import PibtConfig
from qdenv.training.config import config_from_json, config_to_json
from qdenv.training.records import Metrics, RunDirectory
from qdenv.types import InputError

SOURCE = Path("RUN/config.json")
# As written by the first version, whose one flat record held the numbers of every domain.
SCHEMA_1 = {
    "evaluation": {
        "domain": "warehouse-uneven", "rows": 33, "cols": 36, "steps": 50,
        "kernel_sizes": [3, 1, 1], "hidden": 16, "shelves": 230, "agents": 150, "timesteps": 700,
        "simulations": 4, "effort": "high", "alpha": 1.0, "agent": "",
        "repair": {
            "polish": "quick", "moves_per_cell": 0, "gap": 0.0, "node_limit": 0,
            "time_limit": 1800.0, "workers": 2,
        },
    },
    "algorithm": {
        "name": "cma-mae", "emitters": 5, "batch": 10, "sigma0": 0.2, "learning_rate": 0.01,
        "threshold_min": 0.0, "ranker": "imp", "selection": "mu", "restart": "no_improvement",
        "strategy": "iso",
    },
    "evaluations": 1000, "archive": [[0, 40, 20], [0, 1, 20]], "seed": 3, "checkpoint_every": 5,
}  # fmt: skip


def through_json(content: dict) -> dict:
    return json.loads(json.dumps(content))


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_returns_from_json(name):
    config = PRESETS[name]
    assert config_from_json(through_json(config_to_json(config)), SOURCE) == config


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (PibtConfig("xla"), {"name": "pibt", "backend": "xla"}),
        (PbsConfig(rule="plain"), {"name": "pbs", "rule": "plain"}),
    ],
)
def test_another_planner_returns_from_json(settings, said):
    preset = PRESETS["quick"]
    fleet = FleetConfig(agents=3, planner=settings)
    domain = replace(preset.evaluation.domain, fleet=fleet)
    config = replace(preset, evaluation=replace(preset.evaluation, domain=domain))
    content = config_to_json(config)
    planner = content["evaluation"]["domain"]["fleet"]["planner"]
    assert planner.items() >= said.items()
    assert config_from_json(through_json(content), SOURCE) == config


def test_schema_1_is_still_read():
    config = config_from_json(SCHEMA_1, SOURCE)
    fleet = FleetConfig(agents=150, timesteps=700, planner=HIGH)
    assert config.evaluation.domain == UnevenWarehouseConfig(shelves=230, fleet=fleet)
    assert config.evaluation.generator == NcaConfig(50, (3, 1, 1), 16)
    assert (config.evaluation.simulations, config.evaluation.alpha) == (4, 1.0)
    assert (config.evaluation.repair.workers, config.evaluation.repair.node_limit) == (2, None)
    assert (config.seed, config.archive) == (3, ((0, 40, 20), (0, 1, 20)))
    assert config_from_json(through_json(config_to_json(config)), SOURCE) == config


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("manufacturing", ManufacturingConfig(fleet=FleetConfig(150, 700, planner=HIGH))),
        ("maze-walls", MazeConfig(33, 36, timesteps=700)),
    ],
)
def test_numbers_that_a_domain_never_had_are_dropped_from_schema_1(name, settings):
    evaluation = SCHEMA_1["evaluation"] | {"domain": name}
    config = config_from_json(SCHEMA_1 | {"evaluation": evaluation}, SOURCE)
    assert config.evaluation.domain == settings


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
