"""Whole simulations: no rule is ever broken, whatever the layout, the fleet and the planner."""

from dataclasses import dataclass, replace

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fleet_runs import (
    AGENTS,
    CONFIG,
    PLAIN,
    SERVICES,
    TIMESTEPS,
    StandConfig,
    programs,
    run_audited,
)
from robustness.fleets import SHAPE, TILES, random_layout

from qdenv.grid import parse
from qdenv.registry import Entry
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.goals import beside_goal, check_playable, tile_goal
from qdenv.simulation.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulation.mapf.pibt.planner import rollout
from qdenv.simulation.mapf.planner import Planner, draw_goals, goal_table
from qdenv.simulation.mapf.settings import PLANNERS, PibtConfig
from qdenv.types import InputError, TaskRule

pytestmark = pytest.mark.slow

NEGOTIATED = programs(SERVICES, CONFIG)


def test_a_million_agent_steps_break_no_rule():
    steps = 0

    @hypothesis.settings(max_examples=240, deadline=None, derandomize=True)
    @hypothesis.given(st.integers(0, 2**31 - 1), st.floats(0.0, 0.35), st.floats(0.2, 0.8))
    def check(seed: int, walls: float, crowd: float):
        nonlocal steps
        layout = random_layout(np.random.default_rng(seed), walls)
        agents = max(1, int(crowd * min(AGENTS, 0.6 * (layout != 1).sum())))
        steps += run_audited(NEGOTIATED, SERVICES, CONFIG, layout, seed, agents)[1]

    check()
    assert steps >= 1_000_000


@pytest.mark.parametrize(
    "planner",
    [PibtConfig(), NegotiatedConfig(last_resort="wait", rounds=1.0)],
    ids=["pibt", "waiting as last resort"],
)
def test_other_planners_break_no_rule(planner):
    # Few agents and no early end: the last resort that waits would jam a crowd at once.
    config = fleet.FleetConfig(agents=12, timesteps=60, planner=planner, stop_when_congested=False)
    compiled = programs(SERVICES, config)
    finished = 0
    for seed in range(12):
        layout = random_layout(np.random.default_rng(seed), 0.2)
        traffic, _ = run_audited(compiled, SERVICES, config, layout, seed, 12)
        finished += int(traffic.finished.sum())
    assert finished > 12 * 12  # a plan that obeys by standing still would pass the audit alone


def test_a_planner_says_its_own_limits():
    layout = random_layout(np.random.default_rng(0), 0.2)
    for name, planner, most in (("negotiated", CONFIG.planner, 10), ("stand", StandConfig(), 30)):
        longest = replace(CONFIG, planner=planner, window=most)
        fleet.prepare(layout, PLAIN, longest)
        with pytest.raises(InputError, match=f"'{name}' plans at most {most} .* not {most + 1}"):
            fleet.prepare(layout, PLAIN, replace(longest, window=most + 1))
    with pytest.raises(InputError, match="horizon must be at most window, 5, not 6"):
        fleet.FleetConfig(horizon=6, window=5)
    with pytest.raises(InputError, match="no planner is registered for str"):
        fleet.FleetConfig(planner="low")
    for planner, limit in ((StandConfig(), 15), (fleet.FleetConfig().planner, 1000)):
        config = replace(CONFIG, planner=planner)
        rule = PLAIN._replace(cycle=(tile_goal("e", TILES, limit + 1),))
        with pytest.raises(InputError, match=f"at most {limit} timesteps, not {limit + 1}"):
            fleet.prepare(layout, rule, config)
        fleet.prepare(layout, rule._replace(cycle=(tile_goal("e", TILES, limit),)), config)


def test_the_margin_is_the_planners_wish_and_starts_do_not_depend_on_it():
    layout = random_layout(np.random.default_rng(3), 0.2)
    starts = []
    for planner, margin in ((StandConfig(), 2), (PibtConfig(), 1), (CONFIG.planner, 10)):
        config = replace(CONFIG, planner=planner, agents=30, timesteps=1)
        prepare, run = programs(PLAIN, config)
        world = prepare(layout)
        assert world.traversable.shape == tuple(side + 2 * margin for side in SHAPE)
        starts.append(run(world, jax.random.key(4), None)[1].positions[0])
    np.testing.assert_array_equal(starts[0], starts[1])
    np.testing.assert_array_equal(starts[0], starts[2])


