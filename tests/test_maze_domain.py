"""The maze as a domain: frame, degenerate levels, measures, one trace for many batches."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qdenv.agent.train import save_weights
from qdenv.domains.base import find_domain, make_domain
from qdenv.domains.maze import MazeConfig
from qdenv.grid import parse
from qdenv.nca import NcaConfig
from qdenv.pipeline import EvaluationConfig, evaluate, make_pipeline, score_layout, simulate_layouts
from qdenv.score import entropy
from qdenv.simulation.maze.policy import draw_weights
from qdenv.types import RepairStatus

pytestmark = pytest.mark.slow

CONFIG = EvaluationConfig(
    domain=MazeConfig(rows=6, cols=6, timesteps=72),
    generator=NcaConfig(steps=4, kernel_sizes=(3, 1, 1), hidden=4),
    simulations=5,
    alpha=0.0,
)
WALL_MAZE, ENTROPY_MAZE = find_domain("maze-walls"), find_domain("maze-entropy")


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("agent") / "agent.npz"
    save_weights(draw_weights(jax.random.key(0), 8, 3), path)
    return replace(CONFIG, domain=replace(CONFIG.domain, agent=str(path)))


def judge(config, areas):
    """Simulate and score drawn areas of one size."""
    domain = make_domain(config.domain).resized(len(areas[0]) + 2, len(areas[0][0]) + 2)
    layouts = jax.vmap(domain.frame)(jnp.stack([parse(rows, domain.tiles) for rows in areas]))

    @jax.jit
    def chain(layouts):
        keys = jax.random.split(jax.random.key(1), len(layouts))
        runs = simulate_layouts(domain.simulator, layouts, keys, CONFIG.simulations)
        status = jnp.full(len(layouts), RepairStatus.OPTIMAL)
        return jax.vmap(lambda *item: score_layout(domain, 0.0, *item))(
            layouts, layouts, status, runs
        )

    return chain(layouts).score


LEVELS = {
    "walls": (["XXXX"] * 4, False),
    "empty": (["    "] * 4, True),
    "corridor": (["XXXX", "    ", "XXXX", "XXXX"], True),
    "isolated": ([" X X", "XXXX", "X X ", "XXXX"], False),
    "disconnected": (["  X ", "XXXX", " X  ", "XXXX"], True),
}


@pytest.mark.parametrize(
    "levels",
    [LEVELS, {"non-square": (["   ", "X X"], True)}, {"one tile": ([" "], False)}],
    ids=["4x4", "2x3", "1x1"],
)
def test_degenerate_levels_have_defined_scores(config, levels):
    scores = judge(config, [rows for rows, _ in levels.values()])
    for number, (name, (rows, solvable)) in enumerate(levels.items()):
        found = jax.tree.map(lambda x, n=number: x[n], scores)
        assert bool(found.success), name
        assert float(found.objective) == float(found.result_objective) == float(solvable), name
        walls, length = found.measures.tolist()
        assert walls == sum(row.count("X") for row in rows), name
        assert (1 <= length <= CONFIG.domain.timesteps) if solvable else length == 0, name


def test_frame_is_a_ring_of_walls():
    framed = np.asarray(WALL_MAZE.frame(jnp.zeros((2, 3), jnp.int8)))
    assert ["".join(WALL_MAZE.tiles[k] for k in row) for row in framed] == [
        "XXXXX",
        "X   X",
        "X   X",
        "XXXXX",
    ]


def test_measures_have_the_published_ranges():
    axes = [(m.low, m.high, m.cells) for m in (*WALL_MAZE.measures, ENTROPY_MAZE.measures[0])]
    assert axes == [(0, 256, 256), (0, 648, 162), (0, 1, 100)]
    area = (np.random.default_rng(1).random((16, 16)) < 0.4).astype(np.int8)
    measured = ENTROPY_MAZE.measures[0].value(ENTROPY_MAZE.frame(jnp.asarray(area)), None)
    np.testing.assert_allclose(measured, entropy(jnp.asarray(area), 2), rtol=1e-6)


def test_ten_iterations_trace_once_and_a_shorter_batch_gives_the_same(config):
    pipeline = make_pipeline(config)
    traced = []

    @jax.jit
    def iterations(parameters, key):
        traced.append(1)

        def one(key, _):
            key, now = jax.random.split(key)
            return key, evaluate(pipeline, parameters, now).score

        return jax.lax.scan(one, key, None, length=10)[1]

    parameters = jax.random.normal(jax.random.key(2), (4, pipeline.solution_size))
    scores = iterations(parameters, jax.random.key(0))
    iterations(parameters + 1, jax.random.key(1))
    assert len(traced) == 1
    assert scores.measures.shape == (10, 4, 2)
    short = jax.jit(lambda p, k: evaluate(pipeline, p, k).score)
    _, key = jax.random.split(jax.random.key(0))
    fewer = short(parameters[:2], key)
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[0, :2], b), scores, fewer)
