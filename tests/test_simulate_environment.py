"""The environment: the simulator's own runs again, no conflict whatever the actions, pure."""

import functools
from collections.abc import Callable
from itertools import product

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fleet_runs import PLAIN, SERVICES, programs
from robustness.fleets import TILES, random_layout

from qdenv.grid import MOVES, parse
from qdenv.simulation.mapf.audit import check_moves, replay_tasks
from qdenv.simulation.mapf.environment import DOWN, LEFT, RIGHT, UP, WAIT, Environment, settle
from qdenv.simulation.mapf.settings import FleetConfig, PibtConfig
from qdenv.types import InputError

pytestmark = pytest.mark.slow

STEPS, AGENTS = 120, 40


def actions_of(positions: np.ndarray, width: int) -> np.ndarray:
    """Read the actions off recorded positions [T + 1, A]."""
    deltas = [row * width + col for row, col in MOVES]
    moved = positions[1:] - positions[:-1]
    return np.select([moved == delta for delta in deltas], range(4), WAIT).astype(np.int32)


def roll_out(environment: Environment, key: jax.Array, actions: jax.Array) -> tuple:
    """Take [T, A] actions in one scan; returns positions [T + 1, A], goals, rewards, refusals."""

    def body(state, action):
        after, timestep = environment.step(state, action)
        return after, (after.position, after.goal[0], timestep.reward, timestep.refused)

    state, _ = environment.reset(key)
    _, (positions, goals, rewards, refused) = jax.lax.scan(body, state, actions)
    whole = jnp.concatenate([state.position[None], positions])
    return whole, jnp.concatenate([state.goal[:1], goals]), rewards, refused


@pytest.mark.parametrize("rule", [PLAIN, SERVICES], ids=["plain", "services"])
def test_the_moves_of_a_simulated_run_give_the_same_tasks(rule):
    layout = random_layout(np.random.default_rng(3), walls=0.1)
    config = FleetConfig(AGENTS, STEPS, planner=PibtConfig(), stop_when_congested=False)
    prepare, run = programs(rule, config)
    key = jax.random.key(11)
    _, recording = run(prepare(jnp.asarray(layout)), key, jnp.int32(AGENTS))
    positions = np.asarray(recording.positions)
    environment = Environment(layout, rule, AGENTS)
    again, goals, rewards, refused = jax.jit(lambda a: roll_out(environment, key, a))(
        actions_of(positions, layout.shape[1])
    )
    np.testing.assert_array_equal(again, positions)
    np.testing.assert_array_equal(goals[:STEPS], np.asarray(recording.goals)[:STEPS])
    np.testing.assert_array_equal(rewards > 0, recording.finished)
    assert rewards.sum() > 20 and not refused.any()


@pytest.mark.parametrize("rule", [PLAIN, SERVICES], ids=["plain", "services"])
def test_random_actions_never_break_a_rule(rule):
    layout = random_layout(np.random.default_rng(5), walls=0.15)
    free = int(np.isin(layout, [TILES.index(tile) for tile in ".ew"]).sum())
    agents = int(0.8 * free)  # hardly any room: nearly every action meets another robot
    environment = Environment(layout, rule, agents)
    actions = jax.random.randint(jax.random.key(0), (8, 200, agents), -1, 6)
    keys = jax.random.split(jax.random.key(1), 8)
    many = jax.jit(jax.vmap(lambda key, taken: roll_out(environment, key, taken)))
    positions, goals, rewards, refused = (np.asarray(part) for part in many(keys, actions))
    assert refused.mean() > 0.3 and (positions[:, 1:] != positions[:, :-1]).mean() > 0.02
    for run in range(8):
        assert check_moves(layout, rule, positions[run].astype(np.int64)) == []
        driven = positions[run], goals[run], rewards[run] > 0
        assert replay_tasks(layout, rule, *driven)[2] == []
        still = positions[run, 1:] == positions[run, :-1]
        asked = np.asarray((actions[run] >= 0) & (actions[run] < WAIT))
        np.testing.assert_array_equal(refused[run], still & asked)
    assert rewards.sum() > 0


def settled(positions: list[int], wanted: list[int], cells: int) -> list[int]:
    """Settle conflicts one after the other in plain Python, until nothing changes."""
    now = list(wanted)
    while True:
        bad = [
            i
            for i, cell in enumerate(now)
            if cell != positions[i]
            and any(
                j != i and (now[j] == cell or (positions[j] == cell and now[j] == positions[i]))
                for j in range(len(now))
            )
        ]
        if not bad:
            return now
        for i in bad:
            now[i] = positions[i]


