"""Costs of moves: the same runs on host and XLA, distances by scipy, published throughputs."""

import itertools
import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import STUDY_DATA
from fleet_runs import AGENTS, PLAIN, SERVICES, StandConfig
from robustness.fleets import SHAPE, random_costs, random_layout
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from qdenv.grid import LEFT, NUM_MOVES, WAIT, move_steps, of_tiles, parse
from qdenv.guidance import crisscross, existing_moves, fixed_costs
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.audit import audit
from qdenv.simulation.mapf.distances import goal_costs
from qdenv.simulation.mapf.goals import tile_goal
from qdenv.simulation.mapf.host.distances import distance, empty_fields
from qdenv.simulation.mapf.host.state import grid_map
from qdenv.simulation.mapf.negotiated.settings import HIGH, LOW
from qdenv.simulation.mapf.planner import UNREACHABLE_COST
from qdenv.simulation.mapf.settings import FleetConfig, PbsConfig, PibtConfig
from qdenv.study.engine import _program
from qdenv.study.plans import Plan, read_plan
from qdenv.types import InputError, TaskRule, Traffic

pytestmark = pytest.mark.slow
TILES = ".e@w"
BACKENDS = [PibtConfig(), LOW]  # planners that have two
IN_XLA = replace(LOW, lookahead=6, rounds=2.0, backend="xla")


def simulate(
    layout: np.ndarray,
    costs: np.ndarray | None,
    config: FleetConfig,
    seeds: int = 3,
    rule: TaskRule = PLAIN,
) -> tuple[list[Traffic], list[np.ndarray]]:
    """Run and audit each seed; return what moved, and where the agents were."""
    prepare, run, _ = _program(rule, config, layout.shape, True, costs is not None)
    free = np.asarray(of_tiles(layout, rule.traversable, rule.tiles))
    fixed = () if costs is None else (fixed_costs(costs, free),)
    world = prepare(layout, *fixed)
    done = [run(world, seed, config.agents) for seed in range(seeds)]
    runs, recordings = zip(*jax.tree.map(np.asarray, done), strict=True)
    for traffic, recording in zip(runs, recordings, strict=True):
        assert audit(layout, rule, recording, traffic, config.horizon) == []
    return list(runs), [recording.positions for recording in recordings]


@pytest.mark.parametrize(
    ("planner", "rule"),
    [
        (PibtConfig("host"), PLAIN),
        (PbsConfig("plain", 1), SERVICES),
        (HIGH, PLAIN),
        (IN_XLA, SERVICES),
    ],
)
def test_costs_of_one_change_nothing(planner, rule):
    timesteps = 15 if planner is IN_XLA else 60
    config = FleetConfig(40, timesteps, planner=planner, stop_when_congested=False)
    for seed in range(3):
        layout = random_layout(np.random.default_rng(seed), 0.15)
        with_ones = simulate(layout, np.ones((NUM_MOVES, *SHAPE)), config, rule=rule)
        without = simulate(layout, None, config, rule=rule)
        jax.tree.map(np.testing.assert_array_equal, with_ones, without)


def against_lanes(positions: np.ndarray, costs: np.ndarray) -> int:
    """Count the moves of agents (cells [T + 1, A]) that are not allowed."""
    begin, step = positions[:-1], np.diff(positions, axis=0)
    return sum(
        np.isinf(costs[move].reshape(-1)[begin[step == size]]).sum()
        for move, size in enumerate(move_steps(costs.shape[2]))
    )


@pytest.mark.parametrize("one_way", [0.0, 0.3])
@pytest.mark.parametrize("planner", BACKENDS)
def test_the_host_drives_by_costs_as_xla_does(planner, one_way):
    for seed, rule in enumerate((PLAIN, SERVICES)):
        rng = np.random.default_rng(seed)
        layout = random_layout(rng, 0.15)
        costs = random_costs(rng, layout != 1, one_way)
        host, xla = (
            simulate(layout, costs, FleetConfig(AGENTS, 25, planner=settings), 1, rule)
            for settings in (replace(planner, backend=name) for name in ("host", "xla"))
        )
        jax.tree.map(np.testing.assert_array_equal, host, xla)
        assert [against_lanes(positions, costs) for positions in host[1]] == [0]


