"""Runs of fleets in files: written, read back, and checked against the rules of movement."""

import json
import random

import numpy as np
import pytest
from conftest import STUDY_DATA, facts_of

import qdenv
from qdenv.cli.main import run as cli
from qdenv.domains.base import find_domain
from qdenv.io.layouts import write_layout
from qdenv.io.trajectories import read_run, write_paths
from qdenv.types import InputError

FLOOR = ["....", ".#..", "...."]
FORMATS = STUDY_DATA / "formats"
# Two robots around an obstacle for two timesteps.
VALID = ["0 0 0 0", "0 1 2 3", "1 0 0 1", "1 1 2 2", "2 0 0 2", "2 1 2 2"]


def lines(tmp_path, text):
    (tmp_path / "floor.txt").write_text("\n".join(FLOOR))
    (tmp_path / "run.txt").write_text("\n".join(text) + "\n")
    return ["audit-run", str(tmp_path / "run.txt"), "--layout", str(tmp_path / "floor.txt")]


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".csv", ".json"])
def test_a_simulated_run_is_written_read_back_and_valid(ending, tmp_path, capsys):
    warehouse = find_domain("warehouse-even").resized(9, 12)
    layout, paths = tmp_path / "plan.json", tmp_path / f"paths{ending}"
    write_layout(layout, warehouse.human(), warehouse.tiles)
    words = f"--robots 8 --timesteps 40 --seeds 3,4 --no-verdict --paths {paths}".split()
    facts = facts_of("simulate", str(layout), *words)
    assert str(paths) in capsys.readouterr().out
    checked = qdenv.audit_run(paths, layout)
    assert checked == [] and checked.facts["valid"] and checked.exit_code == 0
    # The run of the first seed, seed 3.
    assert checked.facts["finished_tasks"] == facts["runs"][0]["finished_tasks"] > 0
    assert (checked.facts["robots"], checked.facts["timesteps"]) == (8, 40)
    assert checked.facts["throughput"] == pytest.approx(facts["runs"][0]["throughput"])


def test_both_forms_hold_the_same_places_and_goals(tmp_path):
    positions, goals = np.array([[0, 7], [1, 7], [1, 11]]), np.array([[1, 11], [9, 11], [9, 8]])
    finished = np.array([[True, False], [False, True]])
    runs = []
    for ending in (".csv", ".json"):
        write_paths(tmp_path / f"run{ending}", positions, goals, finished, 4)
        runs.append(read_run(tmp_path / f"run{ending}"))
        assert (runs[-1].cells @ [4, 1] == positions).all()
        reached = [(one.time, one.robot, one.place) for one in runs[-1].errands]
        assert sorted(reached) == [(1, 0, (0, 1)), (2, 1, (2, 3))]
    assert (runs[0].finished, runs[1].finished) == (None, 2)
    content = json.loads((tmp_path / "run.json").read_text())
    older = [path.translate(str.maketrans("UD", "DU")) for path in content["actualPaths"]]
    assert older != content["actualPaths"]
    (tmp_path / "run.json").write_text(json.dumps(content | {"actualPaths": older}))
    assert (read_run(tmp_path / "run.json").cells == runs[1].cells).all()


def test_lines_are_read_in_any_order_with_any_separator(tmp_path):
    (tmp_path / "plain.txt").write_text("\n".join(VALID))
    plain = read_run(tmp_path / "plain.txt").cells
    assert plain.tolist()[1] == [[0, 1], [2, 2]]
    shuffled = [";".join([*reversed(line.split()), "moving", "0.97"]) for line in VALID]
    random.Random(0).shuffle(shuffled)
    (tmp_path / "own.csv").write_text(
        "\n".join(["column;row;agent;timestep;state;battery", *shuffled])
    )
    assert (read_run(tmp_path / "own.csv").cells == plain).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({}, "every rule of movement is obeyed"),
        ({3: "1 1 1 1"}, "t=1: agent 1 stands on an obstacle at (1, 1)"),
        ({3: "1 1 2 3", 5: "2 1 0 2"}, "t=1: agent 1 makes more than one step at once"),
        ({1: "0 1 0 0"}, "t=0: two agents on cell (0, 0): 0 and 1"),
        ({1: "0 1 0 1", 3: "1 1 0 0"}, "t=0: agents swap cells (0, 1) and (0, 0)"),
        ({5: "2 1 3 2"}, "t=2: agent 1 is outside the layout"),
        ({5: "2 1 2 -1"}, "t=2: agent 1 is outside the layout"),
    ],
)
def test_the_first_broken_rules_are_named(change, said, tmp_path, capsys):
    text = [change.get(number, line) for number, line in enumerate(VALID)]
    assert cli([*lines(tmp_path, text), "--domain", "map"]) == (1 if change else 0)
    out = capsys.readouterr().out
    assert said in out and "2 robots, 2 timesteps, goals unknown, domain map" in out


