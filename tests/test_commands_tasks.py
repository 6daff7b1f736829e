"""What robots do at their goals: settings of a domain as options of commands that simulate."""

import json
from pathlib import Path

import pytest

from qdenv.cli.main import run
from qdenv.domains.base import find_domain
from qdenv.io.layouts import write_layout
from qdenv.ops.traffic import simulate_layout
from qdenv.types import InputError

QUICK = {"planner": "pibt", "timesteps": 100, "seeds": 2}
WORDS = ["--planner", "pibt", "--timesteps", "100", "--seeds", "2", "--agents", "8"]


@pytest.fixture
def factory(tmp_path, monkeypatch) -> Path:
    """A folder with a factory to work in."""
    monkeypatch.chdir(tmp_path)
    domain = find_domain("manufacturing").resized(12, 13)
    write_layout(Path("factory.json"), domain.human(), domain.tiles, domain="manufacturing")
    return tmp_path


def test_stays_of_a_factory_are_options_and_arguments(factory, capsys):
    def finished(*more):
        assert run(["simulate", "factory.json", *WORDS, "--json", "f.json", *more]) == 0
        facts = json.loads(Path("f.json").read_text())
        assert facts["valid"] is True
        return [one["finished_tasks"] for one in facts["runs"]], facts["settings"].get("tasks")

    usual, stated = finished()
    assert stated is None and finished("--stays", "2", "5", "10") == (usual, {"stays": [2, 5, 10]})
    slow, _ = finished("--stays", "25", "25", "25", "--no-stop")
    assert 0 < sum(slow) < sum(usual) / 1.5
    tasks = {"stays": (25, 25, 25)}
    facts = simulate_layout("factory.json", 8, tasks=tasks, verdict=False, stop=False, **QUICK)
    assert [one["finished_tasks"] for one in facts["runs"]] == slow
    assert run(["compare", "factory.json", *WORDS, "--stays", "-1", "0", "0"]) == 2
    assert "stays must be at least 0, not -1" in capsys.readouterr().err


def test_a_domain_without_such_a_setting_says_which_it_has(factory):
    with pytest.raises(InputError, match="manufacturing has no setting 'pick' of tasks: it has st"):
        simulate_layout("factory.json", 8, tasks={"pick": 3}, **QUICK)
