"""What a search takes: as measured here for equal settings, else an estimate."""

import os

import pytest

from qdenv.configurations import PRESETS
from qdenv.ops import costs, output
from qdenv.run.config import choose_algorithm, choose_planner, resolve
from qdenv.run.directory import Metrics
from qdenv.search.settings import DsageConfig


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)


# CPU seconds of an evaluation, measured in whole runs of the presets.
MEASURED = {
    "quick": 0.06, "laptop": 0.91, "warehouse-uneven": 1.14, "manufacturing": 1.14,
    "manufacturing-quick": 0.092, "maze-walls": 0.023, "maze-quick": 0.017, "dsage-quick": 0.25,
    "dsage-laptop": 4.8,
}  # fmt: skip


@pytest.mark.parametrize("name", MEASURED)
def test_estimates_are_near_what_runs_of_the_presets_took(name):
    assert costs.cpu_seconds(PRESETS[name]) == pytest.approx(MEASURED[name], rel=0.45)


def test_every_preset_says_what_it_takes_on_two_cores():
    said = {name: costs.describe_cost(config) for name, config in PRESETS.items()}
    assert all("(an estimate)" in one for one in said.values())
    assert said["warehouse-even-a1"] == said["warehouse-even-cma-es"] == said["warehouse-even"]
    assert said["warehouse-even"] == "about 80 min (an estimate)"
    assert said["warehouse-even-dsage"] == "about 16 days (an estimate)"


def test_estimates_scale_with_the_settings():
    """The search of 100 x 100 cells that "about 8 min" was once promised for takes days."""
    large = {"rows": 100, "cols": 100, "agents": 1000, "timesteps": 5000, "simulations": 10}
    config, _ = resolve(PRESETS["laptop"], large)
    assert costs.describe_cost(config) == "about 9 h (an estimate)"
    base = costs.cpu_seconds(PRESETS["laptop"])
    for change, more in (
        ({"agents": 400}, 0.8),
        ({"timesteps": 2000}, 0.8),
        ({"simulations": 10}, 0.8),
        ({"effort": "high"}, 3.2),
        ({"planner": "pibt"}, -0.55),
    ):
        config, _ = resolve(PRESETS["laptop"], change)
        assert costs.cpu_seconds(config) - base == pytest.approx(more)


def test_nothing_is_promised_of_what_is_unknown(monkeypatch):
    learning = choose_algorithm(PRESETS["laptop"], DsageConfig(inner_batch=7))
    assert costs.describe_cost(learning) == ""
    monkeypatch.delitem(costs._STEP, "pbs")  # like a plug-in's
    assert costs.describe_cost(choose_planner(PRESETS["quick"], None, "pbs")) == ""


def test_a_run_is_remembered_without_its_compilation_for_equal_settings_only():
    quick = PRESETS["quick"]
    rows = [Metrics(n, 50 * n, 0.0, 0.0, 0.0, 30.0 + 2 * n) for n in range(1, 13)]
    costs.remember_cost(quick, rows[:4])  # too few to tell
    assert "estimate" in costs.describe_cost(quick)
    costs.remember_cost(quick, rows)  # 2 s for every 50 evaluations
    assert costs.describe_cost(quick) == "about 24 s (as measured here)"
    for same in ({"evaluations": 1200}, {"workers": 1}, {"seed": 5}, {"alpha": 2.0}):
        config, _ = resolve(quick, same)
        assert "as measured here" in costs.describe_cost(config), same
    for other in ({"agents": 61}, {"rows": 20}, {"timesteps": 201}, {"batch": 7}):
        config, _ = resolve(quick, other)
        assert "estimate" in costs.describe_cost(config), other


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "1 s"), (89, "89 s"), (160, "3 min"), (5700, "95 min"), (10800, "3 h"), (3e5, "3 days")],
)
def test_durations_are_said_in_the_unit_a_person_would_choose(seconds, words):
    assert output.format_duration(seconds) == words
