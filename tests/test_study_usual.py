"""What studies of traffic take where nobody says it: usual numbers, and those a size knows."""

from pathlib import Path

import numpy as np
import pytest
from conftest import facts_of

import qdenv
from qdenv.cli.main import run
from qdenv.domains.base import find_domain
from qdenv.io.layouts import write_layout
from qdenv.study.options import usual_fleet

EVEN = find_domain("warehouse-even")
LARGE, SMALL = np.zeros((101, 102), np.int8), np.zeros((33, 36), np.int8)
LINE = "101 x 102 is the paper's evaluation size: "


def test_known_sizes_give_what_nobody_states():
    assert usual_fleet(EVEN, [SMALL]) == (200, 1000, "")
    said = f"{LINE}1400 agents, 5000 timesteps unless stated"
    assert usual_fleet(EVEN, [LARGE, LARGE]) == (1400, 5000, said)
    assert usual_fleet(EVEN, [LARGE], 9)[:2] == (9, 5000)
    assert usual_fleet(EVEN, [LARGE], 9, 8) == (9, 8, "")
    assert usual_fleet(find_domain("warehouse-uneven"), [LARGE])[0] == 1000
    assert usual_fleet(find_domain("manufacturing"), [LARGE])[0] == 1800


def test_layouts_of_several_sizes_are_put_to_the_same_usual_numbers():
    assert usual_fleet(EVEN, [LARGE, SMALL]) == (200, 1000, "")


@pytest.fixture
def hall(folder) -> Path:
    """A file with an empty hall of 101 x 102 to work beside."""
    layout = np.zeros((101, 102), np.int8)
    layout[50, [0, 101]], layout[40:60, 50] = EVEN.tiles.index("w"), EVEN.tiles.index("e")
    write_layout(Path("hall.json"), layout, EVEN.tiles, domain="warehouse-even")
    return Path("hall.json")


@pytest.mark.slow
def test_commands_and_functions_take_them_and_say_so(hall, capsys):
    quick = ["--timesteps", "6", "--seeds", "1", "--planner", "pibt"]
    assert facts_of("simulate", str(hall), "--no-verdict", *quick)["agents"] == 1400
    said = capsys.readouterr().out
    assert said.startswith("1400 agents, 6 timesteps, 1 seed, ")
    assert said.splitlines()[1] == f"{LINE}1400 agents unless stated"
    assert run(["compare", str(hall), *quick]) == 0
    assert f"{LINE}1400 agents unless stated" in capsys.readouterr().out
    facts = qdenv.simulate(hall, timesteps=6, seeds=1, planner="pibt")
    table = qdenv.compare([hall], timesteps=6, seeds=1, planner="pibt")
    assert (facts["agents"], table[0].agents) == (1400, 1400)


@pytest.mark.slow
def test_a_sweep_of_a_known_size_runs_over_as_many_shares_of_its_agents(hall, capsys):
    assert run(["sweep", str(hall), "--timesteps", "2", "--seeds", "1", "--planner", "pibt"]) == 0
    # 50:400:50 of 200 robots, times seven.
    assert capsys.readouterr().out.startswith("350:2800:350 agents, 2 timesteps, ")
