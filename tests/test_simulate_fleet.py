"""Whole simulations: no rule is ever broken, whatever the layout, the fleet and the planner."""

from dataclasses import replace
from pathlib import Path

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.grid import parse
from qdenv.simulate.mapf import fleet
from qdenv.simulate.mapf.audit import audit, trajectory_of
from qdenv.simulate.mapf.negotiated.numba import rounds as bargain_on_host
from qdenv.simulate.mapf.negotiated.planner import LOW, WindowedPlanner
from qdenv.simulate.mapf.negotiated.xla import rounds as bargain_in_xla
from qdenv.simulate.mapf.pibt import numba as pibt_on_host
from qdenv.simulate.mapf.pibt import planner as pibt
from qdenv.simulate.mapf.tasks import beside_goal, check_playable, draw_goals, goal_table, tile_goal
from qdenv.types import InputError, TaskRule, Traffic

TILES = ".#ew"
PLAIN = TaskRule(TILES, ".ew", (tile_goal("e", TILES), tile_goal("w", TILES)))
# Kinds without a stay, with a short one and with one longer than a window in one cycle.
STAYS = TaskRule(
    TILES,
    ".ew",
    tuple(tile_goal("ewew"[kind], TILES, stay) for kind, stay in enumerate((0, 2, 11, 0))),
)
SHAPE = (12, 13)
AGENTS, TIMESTEPS = 64, 203  # T is no multiple of the horizon on purpose
CONFIG = fleet.FleetConfig(agents=AGENTS, timesteps=TIMESTEPS, stop_when_congested=False)
AGENT_STEPS = 1_000_000


def programs(rule: TaskRule, config: fleet.FleetConfig):
    prepare = jax.jit(lambda layout: fleet.prepare(layout, rule, config))
    run = jax.jit(lambda world, key, agents: fleet.record(world, key, rule, config, agents))
    return prepare, run


WINDOWED = programs(STAYS, CONFIG)


def random_layout(rng: np.random.Generator, walls: float) -> np.ndarray:
    """Draw a connected layout with both kinds of goal (int8 [12, 13])."""
    while True:
        layout = rng.choice(4, SHAPE, p=[0.8 - walls, walls, 0.12, 0.08]).astype(np.int8)
        try:
            check_playable(layout, PLAIN, 1)
        except InputError:
            continue
        return layout


def run_audited(programs, rule, config, layout, seed, agents) -> tuple[Traffic, int]:
    prepare, run = programs
    key, count = jax.random.key(seed), jnp.int32(agents)
    traffic, tape = jax.tree.map(np.asarray, run(prepare(jnp.asarray(layout)), key, count))
    assert audit(layout, rule, trajectory_of(tape), traffic, config.horizon) == []
    return traffic, int(traffic.end_timestep) * agents


def test_a_million_agent_steps_break_no_rule():
    steps = passes = 0

    @hypothesis.settings(max_examples=60, deadline=None, derandomize=True)
    @hypothesis.given(st.integers(0, 2**31 - 1), st.floats(0.0, 0.35), st.floats(0.2, 0.8))
    def check(seed: int, walls: float, crowd: float):
        nonlocal steps
        seed += passes  # hypothesis draws the same numbers in every pass
        layout = random_layout(np.random.default_rng(seed), walls)
        agents = max(1, int(crowd * min(AGENTS, 0.6 * (layout != 1).sum())))
        steps += run_audited(WINDOWED, STAYS, CONFIG, layout, seed, agents)[1]

    while steps < AGENT_STEPS:
        check()
        passes += 1
    assert steps >= AGENT_STEPS


@pytest.mark.parametrize(
    "planner",
    [pibt.rollout, WindowedPlanner(last_resort=pibt.wait, rounds=1.0)],
    ids=["pibt", "waiting as last resort"],
)
def test_other_planners_break_no_rule(planner):
    # Few agents and no early end: the last resort that waits would jam a crowd at once.
    config = fleet.FleetConfig(agents=12, timesteps=60, planner=planner, stop_when_congested=False)
    compiled = programs(STAYS, config)
    finished = 0
    for seed in range(12):
        layout = random_layout(np.random.default_rng(seed), 0.2)
        traffic, _ = run_audited(compiled, STAYS, config, layout, seed, 12)
        finished += int(traffic.finished.sum())
    assert finished > 12 * 12  # a plan that obeys by standing still would pass the audit alone