def league(**changes):
    return {
        "actionModel": "MAPF_T",
        "start": [[0, 0, "E"], [2, 3, "N"]],
        "actualPaths": ["F,F,W", "C,F,W"],
        "tasks": [[0, 0, [0, 1, 0, 2]], [1, 0, [2, 2]]],
        "events": [[1, 0, 0, 1], [2, 0, 0, 2], [2, 1, 1, 1]],
        "numTaskFinished": 2,
    } | changes


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "2 robots, 3 timesteps, 2 tasks finished"),
        ({"actionModel": "MAPF", "actualPaths": ["R,R,W", "W,L,W"]}, "2 tasks finished"),
        ({"tasks": [[0, 0, 1], [1, 2, 2]], "numTaskFinished": 2,
          "events": [[[0, 0, "assigned"], [0, 1, "finished"]], [[1, 3, "finished"]]]},
         "2 tasks finished"),
        ({"agentMaxCounter": 2, "tasks": [], "events": [], "numTaskFinished": 0,
          "actualPaths": ["[(0,0,0,0,0):(F 3)][(3,0,0,0,0):(F 1,W 1)]", "[(0,2,3,0,0):(C 2,F 3)]"]},
         "5 timesteps, goals unknown"),
        ({"events": [[1, 0, 0, 2]], "numTaskFinished": 1},
         "t=1: robot 0 finishes task 0 at (0, 1), and its goal is (0, 2)"),
        ({"numTaskFinished": 3}, "the file states 3 finished tasks, its events show 2"),
        ({"events": [[2, 1, 1, 1], [3, 1, 1, 1]], "numTaskFinished": 1},
         "t=3: robot 1 finishes task 1 for a second time"),
        ({"events": [[9, 1, 1, 1]]}, "and the run has no such time or robot"),
    ],
)  # fmt: skip
def test_the_leagues_generations_are_read_and_their_tasks_counted(changes, said, tmp_path, capsys):
    (tmp_path / "floor.txt").write_text("\n".join(FLOOR))
    (tmp_path / "run.json").write_text(json.dumps(league(**changes)))
    words = ["audit-run", str(tmp_path / "run.json"), "--layout", str(tmp_path / "floor.txt")]
    broken = any(word in said for word in ("finishes", "states", "no such"))
    assert cli([*words, "--domain", "map"]) == broken
    assert said in capsys.readouterr().out


@pytest.mark.parametrize(
    "changes",
    [{"tasks": [[0, float("inf"), 3]], "events": [[1, 0, 0, 1]]}, {"events": [[2, 1, 1, 0]]}],
)
def test_a_task_at_infinity_is_no_task_and_errands_count_from_one(changes, tmp_path):
    (tmp_path / "run.json").write_text(json.dumps(league(**changes)))
    with pytest.raises(InputError, match="events and tasks are not those of"):
        read_run(tmp_path / "run.json")


