"""Runs for PlanViz: read back by its published rules, and beside its published examples."""

import json

import numpy as np
import pytest
from conftest import STUDY_DATA

from qdenv.io.trajectories import planviz, write_paths

# As PlanViz moves an agent of the action model without turns: row, column.
STEPS = {"R": (0, 1), "L": (0, -1), "U": (1, 0), "D": (-1, 0), "W": (0, 0)}


def replay(content, agent):
    cells = [content["start"][agent][:2]]
    for move in filter(None, content["actualPaths"][agent].split(",")):
        cells.append([a + b for a, b in zip(cells[-1], STEPS[move], strict=True)])
    return cells


@pytest.mark.parametrize("width", [1, 40])
def test_a_run_is_written_so_that_it_can_be_replayed(width, tmp_path):
    rng = np.random.default_rng(width)
    moves = rng.choice([width, -width, 0, *([1, -1] if width > 1 else [])], (6, 3))
    positions = 20 * width + width // 2 + np.concatenate([np.zeros((1, 3), int), moves]).cumsum(0)
    goals, finished = rng.integers(0, 30 * width, positions.shape), np.zeros(moves.shape, bool)
    finished[[1, 3, 2], [0, 0, 2]] = True
    write_paths(tmp_path / "run.json", positions, goals, finished, width)
    content = json.loads((tmp_path / "run.json").read_text())
    for agent in range(3):
        expected = [list(divmod(int(cell), width)) for cell in positions[:, agent]]
        assert replay(content, agent) == expected
    assert content["makespan"] == len(positions) - 1 and content["numTaskFinished"] == 3
    assert content["actualSchedule"] == ["0:0,2:1,4:2", "0:3", "0:4,3:5"]
    assert content["events"] == [[2, 0, 0, 1], [3, 2, 4, 1], [4, 0, 1, 1]]
    places = [divmod(int(goals[t, a]), width) for t, a in [(0, 0), (2, 0), (4, 0)]]
    assert [tuple(task[2]) for task in content["tasks"][:3]] == places


def test_a_run_without_steps_is_one():
    cells = np.array([[3, 4]])
    content = planviz(cells, cells, np.zeros((0, 2), bool), 3)
    assert content["actualPaths"] == ["", ""] and content["tasks"] == [
        [0, 0, [1, 0]],
        [1, 0, [1, 1]],
    ]


def test_keys_and_kinds_are_those_of_the_published_examples():
    folder = STUDY_DATA / "formats"
    if not folder.exists():
        pytest.skip("no published runs here (QDENV_STUDY_DATA names their folder)")
    ours = planviz(np.array([[0], [1]]), np.array([[1], [2]]), np.array([[True]]), 3)
    theirs = json.loads((folder / "planviz_warehouse_small_2024.json").read_text())
    plain = json.loads((folder / "planviz_mapf_plan_example.json").read_text())
    assert ours.keys() == theirs.keys() and plain["actionModel"] == ours["actionModel"]
    for name, value in theirs.items():
        assert type(ours[name]) is type(value), name
    for name in ("start", "events", "tasks", "actualSchedule"):
        assert [*map(type, ours[name][0])] == [*map(type, theirs[name][0])][: len(ours[name][0])]
    # The published paths without turns lead to their goals, upside down: they are older.
    for agent in range(300):
        (first, _), (row, column) = (replay(plain, agent)[end] for end in (0, -1))
        assert [2 * first - row, column] == plain["tasks"][agent][1:]
