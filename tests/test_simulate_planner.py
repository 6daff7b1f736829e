"""The negotiated planner: one agent against a slow oracle, reservations, joint plans."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export
from mapf_oracle import (
    FREE,
    HEIGHT,
    MOVES,
    WIDTH,
    WINDOW,
    Case,
    cheapest,
    cost_of,
    numpy_distances,
    random_case,
    random_walks,
)

from qdenv.grid import parse
from qdenv.simulation.mapf.distances import goal_distances
from qdenv.simulation.mapf.host.distances import empty_fields
from qdenv.simulation.mapf.host.state import GridMap, grid_map
from qdenv.simulation.mapf.negotiated.numba import search as host_search
from qdenv.simulation.mapf.negotiated.numba.search import Agent, find_path
from qdenv.simulation.mapf.negotiated.numba.states import make_arrays
from qdenv.simulation.mapf.negotiated.settings import MARGIN, NegotiatedConfig
from qdenv.simulation.mapf.negotiated.xla.rounds import add_paths, choose, pack
from qdenv.simulation.mapf.negotiated.xla.search import find_paths
from qdenv.simulation.mapf.negotiated.xla.window import STRIDE, around, gather
from qdenv.simulation.mapf.planner import UNREACHABLE, AgentState, GoalTable, World
from qdenv.simulation.mapf.settings import PLANNERS
from qdenv.types import InputError

pytestmark = pytest.mark.slow

SHAPE = (HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN)
PADDED = np.pad(FREE, MARGIN)
NO_RESERVATIONS = jnp.zeros(WINDOW * 5 * SHAPE[0] * -(-SHAPE[1] // STRIDE), jnp.uint32)


@pytest.fixture(autouse=True)
def broadcasting():
    """Let XLA's half broadcast its sets of cells over agents, as the planner itself does."""
    with jax.numpy_rank_promotion("allow"):
        yield