def test_every_case_of_three_robots_settles_as_a_slow_oracle_says():
    positions = [1, 2, 4]  # of a 3 x 3 grid, around a corner
    targets = [[1, 0, 2, 4], [2, 1, 5], [4, 1, 3, 5, 7]]  # waits, and all moves within the grid
    settle_all = jax.jit(jax.vmap(lambda wanted: settle(jnp.array(positions), wanted, 9)))
    cases = np.array(list(product(*targets)), np.int32)
    expected = [settled(positions, case.tolist(), 9) for case in cases]
    assert len(cases) == 60
    np.testing.assert_array_equal(settle_all(cases), expected)


ROOM = parse(["....", ".#..", "e..w"], TILES)


@functools.cache
def stepper(agents: int) -> Callable:
    """Compile a step of so many robots from any cells."""
    environment = Environment(ROOM, PLAIN, agents)

    @jax.jit
    def step(cells, actions):
        state, _ = environment.reset(jax.random.key(0))
        fleet = state.fleet._replace(position=cells)
        return environment.step(state._replace(fleet=fleet), actions)[0].position

    return step


@pytest.mark.parametrize(
    ("cells", "actions", "after"),
    [
        ([0], [RIGHT], [1]),
        ([0], [LEFT], [0]),  # off the layout
        ([3], [RIGHT], [3]),  # not around the edge
        ([1], [DOWN], [1]),  # an obstacle
        ([4], [DOWN], [8]),
        ([4], [7], [4]),  # no action
        ([0, 1], [RIGHT, LEFT], [0, 1]),  # a swap
        ([0, 1], [RIGHT, RIGHT], [1, 2]),  # following
        ([0, 1, 2], [RIGHT, RIGHT, WAIT], [0, 1, 2]),  # a waiting robot makes others wait
        ([1, 3], [RIGHT, LEFT], [1, 3]),  # both want one cell
        ([0, 1, 3], [RIGHT, RIGHT, LEFT], [0, 1, 3]),  # and who follows waits, too
        ([2, 3, 7, 6], [RIGHT, DOWN, LEFT, UP], [3, 7, 6, 2]),  # a cycle
    ],
)
def test_an_action_is_a_move_or_a_wait(cells, actions, after):
    moved = stepper(len(cells))(np.array(cells, np.int32), np.array(actions))
    assert moved.tolist() == after


def test_a_learner_brings_its_own_observation_and_counts_its_own_steps():
    def see(state):
        return {"goal is left": state.goal[0] % 4 < state.position % 4, "time": state.time}

    environment = Environment(ROOM, PLAIN, 3, timesteps=2, observe=see)
    state, timestep = jax.jit(environment.reset)(jax.random.key(2))
    assert timestep.observation["goal is left"].shape == (3,)
    lasts = []
    for _ in range(2):
        state, timestep = jax.jit(environment.step)(state, jnp.full(3, WAIT))
        lasts.append((int(timestep.observation["time"]), bool(timestep.last)))
    assert lasts == [(1, False), (2, True)]


def test_runs_on_a_batch_of_layouts_begin_again_by_themselves():
    layouts = np.stack([ROOM, ROOM[::-1]])
    batch = Environment(layouts, PLAIN, 3, timesteps=2, auto_reset=True)
    keys, moves = jax.random.split(jax.random.key(4), 2), jnp.array([[RIGHT, UP, LEFT]] * 2)
    state, first = jax.jit(jax.vmap(batch.reset))(keys, jnp.arange(2))
    step = jax.jit(jax.vmap(batch.step))
    _, after = step(state, moves)
    for row in range(2):  # each as alone on its layout
        alone = Environment(layouts[row], PLAIN, 3, timesteps=2)
        begun, seen = jax.jit(alone.reset)(keys[row])
        _, later = jax.jit(alone.step)(begun, moves[row])
        own = jax.tree.map(lambda leaf, row=row: leaf[row], (first, after))
        chex.assert_trees_all_equal((seen, later), own)
    ends = []
    for _ in range(4):
        state, timestep = step(state, moves)
        ends.append((timestep.last.tolist(), timestep.observation.time.tolist()))
    assert ends == [([False] * 2, [1, 1]), ([True] * 2, [0, 0])] * 2
    assert state.layout.tolist() == [0, 1]
    assert (np.asarray(state.position) != np.asarray(first.observation.position)).any()  # drawn
    assert batch.free[np.arange(2)[:, None], *np.divmod(state.position, ROOM.shape[1])].all()


def test_what_makes_no_environment_is_refused():
    with pytest.raises(InputError, match="12 agents"):
        Environment(ROOM, PLAIN, 12)
    with pytest.raises(InputError, match="agents must be at least 1"):
        Environment(ROOM, PLAIN, 0)
    with pytest.raises(InputError, match="no 'e'"):
        Environment(parse(["..w"], TILES), PLAIN, 1)