@pytest.mark.parametrize(
    ("rule", "settings"),
    [
        (STAYS, {}),
        (STAYS, {"layers": 1, "remember": False, "lanes": 5, "penalties": (0.5, 3.0)}),
        (PLAIN, {"layers": 4, "lookahead": 7, "rounds": 2.0}),
    ],
    ids=["stays", "one layer, no memory", "no stays, seven steps ahead"],
)
def test_the_host_bargains_as_xla_does(rule, settings):
    outcomes = []
    for bargain in (bargain_on_host.bargain, bargain_in_xla.bargain):
        planner = WindowedPlanner(bargain=bargain, **settings)
        config = fleet.FleetConfig(
            agents=AGENTS, timesteps=100, planner=planner, stop_when_congested=False
        )
        prepare, run = programs(rule, config)
        outcomes.append([])
        for seed in range(8):
            layout = random_layout(np.random.default_rng(seed), 0.3 * (seed % 2))
            agents = int((0.3 + 0.05 * seed) * min(AGENTS, (layout != 1).sum()))
            key, count = jax.random.key(seed), jnp.int32(agents)
            result = run(prepare(jnp.asarray(layout)), key, count)
            outcomes[-1].append(jax.tree.map(np.asarray, result))
            assert result[0].finished.sum() > 0
    jax.tree.map(np.testing.assert_array_equal, *outcomes)


def test_the_host_pushes_as_xla_does():
    size, count = SHAPE[0] * SHAPE[1], 70

    @jax.jit
    def both(*state):
        return [step(*state, size) for step in (pibt.one_step, pibt_on_host.one_step)]

    moved = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        position = rng.permutation(size)[:count].astype(np.int32)
        row, column = position // SHAPE[1], position % SHAPE[1]
        ways = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)]
        near = np.stack(
            [
                np.clip(row + down, 0, SHAPE[0] - 1) * SHAPE[1]
                + np.clip(column + right, 0, SHAPE[1] - 1)
                for down, right in ways
            ],
            axis=1,
        )
        candidates = rng.permuted(near, axis=1).astype(np.int32)
        allowed = rng.integers(1, 6, count).astype(np.int32)
        order = rng.permutation(count).astype(np.int32)
        xla, host = both(candidates, position, allowed, order)
        np.testing.assert_array_equal(xla, host)
        assert len(set(host.tolist())) == count
        moved += int((np.asarray(host) != position).sum())
    assert moved > 200 * count / 4


def stand(world, state, horizon, key):
    """A user's own planner: nobody ever moves."""
    del world, horizon, key
    return jnp.broadcast_to(state.position, state.previous.shape)


def test_a_planner_plugs_in_from_outside_and_a_jam_ends_the_run():
    config = fleet.FleetConfig(agents=20, timesteps=100, planner=stand)
    layout = random_layout(np.random.default_rng(0), 0.2)
    traffic, _ = run_audited(programs(PLAIN, config), PLAIN, config, layout, 0, 20)
    assert traffic.congested
    assert traffic.end_timestep == config.horizon
    assert traffic.waiting == 1.0


# Every second goal is one of four workstations, and every second free cell holds an agent.
HALL = parse(
    [
        "....eeeeeee.eeeeeee.eeee",
        "....#######.#######.####",
        "....eeeeeee.eeeeeee.eeee",
        "....eeeeeee.eeeeeee.eeee",
        "....#######.#######.####",
        "w...eeeeeee.eeeeeee.eeee",
        "w...eeeeeee.eeeeeee.eeee",
        "w...#######.#######.####",
        "w...eeeeeee.eeeeeee.eeee",
        "....eeeeeee.eeeeeee.eeee",
        "....#######.#######.####",
        "....eeeeeee.eeeeeee.eeee",
    ],
    TILES,
)


@pytest.mark.parametrize("resort", [pibt.rollout, pibt.wait], ids=["rollout", "waiting"])
def test_the_last_resort_decides_whether_a_hot_spot_congests(resort):
    agents = int((HALL != 1).sum()) // 2
    config = fleet.FleetConfig(
        agents=agents, timesteps=300, planner=WindowedPlanner(last_resort=resort)
    )
    compiled = programs(PLAIN, config)
    runs = [
        run_audited(compiled, PLAIN, config, HALL.astype(np.int8), seed, agents)[0]
        for seed in range(3)
    ]
    if resort is pibt.rollout:
        assert not any(run.congested for run in runs)
        assert min(float(run.throughput) for run in runs) > 2.0
    else:
        assert all(run.congested for run in runs)


def test_one_agent_drives_shortest_ways():
    """Alone, every leg takes its distance and its stay: the times of tasks have a closed form."""
    layout = np.full(SHAPE, TILES.index("#"), np.int8)
    layout[4] = parse(["#e........w##"], TILES)[0]
    prepare, run = WINDOWED
    for seed in range(3):
        traffic, tape = run(prepare(jnp.asarray(layout)), jax.random.key(seed), jnp.int32(1))
        first = int(tape.positions[0, 0]) % SHAPE[1] - 1 or 1  # being there takes one step, too
        legs = [first] + [9 + 2, 9 + 11, 9, 9] * 10  # to w and 2 there, to e and 11, to w, to e
        times = np.cumsum(legs)
        found = np.flatnonzero(traffic.finished) + 1
        np.testing.assert_array_equal(found, times[times <= TIMESTEPS])