def test_a_path_of_2026_takes_its_counter_for_a_step_or_a_turn(tmp_path):
    paths = ["[(0,0,0,0,0):(F 3)][(3,0,0,0,0):(F 1,R 2,F 2)]"]
    own = league(agentMaxCounter=2, actualPaths=paths, tasks=[], events=[])
    (tmp_path / "run.json").write_text(json.dumps(own))
    cells = read_run(tmp_path / "run.json").cells[:, 0].tolist()
    assert cells == [[0, 0], [0, 0], [0, 1], [0, 1], [0, 2], [0, 2], [0, 2], [0, 2], [1, 2]]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.csv", "", "no lines of timestep, robot, row, column"),
        ("a.csv", "time,robot,row\n0,0,0\n", "no column timestep"),
        ("a.csv", "0,0,0\n", "'0 0 0' is not a line of timestep, robot, row, column in integers"),
        ("a.csv", "0,0,0,0\n0,1,x,0\n", "'0 1 x 0' is not a line of"),
        ("a.csv", "0 0 0 0\n2 0 0 0\n", "robot 0 has no place at timestep 1: give it one"),
        ("a.csv", "0 5 0 0\n0 5 1 0\n", "robot 5 has 2 places at timestep 0"),
        ("a.csv", "0 0 0 0\n999999999999 0 0 0\n", "more than 20,000,000 robots times timesteps"),
        ("a.csv", f"{-(2**63)} 0 0 0\n{2**63 - 5} 0 0 0\n", "more than 20,000,000 robots times"),
        ("a.csv", f"0 0 0 {10**30}\n", "is not a line of"),
        ("a.json", "{}", "actionModel: is missing"),
        ("a.json", "[", "not a JSON file"),
        ("a.json", json.dumps(league(actionModel="CARS")), "action model 'CARS'"),
        ("a.json", json.dumps(league(start=[])), "2 paths with 0 starts"),
        ("a.json", json.dumps(league(actualPaths=["F", "U"])), "robot 1: 'U' is none of W T F R C"),
        ("a.json", json.dumps(league(actualPaths=["[(0):(F 9", "W"])), "robot 0: '?' is none of"),
        ("a.json", json.dumps(league(actualPaths=["[(0):(F 9999999,F 9999999)]" * 9, "W"])),
         "too many actions"),
        ("a.json", json.dumps(league(events=[[1, 0, 7, 1]])), "events and tasks are not those of"),
        ("a.json", json.dumps(league(events=7)), "events and tasks are not those of"),
        ("a.json", json.dumps(league(tasks=[["a"]])), "events and tasks are not those of"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_run_is_answered_in_a_line(name, text, said, tmp_path):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as error:
        read_run(tmp_path / name)
    assert said in str(error.value)


def test_any_damage_is_answered_in_a_line_or_read(tmp_path):
    """One byte of a run is changed, dropped or doubled, 100 times for each form."""
    rng = random.Random(0)
    for name, text in (("a.csv", "\n".join(VALID)), ("a.json", json.dumps(league()))):
        for _ in range(100):
            place, new = rng.randrange(len(text)), rng.choice('0-9,"[]{} \nFRx')
            damaged = text[:place] + rng.choice(["", new, new * 2]) + text[place + 1 :]
            (tmp_path / name).write_text(damaged)
            try:
                read_run(tmp_path / name)
            except InputError as error:
                assert "\n" not in str(error)


def test_a_run_in_a_maze_is_refused(tmp_path, capsys):
    words = lines(tmp_path, VALID)
    assert cli([*words, "--domain", "maze-walls"]) == 2
    assert "no fleet drives in maze-walls" in capsys.readouterr().err


@pytest.mark.skipif(not FORMATS.exists(), reason="nobody has the examples here")
@pytest.mark.parametrize(
    ("name", "tasks", "floor"),
    [
        ("warehouse_small_2023", 100, "warehouse_small"),
        ("warehouse_small_2024", 33, "warehouse_small"),
        ("warehouse_small_2026", 387, "warehouse_small"),
        ("mapf_plan_example", 300, "random-32-32-20"),
    ],
)
def test_published_runs_obey_the_rules_and_finish_what_they_state(name, tasks, floor):
    checked = qdenv.audit_run(FORMATS / f"planviz_{name}.json", FORMATS / f"planviz_{floor}.map")
    assert checked.facts["valid"] and checked.facts["finished_tasks"] == tasks