def padded(cells):
    """Translate cells of the maze into positions of the padded grid."""
    cells = np.asarray(cells)
    return ((cells // WIDTH + MARGIN) * SHAPE[1] + cells % WIDTH + MARGIN).astype(np.int32)


def unpadded(positions: np.ndarray) -> np.ndarray:
    """Translate positions of the padded grid into cells of the maze."""
    return (positions // SHAPE[1] - MARGIN) * WIDTH + positions % SHAPE[1] - MARGIN


def world_of(goals, case: Case | None = None) -> World:
    """Build the world of the maze with these goal cells, by the slow distances."""
    distance, costs = np.stack([numpy_distances(FREE, goal) for goal in goals]), None
    if case is not None and case.costs is not None:
        distance = np.stack(case.to_go()).astype(np.int32)
        costs = np.zeros((5, *SHAPE), np.int32)
        inside = slice(MARGIN, -MARGIN)
        costs[:, inside, inside] = case.costs.reshape(5, HEIGHT, WIDTH)
        costs = jnp.asarray(costs.reshape(5, -1))
    else:
        distance = distance.astype(np.int16)
    margins = ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN))
    far = np.pad(distance.reshape(-1, HEIGHT, WIDTH), margins, constant_values=UNREACHABLE)
    count = len(goals)
    cells, used = jnp.asarray(padded(goals)), jnp.ones(count, bool)
    nothing = jnp.zeros((1, count), jnp.int32)
    table = GoalTable(cells, used, jnp.ones((1, count)), nothing, jnp.bool_(True))
    return World(
        traversable=jnp.asarray(PADDED),
        goals=table,
        distance=jnp.asarray(far.reshape(count, -1)),
        valid=jnp.bool_(True),
        margin=MARGIN,
        costs=costs,
    )


def state_of(case: Case, distance: jax.Array) -> AgentState:
    """Describe the one agent of a case, and the distances to its goals."""
    position = jnp.asarray(padded([case.start]))
    return AgentState(
        position=position,
        active=jnp.ones(1, bool),
        goal=jnp.array([[0], [1]]),
        service_time=jnp.array(case.services)[:, None],
        remaining_service=jnp.array([case.serving]),
        age=jnp.zeros(1, jnp.int32),
        previous=jnp.broadcast_to(position, (WINDOW + 1, 1)),
        distance=distance,
        row=jnp.array([[0], [1]]),
    )


@partial(jax.jit, static_argnums=5)
def search_in_xla(world, state, others, penalty, tie_break, levels):
    mask = jnp.ones(others.shape[1], bool)
    table = add_paths(NO_RESERVATIONS, others, mask, SHAPE)
    walls = pack(world.traversable)
    local = gather(world, state, table, walls, jnp.array([0]), penalty[None], tie_break[None])
    steps, cost = find_paths(local, levels)
    return state.position[0] + steps[0, :, 0] * SHAPE[1] + steps[1, :, 0], cost[0]


def grid_of_maze(world: World) -> GridMap:
    """Show the maze to host code."""
    return grid_map(jax.tree.map(np.asarray, world))


def reserve_others(others: np.ndarray, place: GridMap) -> host_search.ReservationWords:
    """Reserve paths of the padded grid (int [WINDOW + 1, n]) with one agent more that has none."""
    count = others.shape[1]
    table = host_search.ReservationWords(
        np.where(place.free, 0, host_search.WALL),
        np.empty((place.free.size, WINDOW + 1), np.int32),
        np.zeros((count + 1, WINDOW + 1), np.int64),
        np.zeros(count + 1, np.int64),
    )
    table.path[:count] = others.T
    for agent in range(count):
        host_search.reserve(table, agent, WINDOW, place.width)
    return table


def search_on_host(world: World, case: Case, tie_break: int) -> np.ndarray:
    place, others = grid_of_maze(world), padded(case.others)
    table = reserve_others(others, place)
    start, cells = int(padded(case.start)), padded(case.goals)
    agent = Agent(
        others.shape[1],
        start,
        (0, 1),
        (int(cells[0]), int(cells[1])),
        case.services,
        case.serving,
        case.penalty,
        tie_break,
    )
    has_costs = case.costs is not None
    work = make_arrays(WINDOW, case.levels, np.array([case.penalty]), has_costs)
    fields = empty_fields(SHAPE, 2, 2, has_costs=has_costs)
    assert find_path(work, table, fields, place, agent)
    return table.path[-1]


@pytest.mark.parametrize("has_costs", [False, True])
@pytest.mark.parametrize("services", [(0, 0), (2, 3), (0, 2), (3, 0)])
def test_one_agent_agrees_with_uniform_cost_search_in_both_backends(
    services: tuple[int, int], has_costs: bool
):
    rng = np.random.default_rng(sum(services))
    for number in range(25):
        case, tie_break = random_case(rng, number, services, has_costs), number * 977
        world, best = world_of(case.goals, case), cheapest(case)
        others, numbers = jnp.asarray(padded(case.others)), (case.penalty, tie_break)
        xla, cost = search_in_xla(
            world, state_of(case, world.distance), others, *map(jnp.int32, numbers), case.levels
        )
        host = search_on_host(world, case, tie_break)
        assert int(cost) == best
        assert cost_of(case, unpadded(np.asarray(xla))) == best
        assert cost_of(case, unpadded(host)) == best
        np.testing.assert_array_equal(xla, host)


def test_in_xla_a_long_way_beyond_the_goal_costs_more_and_changes_no_path():
    rng, far = np.random.default_rng(8), 900_000
    for number in range(6):
        case, tie_break = random_case(rng, number, (2, 0)), number * 977
        world, others = world_of(case.goals), jnp.asarray(padded(case.others))
        numbers = jnp.int32(case.penalty), jnp.int32(tie_break)
        later = world.distance.astype(jnp.int32).at[1].add(far)
        near, shift = (
            search_in_xla(world, state_of(case, distance), others, *numbers, case.levels)
            for distance in (world.distance, later)
        )
        np.testing.assert_array_equal(shift[0], near[0])
        assert int(shift[1]) == int(near[1]) + 4 * far


def test_reservations_are_seen_where_they_are_and_vanish_when_removed():
    others = random_walks(np.random.default_rng(3), 10)
    paths, mask = jnp.asarray(padded(others)), jnp.ones(10, bool)
    table = add_paths(NO_RESERVATIONS, paths, mask, SHAPE)
    planes = table.reshape(WINDOW, 5, SHAPE[0], -1)
    place = grid_of_maze(world_of([0]))
    host = reserve_others(padded(others), place)
    for cell in np.flatnonzero(FREE):
        position = padded(cell)
        seen = around(planes, jnp.asarray(position)[None], SHAPE[1], WINDOW)
        centre = (np.asarray(seen)[:, :, WINDOW, 0] >> WINDOW) & 1
        bits = np.arange(WINDOW)[:, None] + host_search.PLANE * np.arange(5)
        on_host = (host.word[int(position)] >> bits) & 1
        leaving = [
            (others[:-1] == cell) & (others[1:] == cell + down * WIDTH + right)
            for down, right in MOVES[1:]
        ]
        expected = np.stack([(others[1:] == cell).any(1), *(left.any(1) for left in leaving)], 1)
        np.testing.assert_array_equal(centre, expected)
        np.testing.assert_array_equal(on_host, expected)
    assert not add_paths(table, paths, mask, SHAPE, sign=-1).any()
    for agent in range(10):
        host_search.reserve(host, agent, 0, place.width)
    np.testing.assert_array_equal(host.word, np.where(place.free, 0, host_search.WALL))


def test_distances_agree_with_plain_search():
    free = jnp.asarray(FREE).at[3, 3].set(False)
    cells = np.flatnonzero(np.asarray(free))[:40]
    slots = jnp.zeros(64, jnp.int32).at[:40].set(cells)
    distance = np.asarray(jax.jit(goal_distances)(free, slots, jnp.arange(64) < 40))
    for slot, cell in enumerate(cells):
        np.testing.assert_array_equal(distance[slot], numpy_distances(np.asarray(free), cell))
    assert (distance[40:] == UNREACHABLE).all()


def test_long_ways_are_counted_in_full():
    snake = ["." * 9 if row % 2 == 0 else "#" * 8 + "." for row in range(9)]
    snake = [row if index % 4 != 3 else row[::-1] for index, row in enumerate(snake)]
    free = parse(snake, ".#") == 0
    measured = goal_distances(jnp.asarray(free), jnp.array([0]), jnp.array([True]))
    expected = numpy_distances(free, 0)
    assert expected[free.reshape(-1)].max() == 48
    np.testing.assert_array_equal(np.asarray(measured)[0], expected)


def test_chosen_candidates_never_conflict():
    rng = np.random.default_rng(0)
    for _ in range(20):
        conflicts = rng.random((12, 12)) < 0.2
        conflicts |= conflicts.T
        candidates = rng.random(12) < 0.8
        chosen = np.asarray(choose(jnp.asarray(conflicts), jnp.asarray(candidates)))
        assert not (chosen & ~candidates).any()
        assert not (conflicts & ~np.eye(12, dtype=bool))[np.ix_(chosen, chosen)].any()
        assert chosen.any() or not candidates.any()


@pytest.mark.parametrize("last_resort", ["pibt", "wait"])
def test_the_xla_backend_can_be_exported_on_a_cpu(last_resort: str):
    planner = PLANNERS.make(NegotiatedConfig(backend="xla", last_resort=last_resort))
    case = random_case(np.random.default_rng(0), 1, (2, 3))
    plan = jax.jit(lambda world, state, key: planner.plan(world, state, 3, key))
    world = world_of(case.goals)
    exported = export.export(plan)(world, state_of(case, world.distance), jax.random.key(0))
    assert "callback" not in exported.mlir_module()
    assert exported.out_avals[0].shape == (WINDOW + 1, 1)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"conflict_levels": 5}, "conflict-levels must be at most 4, not 5"),
        ({"penalties": ()}, "needs penalties: give at least one"),
        ({"last_resort": "hope"}, "choose one of pibt, wait"),
        ({"backend": "gpu"}, "choose one of auto, xla, host"),
    ],
)
def test_numbers_that_make_no_planner_are_refused_in_one_line(settings, message):
    with pytest.raises(InputError, match=message) as error:
        NegotiatedConfig(**settings)
    assert "\n" not in str(error.value)