def test_padding_agents_change_nothing_and_nothing_is_traced_twice():
    traced = 0

    def counted(world, state, horizon, key):
        nonlocal traced
        traced += 1
        return pibt.rollout(world, state, horizon, key)

    layouts = [random_layout(np.random.default_rng(seed), 0.2) for seed in range(2)]
    wide = fleet.FleetConfig(agents=30, timesteps=40, planner=counted)
    prepare, run = programs(PLAIN, wide)
    for layout in layouts:
        world = prepare(jnp.asarray(layout))
        for agents in (10, 20, 30):
            traffic, tape = run(world, jax.random.key(agents), jnp.int32(agents))
            assert np.isclose(traffic.usage.sum(), 1)
            assert int(tape.active.sum()) == agents
    compiled_once = traced
    exact = fleet.FleetConfig(agents=10, timesteps=40, planner=pibt.rollout)
    ours = programs(PLAIN, exact)[1](world, jax.random.key(10), jnp.int32(10))[1]
    theirs = run(world, jax.random.key(10), jnp.int32(10))[1]
    np.testing.assert_array_equal(ours.positions[0], theirs.positions[0, :10])
    np.testing.assert_array_equal(ours.goals[0], theirs.goals[0, :10])
    assert traced == compiled_once <= 2


def test_same_key_same_run_whatever_the_batch():
    prepare, run = WINDOWED
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
    config = fleet.FleetConfig(agents=20, timesteps=20, planner=stand)
    prepare, run = programs(PLAIN, config)
    for tile, reason in (("#", "free cells"), (".", "no 'e'")):
        layout = np.full(SHAPE, TILES.index(tile), np.int8)
        traffic, _ = run(prepare(jnp.asarray(layout)), jax.random.key(0), None)
        assert traffic.congested
        assert traffic.end_timestep == 0
        assert all(np.isfinite(np.asarray(leaf)).all() for leaf in traffic)
        with pytest.raises(InputError, match=reason):
            check_playable(layout, PLAIN, 20)


def test_goals_are_drawn_with_their_odds():
    layout = parse(["ee#", "w.#", "eew"], ".#ew")
    rule = TaskRule(TILES, ".ew", (beside_goal("e", "#", 0, TILES), tile_goal("w", TILES)))
    table = goal_table(jnp.asarray(layout), rule, 9)
    assert np.asarray(table.cells)[np.asarray(table.used)].tolist() == [1, 3, 8]
    kinds = jnp.arange(20000) % 2
    drawn = np.asarray(table.cells[draw_goals(table, kinds, jax.random.key(0))])
    assert set(drawn[::2]) == {1}
    assert abs((drawn[1::2] == 3).mean() - 0.5) < 0.02


def test_published_layouts_reach_their_throughput():
    """Low effort on the published even layout: at least 6.2, never congested (T shortened)."""
    file = Path(__file__).parents[2] / "shared/reference/layouts/warehouse_even_nca_a5.json"
    if not file.exists():
        pytest.skip("the published layouts are not at hand")
    from qdenv.domains.warehouse import WAREHOUSE_EVEN
    from qdenv.formats.layouts import read_layout
    from qdenv.study.traffic import simulate_layout

    layout = read_layout(file, WAREHOUSE_EVEN.tiles)
    result = simulate_layout(layout, "warehouse-even", 200, 400, (2,), "low", True)
    assert result["valid"]
    assert result["success_rate"] == 1
    assert result["mean_throughput"] >= 6.2


def test_waiting_as_the_last_resort_congests_where_the_published_planner_does():
    """At 200 agents PBS congests on the hand-made warehouse and on no other of its domain."""
    folder = Path(__file__).parents[2] / "shared/reference/layouts"
    if not folder.exists():
        pytest.skip("the published layouts are not at hand")
    from qdenv.domains.warehouse import WAREHOUSE_EVEN
    from qdenv.formats.layouts import read_layout
    from qdenv.study.traffic import run_seeds

    planner = replace(LOW, last_resort=pibt.wait)
    config = fleet.FleetConfig(agents=200, timesteps=600, planner=planner)
    for name, congests in (("human", True), ("even_dsage", False), ("even_nca_a5", False)):
        layout = read_layout(folder / f"warehouse_{name}.json", WAREHOUSE_EVEN.tiles)
        runs = run_seeds(layout, WAREHOUSE_EVEN.tasks, config, range(3)).runs
        assert [bool(run.congested) for run in runs] == [congests] * 3