@pytest.mark.parametrize("rule", [PLAIN, SERVICES])
@pytest.mark.parametrize("planner", [PbsConfig(), PbsConfig("plain", 1), LOW])
def test_crowds_keep_to_one_way_lanes(planner, rule):
    """Under a planner by windows, also in those that stay unsolved."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        layout = random_layout(rng, 0.1)
        costs = random_costs(rng, layout != 1, 0.3)
        config = FleetConfig(AGENTS, 60, planner=planner, stop_when_congested=False)
        _, recorded = simulate(layout, costs, config, rule=rule)
        assert [against_lanes(positions, costs) for positions in recorded] == [0] * 3


@pytest.mark.parametrize(
    ("planner", "window"),
    # A negotiated window has to be spent: with both goals in it, there is time for longer ways.
    [(PbsConfig(), 1), (PbsConfig(), 4), (PbsConfig(), 10), (HIGH, 1), (HIGH, 4)],
)
def test_one_agent_takes_the_cheapest_way(planner, window):
    """From goal to goal, as scipy finds it, whatever the window."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        layout = random_layout(rng, 0.2)
        costs = random_costs(rng, layout != 1, 0.2)
        config = FleetConfig(1, 200, window, min(window, 5), planner, False)
        (run,), (positions,) = simulate(layout, costs, config, 1)
        price, sizes = fixed_costs(costs, layout != 1).reshape(NUM_MOVES, -1), move_steps(SHAPE[1])
        move, begin = np.nonzero(price[1:])
        edges = price[1 + move, begin], (begin, begin + sizes[1 + move])
        far = dijkstra(coo_array(edges, (layout.size,) * 2).tocsr())
        path, reached = positions[:, 0], [0, *(1 + np.flatnonzero(run.finished))]
        for first, last in itertools.pairwise(reached):
            way = path[first : last + 1]
            way = way[np.argmax(way != way[0]) - 1 :]  # no goal is known after two in one window
            moves = [sizes.tolist().index(step) for step in np.diff(way)]
            assert WAIT not in moves
            assert price[moves, way[:-1]].sum() == far[way[0], way[-1]]
        assert len(reached) > 5


def test_distances_are_the_cheapest_sums():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        layout = random_layout(rng, 0.2)
        fixed = fixed_costs(random_costs(rng, layout != 1, 0.2), layout != 1)
        config = FleetConfig(4, planner=PibtConfig("host"))
        world = jax.tree.map(np.asarray, fleet.prepare(layout, PLAIN, config, fixed))
        grid, width = grid_map(world), world.traversable.shape[1]
        move, begin = np.nonzero(world.costs[1:] * world.traversable.reshape(-1))
        edges = world.costs[1 + move, begin], (begin, begin + move_steps(width)[1 + move])
        keep = grid.free[edges[1][1]]
        graph = coo_array((edges[0][keep], (begin[keep], edges[1][1][keep])), (grid.free.size,) * 2)
        far = dijkstra(graph.T.tocsr(), indices=grid.goals)
        expected = np.where(np.isinf(far), UNREACHABLE_COST, far).astype(int)
        used = jnp.asarray(world.goals.used)
        in_xla = goal_costs(jnp.asarray(world.traversable), world.costs, grid.goals, used)
        count = int(world.goals.used.sum())
        np.testing.assert_array_equal(in_xla[:count], expected[:count])
        fields = empty_fields(world.traversable.shape, len(grid.goals), count, has_costs=True)
        for cell in np.flatnonzero(grid.free):
            for goal in range(count):
                assert distance(fields, grid, goal, cell) == expected[goal, cell]


def test_impossible_costs_are_refused():
    free = np.ones((3, 4), bool)
    ones = np.ones((NUM_MOVES, 3, 4))
    for costs, message in (
        (ones[:4], r"have the shape \(5, 3, 4\), not \(4, 3, 4\)"),
        (-ones, "above zero"),
        (np.full_like(ones, np.nan), "above zero"),
        (np.where(np.arange(5)[:, None, None] == WAIT, np.inf, ones), "finite for waiting"),
        (np.where(np.arange(5)[:, None, None] == LEFT, np.inf, ones), "one-way lanes cut off"),
    ):
        with pytest.raises(InputError, match=message):
            fixed_costs(costs, free)
    with pytest.raises(InputError, match="knows no costs of moves: choose negotiated, pibt"):
        layout = random_layout(np.random.default_rng(0), 0.1)
        simulate(layout, np.ones((NUM_MOVES, *SHAPE)), FleetConfig(4, planner=StandConfig()))


