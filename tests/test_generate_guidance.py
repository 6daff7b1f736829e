"""Generators that draw the costs of moves: what their parameters mean, how they are evaluated."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_warehouse import ROWS

from qdenv.domains.base import find_domain, make_domain
from qdenv.generators import GENERATORS, CostsConfig, GuidedNcaConfig, NcaConfig, UpdateConfig
from qdenv.grid import DOWN, LEFT, RIGHT, UP, WAIT, of_tiles, parse
from qdenv.guidance import (
    NUM_SMOOTH,
    crisscross,
    existing_moves,
    fixed_costs,
    scaled_costs,
    smooth_logarithms,
)
from qdenv.nca import add_channels
from qdenv.pipeline import PipelinedEvaluator, evaluate, make_pipeline
from qdenv.run.evaluate import Threads
from qdenv.settings import EvaluationConfig
from qdenv.simulation.mapf import fleet
from qdenv.simulation.mapf.goals import tile_goal
from qdenv.simulation.mapf.settings import FleetConfig, PibtConfig
from qdenv.study.engine import run_seeds
from qdenv.types import Floor, InputError, TaskRule

pytestmark = pytest.mark.slow

WAREHOUSE = find_domain("warehouse-even").fitted(parse(ROWS, find_domain("warehouse-even").tiles))
TASKS = WAREHOUSE.simulator.tasks
LAYOUT = parse(ROWS, WAREHOUSE.tiles)
FREE = np.asarray(of_tiles(LAYOUT, TASKS.traversable, TASKS.tiles))
FLOOR = tuple("".join(".#"[not free] for free in row) for row in FREE)
FLEET = FleetConfig(12, 60, 1, 1, planner=PibtConfig("host"), stop_when_congested=False)


def evaluation(generator):
    domain = replace(WAREHOUSE.config, keep=tuple(ROWS), fleet=FLEET)
    return EvaluationConfig(domain, generator, simulations=2, alpha=0.0)


@pytest.mark.parametrize(
    "generator", [CostsConfig(FLOOR), CostsConfig(FLOOR, smooth=True), UpdateConfig(rounds=2)]
)
def test_a_floor_that_stands_begins_with_the_costs_of_the_base(generator):
    pipeline = make_pipeline(evaluation(generator))
    nothing = np.zeros((2, pipeline.solution_size), np.float32)
    found = evaluate(pipeline, nothing, jax.random.key(3))
    np.testing.assert_array_equal(found.repaired, np.stack([LAYOUT, LAYOUT]))
    domain = make_domain(pipeline.domain.config)
    world = domain.simulator.prepare(
        LAYOUT, scaled_costs(jnp.zeros((5, *FREE.shape)), "crisscross")
    )
    for item in range(2):
        keys = jax.random.split(jax.random.fold_in(jax.random.key(3), item), 2)
        runs = [domain.simulator.run(world, key).finished for key in keys]
        np.testing.assert_array_equal(found.runs.finished[item], np.stack(runs))


def test_a_parameter_is_the_logarithm_of_a_factor():
    guide = GENERATORS.make(CostsConfig(FLOOR, "none"), WAREHOUSE.canvas).guide
    moves = existing_moves(FREE)
    solution = np.zeros(moves.sum(), np.float32)
    solution[moves[WAIT].sum()] = np.log(2)  # the first way to the right
    solution[0] = -9  # a tenth at least
    costs = np.asarray(guide(solution, 0, LAYOUT, None))
    cell = tuple(np.argwhere(moves[RIGHT])[0])
    assert costs[(RIGHT, *cell)] == 128
    assert costs[WAIT].min() == 6
    assert (costs == 64).sum() == costs.size - 2


@pytest.mark.parametrize("base, width", [("none", 1), ("crisscross", 1), ("crisscross-pairs", 2)])
def test_smooth_factors_are_quadratic_in_the_distances_for_each_move_along_a_lane(base, width):
    shape = 5, 7
    numbers = np.random.default_rng(2).normal(size=NUM_SMOOTH).astype(np.float32)
    found = np.asarray(smooth_logarithms(numbers, shape, base))
    kinds = numbers.reshape(5, 6)  # waiting; right, left, down, up of even lanes
    back = {WAIT: WAIT, RIGHT: LEFT, LEFT: RIGHT, DOWN: UP, UP: DOWN}
    for move, row, col in np.ndindex(5, *shape):
        x, y = abs(col - 3) / 3.5, abs(row - 2) / 2.5
        lane = (row if move in (RIGHT, LEFT) else col) // width
        kind = kinds[back[move] if lane % 2 else move]
        expected = 3 * kind @ [1, x, y, x * x, x * y, y * y]
        assert found[move, row, col] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize(
    "config, factor",
    [(CostsConfig(FLOOR, smooth=True), 1), (GuidedNcaConfig(steps=2, smooth=True), 8)],
)
def test_a_solution_ends_with_its_smooth_factors(config, factor):
    generator = GENERATORS.make(config, WAREHOUSE.canvas)
    solution = np.zeros(generator.size, np.float32)
    smooth = np.random.default_rng(5).normal(0, 0.2, NUM_SMOOTH).astype(np.float32)
    solution[-NUM_SMOOTH:] = smooth / factor
    costs = generator.guide(solution, 2, LAYOUT, None)
    expected = scaled_costs(smooth_logarithms(smooth, LAYOUT.shape, "crisscross"), "crisscross")
    np.testing.assert_array_equal(costs, expected)


def test_the_base_is_what_fixed_costs_make_of_it_but_for_the_scale():
    scaled = np.asarray(scaled_costs(jnp.zeros((5, *FREE.shape)), "crisscross"))
    fixed, moves = fixed_costs(crisscross(FREE), FREE), existing_moves(FREE)
    ratio = fixed[moves] / scaled[moves]
    assert ratio.max() / ratio.min() < 1.02  # both are rounded to whole numbers


def test_costs_without_a_floor_are_refused():
    with pytest.raises(InputError, match="needs an existing floor"):
        GENERATORS.make(CostsConfig(), WAREHOUSE.canvas)


def test_an_automaton_grows_its_costs_with_the_tiles_and_the_frame_has_the_nearest():
    generator = GENERATORS.make(GuidedNcaConfig(steps=4, hidden=4, base="none"), WAREHOUSE.canvas)
    solution = np.random.default_rng(1).normal(0, 0.4, generator.size).astype(np.float32)
    costs = np.asarray(generator.guide(solution, 4, LAYOUT, None))
    assert costs.shape == (5, *LAYOUT.shape)
    assert len(np.unique(costs)) > 10
    rows, cols = WAREHOUSE.margin
    inside = costs[:, rows : costs.shape[1] - rows, cols : costs.shape[2] - cols]
    edge = np.pad(inside, ((0, 0), (rows, rows), (cols, cols)), "edge")
    np.testing.assert_array_equal(costs, edge)
    tiles = np.asarray(generator.grow(solution[None], 4))
    assert tiles.max() < len(WAREHOUSE.generated)
    np.testing.assert_array_equal(np.asarray(generator.frames(solution[None], 4))[:, -1], tiles)


@pytest.mark.parametrize("smooth", [False, True])
def test_a_plain_automaton_that_is_given_costs_draws_the_same_tiles(smooth):
    plain = GENERATORS.make(NcaConfig(steps=6, hidden=5), WAREHOUSE.canvas)
    config = GuidedNcaConfig(steps=6, hidden=5, smooth=smooth)
    guided = GENERATORS.make(config, WAREHOUSE.canvas)
    solution = np.random.default_rng(4).normal(0, 0.5, plain.size).astype(np.float32)
    if smooth:
        more = np.pad(solution, (0, NUM_SMOOTH))
    else:
        more = add_channels(solution, len(WAREHOUSE.generated), 5, (3, 3, 3), 5)
    np.testing.assert_array_equal(guided.grow(more[None], 6), plain.grow(solution[None], 6))
    costs = guided.guide(more, 6, LAYOUT, None)
    np.testing.assert_array_equal(costs, scaled_costs(jnp.zeros((5, *LAYOUT.shape)), "crisscross"))
    assert len(np.unique(plain.grow(solution[None], 6))) > 1


def test_costs_are_drawn_for_the_repaired_layout_of_the_same_solution():
    config = evaluation(GuidedNcaConfig(steps=3, hidden=4))
    config = replace(config, domain=replace(config.domain, keep=()))
    pipeline = make_pipeline(config)
    solutions = np.random.default_rng(2).normal(0, 0.3, (4, pipeline.solution_size))
    solutions = solutions.astype(np.float32)
    found = evaluate(pipeline, solutions, jax.random.key(5))
    threads = PipelinedEvaluator(pipeline, Threads(pipeline)).begin(solutions, jax.random.key(5))()
    np.testing.assert_array_equal(found.runs.throughput, threads.runs.throughput)
    guide = GENERATORS.make(config.generator, pipeline.domain.canvas).guide
    for item, layout in enumerate(np.asarray(found.repaired)):
        world = pipeline.domain.simulator.prepare(layout, guide(solutions[item], 3, layout, None))
        keys = jax.random.split(jax.random.fold_in(jax.random.key(5), item), 2)
        runs = [pipeline.domain.simulator.run(world, key).finished for key in keys]
        np.testing.assert_array_equal(found.runs.finished[item], np.stack(runs))


def test_moves_are_counted_as_the_recording_shows_them():
    costs = fixed_costs(crisscross(FREE), FREE)
    world = fleet.prepare(jnp.asarray(LAYOUT), TASKS, FLEET, costs)
    key = jax.random.key(7)
    counts = np.asarray(fleet.count_moves(world, key, FLEET))
    run, recording = fleet.record(world, key, FLEET)
    positions, cols = np.asarray(recording.positions), LAYOUT.shape[1]
    expected = np.zeros_like(counts).reshape(5, -1)
    steps = [0, 1, -1, cols, -cols]
    for before, after in zip(positions[:-1].T.ravel(), positions[1:].T.ravel(), strict=True):
        expected[steps.index(after - before), before] += 1
    np.testing.assert_array_equal(counts.reshape(5, -1), expected)
    assert counts.sum() == 12 * 60 and run.throughput > 0


def test_moves_along_one_column_lead_up_and_down():
    tasks = TaskRule(".12", ".12", tuple(tile_goal(goal, ".12") for goal in "12"))
    config = FleetConfig(1, 20, 1, 1, planner=PibtConfig("xla"), stop_when_congested=False)
    world = fleet.prepare(parse(["1", ".", "2"], ".12"), tasks, config)
    moves = fleet.count_moves(world, jax.random.key(0), config).sum((1, 2))
    assert moves[RIGHT] == moves[LEFT] == 0 and moves[DOWN] > 3 and moves[UP] > 3


def test_an_update_reads_the_moves_of_a_simulation_under_the_costs_before():
    generator = GENERATORS.make(UpdateConfig(rounds=2, hidden=3), WAREHOUSE.canvas)
    solution = np.random.default_rng(3).normal(0, 0.3, generator.size).astype(np.float32)
    seen = []

    def drive(costs, number):
        seen.append((np.asarray(costs), number))
        return jnp.ones((5, *LAYOUT.shape), jnp.int32)

    final = np.asarray(generator.guide(solution, 0, LAYOUT, drive))
    assert [number for _, number in seen] == [0, 1]
    np.testing.assert_array_equal(
        seen[0][0], scaled_costs(jnp.zeros((5, *LAYOUT.shape)), "crisscross")
    )
    assert (seen[1][0] != seen[0][0]).any() and (final != seen[1][0]).any()


def test_a_study_of_a_floor_drives_by_its_costs():
    costs = fixed_costs(crisscross(FREE), FREE)
    with_costs = run_seeds(Floor(LAYOUT, costs), TASKS, FLEET, (0, 1)).runs
    without = run_seeds(LAYOUT, TASKS, FLEET, (0, 1)).runs
    assert any((a.usage != b.usage).any() for a, b in zip(with_costs, without, strict=True))
