"""The movement rules: every drawing of the rules' page, run through the independent audit."""

import re

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.grid import pad
from qdenv.simulation import __doc__ as rules
from qdenv.simulation.mapf.agents import drive, place
from qdenv.simulation.mapf.audit import check_moves, jammed_windows, replay_tasks
from qdenv.simulation.mapf.fleet import FleetConfig, prepare, run_settings
from qdenv.simulation.mapf.goals import tile_goal
from qdenv.simulation.mapf.host.state import drive_window, make_run
from qdenv.simulation.mapf.metrics import Block
from qdenv.simulation.mapf.planner import serve
from qdenv.types import TaskRule

TILES = ".#12"
BLOCK = re.compile(r"^ {4}(allowed|forbidden|tasks|jam|no jam): (.*)\n((?: {4}\S.*\n)+)", re.M)
EXAMPLES = BLOCK.findall(rules)
jit_or_not = pytest.mark.parametrize("variant", [jax.jit, lambda f: f], ids=["jit", "no jit"])


def rule(stay: int = 0) -> TaskRule:
    return TaskRule(TILES, ".12", tuple(tile_goal(goal, TILES, stay) for goal in "12"))


def read(drawing: str) -> tuple[np.ndarray, np.ndarray]:
    """Read (layout int8 [H, W], positions int [T + 1, A]) from pictures side by side."""
    rows = [row.split() for row in drawing.strip("\n").splitlines()]
    pictures = [["".join(part) for part in picture] for picture in zip(*rows, strict=True)]
    cells = ["".join(picture) for picture in pictures]
    agents = sorted(set(cells[0]) - set(".#"))
    layout = [[TILES.index("#" if tile == "#" else ".") for tile in row] for row in pictures[0]]
    positions = [[cell.find(agent) for agent in agents] for cell in cells]
    return np.array(layout, np.int8), np.array(positions)


def test_every_rule_is_drawn():
    assert sorted(kind for kind, _, _ in EXAMPLES) == sorted(
        ["allowed"] * 3 + ["forbidden"] * 4 + ["tasks"] * 2 + ["jam", "no jam"]
    )


@pytest.mark.parametrize("example", [e for e in EXAMPLES if e[0] in ("allowed", "forbidden")])
def test_drawn_moves(example: tuple[str, str, str]):
    kind, text, drawing = example
    layout, positions = read(drawing)
    if text == "agents on cell":  # the second picture can show only one of the two
        positions[1] = positions[1].max()
    broken = check_moves(layout, rule(), positions)
    assert (broken == []) == (kind == "allowed")
    assert kind == "allowed" or any(text.split()[-1] in message for message in broken)


@pytest.mark.parametrize("example", [e for e in EXAMPLES if e[0] == "tasks"])
def test_drawn_tasks(example: tuple[str, str, str]):
    _, text, drawing = example
    stay, cells, times = re.match(r"stay (\d+) on (\S+), finished at (.*)", text).groups()
    expected = [int(time) for time in times.split()]
    _, positions = read(drawing)
    layout = np.array([[TILES.index(tile) for tile in cells]], np.int8)
    end = len(positions) - 1
    done = np.isin(np.arange(1, end + 1), expected)[:, None]
    kind = np.concatenate([[0], np.cumsum(done)]) % 2
    goals = np.array([cells.index("12"[k]) for k in kind])[:, None]
    finished, _, broken = replay_tasks(layout, rule(int(stay)), positions, goals, done)
    assert broken == []
    assert np.flatnonzero(finished).tolist() == [time - 1 for time in expected]


@pytest.mark.parametrize("example", [e for e in EXAMPLES if e[0] in ("jam", "no jam")])
def test_drawn_jams(example: tuple[str, str, str]):
    kind, _, drawing = example
    _, positions = read(drawing)
    jams = jammed_windows(positions, np.zeros(positions.shape, bool), horizon=5)
    assert jams == ([5] if kind == "jam" else [])


def test_serving_agents_are_not_stuck():
    positions = np.tile([0, 1, 3], (6, 1))
    serving = np.zeros(positions.shape, bool)
    serving[2, :2] = True
    assert jammed_windows(positions, serving, horizon=5) == []