def test_agents_swap_in_a_dead_end():
    """One robot stands at the end of a blind aisle, another one wants to get there."""
    layout = parse(["@@@@@.@", "w.....e", "@@@@@.@"], TILES)
    rule = TaskRule(TILES, ".ew", (tile_goal("w", TILES), tile_goal("e", TILES)))
    finished = []
    for swap in (False, True):
        config = FleetConfig(3, 400, 1, 1, PibtConfig(swap=swap), stop_when_congested=False)
        runs, _ = simulate(layout, None, config, 8, rule)
        finished.append([int(run.finished[200:].sum()) for run in runs])
    assert min(finished[1]) > 20
    assert min(finished[0]) == 0


def published_plan(name: str) -> Plan:
    """Read a published map with its guidance graph; skip where nobody has a copy."""
    path = STUDY_DATA / "guidance" / f"{name}.json"
    if not path.exists():
        pytest.skip("no published guidance graphs here (QDENV_STUDY_DATA names their folder)")
    return read_plan(path)


@pytest.mark.parametrize(
    ("name", "agents", "swap", "published"),
    [
        ("pibt_warehouse-33x36_w_mode_cma-es_400_agents_four-way-move", 400, False, 7.64),
        ("pibt_empty-48-48_cma-es_1000_agents_four-way-move", 1000, False, 24.04),
        ("pibt_random_cma-es_32x32_400_agents_four-way-move", 400, True, 7.78),
    ],
)
def test_published_graphs_move_what_was_published(name, agents, swap, published):
    """Table 3 of Zhang et al. 2024, within 1.5 % and twice the error of six seeds."""
    plan = published_plan(name)
    kinds, tiles = "we" if "w" in name.split("_")[1] else ".", plan.domain.tiles
    rule = TaskRule(tiles, ".ew", tuple(tile_goal(kind, tiles) for kind in kinds))
    config = FleetConfig(agents, 1000, 1, 1, PibtConfig(swap=swap), stop_when_congested=False)
    runs, _ = simulate(plan.layout, plan.costs, config, 6, rule)
    moved = np.array([float(run.throughput) for run in runs])
    error = moved.std(ddof=1) / math.sqrt(len(moved))
    assert abs(moved.mean() - published) < 0.015 * published + 2 * error


def test_published_graph_keeps_pbs_flowing():
    """Setup 8 there: 6.58 with all runs free of jams, where without costs all jam."""
    plan = published_plan("kiva_33x36_human_cma-es_opt_220_agents")
    layout, rule = plan.layout, plan.domain.simulator.tasks
    config = FleetConfig(220, 1000, planner=PbsConfig())
    guided, _ = simulate(layout, plan.costs, config, 3, rule)
    moved = np.array([float(run.throughput) for run in guided])
    error = moved.std(ddof=1) / math.sqrt(len(moved))
    assert not any(run.congested for run in guided)
    assert abs(moved.mean() - 6.58) < 0.015 * 6.58 + 2 * error
    unguided, _ = simulate(layout, None, config, 1, rule)
    assert all(run.congested for run in unguided)


def test_crisscross_is_the_published_one():
    plan = published_plan("pibt_warehouse_33x36_w_mode_alternate_baseline_bi-directed")
    moves = existing_moves(plan.layout != 1)
    np.testing.assert_array_equal(plan.costs[moves], crisscross(plan.layout)[moves])


def test_nothing_locks_on_random_maps_with_two_fifths_of_the_cells_taken():
    """Without swaps every one of these runs is locked before its second half begins."""
    rule = TaskRule(TILES, ".", (tile_goal(".", TILES),))
    for seed in range(3):
        taken = np.random.default_rng(seed).random((32, 32)) < 0.4
        parts, _ = label(~taken)
        layout = (parts != np.bincount(parts[parts > 0]).argmax()).astype(np.int8) * 2
        halves = []
        for swap in (False, True):
            config = FleetConfig(40, 1000, planner=PibtConfig(swap=swap), stop_when_congested=False)
            (run,), _ = simulate(layout, None, config, 1, rule)
            halves.append((run.finished[:500].sum(), run.finished[500:].sum()))
        assert halves[0][1] == 0
        assert halves[1][1] > 0.8 * halves[1][0] > 100