def test_one_agent_drives_shortest_ways():
    """Alone, every leg takes its distance and its service: task times have a closed form."""
    layout = np.full(SHAPE, TILES.index("#"), np.int8)
    layout[4] = parse(["#e........w##"], TILES)[0]
    prepare, run = NEGOTIATED
    for seed in range(3):
        traffic, recording = run(prepare(jnp.asarray(layout)), jax.random.key(seed), jnp.int32(1))
        # Being there takes one step, too.
        first = int(recording.positions[0, 0]) % SHAPE[1] - 1 or 1
        legs = [first] + [9 + 2, 9 + 11, 9, 9] * 10  # to w and 2 there, to e and 11, to w, to e
        times = np.cumsum(legs)
        found = np.flatnonzero(traffic.finished) + 1
        np.testing.assert_array_equal(found, times[times <= TIMESTEPS])


@dataclass(frozen=True)
class CountedConfig:
    """PIBT that counts how often it is traced."""


def test_padding_agents_change_nothing_and_nothing_is_traced_twice():
    traced = 0

    def counted(world, state, horizon, key):
        nonlocal traced
        traced += 1
        return rollout(world, state, horizon, key)

    PLANNERS.register("counted", Entry(CountedConfig, lambda settings: Planner(counted)))
    layouts = [random_layout(np.random.default_rng(seed), 0.2) for seed in range(2)]
    wide = fleet.FleetConfig(agents=30, timesteps=40, planner=CountedConfig())
    prepare, run = programs(PLAIN, wide)
    for layout in layouts:
        world = prepare(jnp.asarray(layout))
        for agents in (10, 20, 30):
            traffic, recording = run(world, jax.random.key(agents), jnp.int32(agents))
            assert np.isclose(traffic.usage.sum(), 1)
            assert int(recording.active.sum()) == agents
    compiled_once = traced
    exact = fleet.FleetConfig(agents=10, timesteps=40, planner=PibtConfig())
    ours = programs(PLAIN, exact)[1](world, jax.random.key(10), jnp.int32(10))[1]
    theirs = run(world, jax.random.key(10), jnp.int32(10))[1]
    np.testing.assert_array_equal(ours.positions[0], theirs.positions[0, :10])
    np.testing.assert_array_equal(ours.goals[0], theirs.goals[0, :10])
    assert 1 <= traced == compiled_once <= 2


def test_same_key_same_run_whatever_the_batch():
    prepare, run = NEGOTIATED
    world = prepare(jnp.asarray(random_layout(np.random.default_rng(5), 0.25)))
    keys = jax.random.split(jax.random.key(1), 3)
    batch = jax.jit(jax.vmap(lambda key: run(world, key, jnp.int32(40))))(keys)
    alone = [run(world, key, jnp.int32(40)) for key in keys]
    for index, single in enumerate(alone):
        jax.tree.map(
            lambda one, many, index=index: np.testing.assert_allclose(one, many[index], atol=1e-6),
            single,
            batch,
        )
    assert not (batch[1].positions[0] == batch[1].positions[1]).all(), "seeds share no starts"


def test_a_layout_without_room_or_goals_scores_nothing():
    config = fleet.FleetConfig(agents=20, timesteps=20, planner=StandConfig())
    prepare, run = programs(PLAIN, config)
    for tile, reason in (("#", "free cells"), (".", "no 'e'")):
        layout = np.full(SHAPE, TILES.index(tile), np.int8)
        traffic, _ = run(prepare(jnp.asarray(layout)), jax.random.key(0), None)
        assert traffic.congested
        assert traffic.end_timestep == 0
        assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(traffic))
        with pytest.raises(InputError, match=reason):
            check_playable(layout, PLAIN, 20)


def test_goals_are_drawn_with_their_odds():
    layout = parse(["ee#", "w.#", "eew"], ".#ew")
    rule = TaskRule(TILES, ".ew", (beside_goal("e", "#", 0, TILES), tile_goal("w", TILES)))
    table = goal_table(jnp.asarray(layout), rule, 9)
    assert np.asarray(table.cells)[np.asarray(table.used)].tolist() == [1, 3, 8]
    kinds = jnp.arange(20000) % 2
    drawn = np.asarray(table.cells[draw_goals(table, kinds, jnp.uint32(0))])
    assert set(drawn[::2]) == {1}
    assert abs((drawn[1::2] == 3).mean() - 0.5) < 0.02