def test_a_short_stay_and_a_skipped_goal_are_found():
    layout = np.array([[TILES.index(tile) for tile in "1..2"]], np.int8)
    positions = np.array([[1], [0], [1], [2]])
    done = np.zeros((3, 1), bool)
    stays = positions, np.zeros((4, 1), int), done
    assert any("stay short" in m for m in replay_tasks(layout, rule(2), *stays)[2])
    skips = positions + 1, np.array([[0], [0], [3], [3]]), done
    assert any("skips its goal" in m for m in replay_tasks(layout, rule(), *skips)[2])
    wrong = positions, np.zeros((4, 1), int), ~done
    assert any("credited wrongly" in m for m in replay_tasks(layout, rule(), *wrong)[2])


@jit_or_not
def test_a_service_begins_on_arrival_and_finishes_the_task_at_its_end(variant):
    # Driving, arriving (without a service, with one), serving (on, to the end), each once.
    remaining = jnp.array([0, 0, 0, 3, 1])
    on_goal = jnp.array([False, True, True, True, True])
    service_time = jnp.array([7, 0, 2, 9, 9])
    left, finished = variant(serve)(remaining, on_goal, service_time)
    chex.assert_type([left, finished], [jnp.int32, bool])
    assert left.tolist() == [0, 0, 2, 2, 0]
    assert finished.tolist() == [False, True, False, False, True]


@jit_or_not
def test_padding_moves_every_cell_inwards_and_back(variant):
    cells = jnp.arange(3 * 4)
    padded = variant(lambda cells: pad(cells, 4, 2))(cells)
    assert padded.reshape(3, 4)[:, 0].tolist() == [18, 26, 34]  # rows are 8 wide now
    assert variant(lambda cells: pad(cells, 8, -2))(padded).tolist() == cells.tolist()


HALL = np.array([[TILES.index(tile) for tile in "12."]], np.int8)
# Goals 1 and 2 without a stay, then goal 1 again with one of two timesteps.
STAYS = (("1", 0), ("2", 0), ("1", 2))
ROUND = TaskRule(TILES, ".12", tuple(tile_goal(goal, TILES, stay) for goal, stay in STAYS))
# Two windows of five steps: in the first the agent comes upon its third goal twice.
WALK = np.array([1, 0, 1, 0, 1, 0, 0, 0, 0, 1, 1])
LEFT_TO_SERVE = [0, 0, 0, 0, 0, 2, 1, 0, 0, 0]
ENDS = np.array([1, 1, 0, 0, 0, 0, 0, 1, 0, 0], bool)
CONFIG = FleetConfig(agents=1, timesteps=10, horizon=5, stop_when_congested=False)


def test_a_stay_at_a_goal_that_no_plan_knew_begins_after_the_next_plan():
    goals = np.where(np.cumsum(ENDS) - ENDS == 1, 1, 0)
    steps = WALK[:, None], np.append(goals, 0)[:, None], ENDS[:, None]
    finished, _, broken = replay_tasks(HALL, ROUND, *steps, horizon=5)
    assert broken == [] and (finished[:, 0] == ENDS).all()
    assert any("stay short" in one for one in replay_tasks(HALL, ROUND, *steps)[2])


@pytest.mark.slow
def test_both_backends_let_such_a_stay_wait():
    world = jax.tree.map(np.asarray, prepare(HALL, ROUND, CONFIG))
    cells = pad(WALK, 3, world.margin)
    block = Block(*(np.zeros((10, 1), kind) for kind in (np.int32, np.int32, np.bool_, np.int32)))
    run = make_run(world, run_settings(CONFIG), 1, block)
    run.position[:], run.goal[:] = cells[0], [[0], [1]]
    fleet, active = place(world, CONFIG.window, np.ones(1, bool), np.uint32(0)), np.ones(1, bool)
    fleet = fleet._replace(position=jnp.int32(cells[:1]), goal=jnp.int32([[0], [1]]))
    left, ends = [], []
    for window in range(2):
        ahead = cells[5 * window : 5 * window + 6]
        run.paths[0, :6] = ahead
        drive_window(run, None)
        fleet = fleet._replace(legs=jnp.zeros_like(fleet.legs))
        for cell in ahead[1:]:
            fleet, finished = drive(world, fleet, jnp.int32([cell]), active, np.uint32(0))
            left.append(int(fleet.remaining_service[0]))
            ends.append(bool(finished[0]))
    assert left == block.remaining_service[:, 0].tolist() == LEFT_TO_SERVE
    assert ends == block.finished[:, 0].tolist() == ENDS.tolist()
