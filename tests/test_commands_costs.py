"""What a preset takes: as measured here, else an estimate."""

import os

import pytest

from qdenv.configurations import PRESETS
from qdenv.ops import output, searches
from qdenv.run.config import choose_algorithm, choose_planner
from qdenv.run.directory import Metrics


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(os, "cpu_count", lambda: 2)


def test_every_preset_says_what_it_takes_on_two_cores():
    said = {name: searches.describe_cost(name, config) for name, config in PRESETS.items()}
    assert said["quick"] == "about 18 s (an estimate)"  # 600 evaluations of 0.06 CPU s
    assert said["warehouse-even-a1"] == said["warehouse-even"] == "about 76 min (an estimate)"
    assert all(said.values())
    # A surrogate learns for longer than a simulation takes: nothing follows from the base.
    assert said["dsage-laptop"] == "about 7 h (an estimate)"
    assert said["warehouse-even-dsage"] == "about 16 days (an estimate)"
    assert searches.describe_cost("quick", choose_algorithm(PRESETS["quick"], "dsage")) == ""
    for effort, planner in (("high", None), (None, "pbs")):
        other = choose_planner(PRESETS["quick"], effort, planner)
        assert searches.describe_cost("quick", other) == ""


def test_another_algorithm_takes_what_its_base_takes_and_an_exact_name_comes_first():
    def say(name):
        return searches.describe_cost(name, PRESETS[name])

    assert say("warehouse-even-map-elites") == say("warehouse-even-cma-es") == say("warehouse-even")
    assert say("maze-walls-map-elites") == say("maze-walls")
    # 600 evaluations of 0.092 CPU s on two cores, not the 1.14 s of "manufacturing".
    assert say("manufacturing-quick") == "about 28 s (an estimate)"
    rows = [Metrics(n, 50 * n, 0.0, 0.0, 0.0, 30.0 + 36 * n) for n in range(1, 13)]
    searches.remember_cost("warehouse-even", rows)  # 0.72 s an evaluation
    assert say("warehouse-even-cma-es") == "about 120 min (as measured here)"
    searches.remember_cost("warehouse-even-cma-es", [row._replace(seconds=row[0]) for row in rows])
    assert say("warehouse-even-cma-es") == "about 3 min (as measured here)"
    assert searches.describe_cost("mine", PRESETS["quick"]) == ""


def test_a_run_is_remembered_without_its_compilation():
    rows = [Metrics(n, 50 * n, 0.0, 0.0, 0.0, 30.0 + 2 * n) for n in range(1, 13)]
    searches.remember_cost("quick", rows[:4])  # too few to tell
    assert "estimate" in searches.describe_cost("quick", PRESETS["quick"])
    searches.remember_cost("quick", rows)  # 2 s for every 50 evaluations
    assert searches.describe_cost("quick", PRESETS["quick"]) == "about 24 s (as measured here)"


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.2, "1 s"), (89, "89 s"), (160, "3 min"), (5700, "95 min"), (10800, "3 h"), (3e5, "3 days")],
)
def test_durations_are_said_in_the_unit_a_person_would_choose(seconds, words):
    assert output.format_duration(seconds) == words
