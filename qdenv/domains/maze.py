"""Maze: one trained agent looks for the goal at the far end of the longest path (appendix B.3)."""

import functools

import jax
import jax.numpy as jnp

from qdenv.domains.base import Domain, EvaluationConfig, Simulator
from qdenv.generate.decode import inside_frame
from qdenv.score import layout as score
from qdenv.simulate.maze import episode as maze
from qdenv.simulate.maze import world as maze_world
from qdenv.simulate.maze.policy import load_weights
from qdenv.types import Array, Measure

MARGIN = (1, 1)
# On an accelerator all episodes of a population run side by side to the horizon; on a CPU one
# layout's at a time, because then the layout's episodes may stop with the last of them.
ACCELERATOR_LANES = 7500


def frame(area: Array) -> Array:
    """Ring the generated area with walls (int8 [h, w] -> [h + 2, w + 2])."""
    return jnp.pad(area, 1, constant_values=maze_world.WALL)


def maze_simulator(config: EvaluationConfig) -> Simulator:
    """Make the maze's simulator, whose runs are `maze.Episode`; the agent is read at once."""
    weights = jax.tree.map(jnp.asarray, load_weights(config.agent))
    on_cpu = jax.default_backend() == "cpu"
    loop = maze.until_done if on_cpu else maze.whole_horizon
    return Simulator(
        prepare=functools.partial(maze.prepare, weights),
        run=lambda tables, key: maze.run_episode(weights, tables, key, config.timesteps, loop),
        lanes=config.simulations if on_cpu else ACCELERATOR_LANES,
    )


def walls(layout: Array, runs: maze.Episode) -> Array:
    """Count the walls inside the ring (-> float32)."""
    del runs
    return score.count(inside_frame(layout, MARGIN), "X", maze_world.TILES)


def entropy(layout: Array, runs: maze.Episode) -> Array:
    """Measure the environment entropy inside the ring (-> float32)."""
    del runs
    return score.entropy(inside_frame(layout, MARGIN), len(maze_world.TILES))


def path_length(layout: Array, runs: maze.Episode) -> Array:
    """Average the agent's actions over its episodes (-> float32); failures count in full."""
    del layout
    return runs.length.mean(dtype=jnp.float32)


WALLS = Measure("number of walls", 0, 256, 256, walls)
ENTROPY = Measure("environment entropy", 0, 1, 100, entropy)
PATH_LENGTH = Measure("mean agent path length", 0, 648, 162, path_length)


def _maze(name: str, measure: Measure) -> Domain:
    return Domain(
        name=name,
        tiles=maze_world.TILES,
        generated=maze_world.TILES,
        seed_block=("XX", "XX"),
        margin=MARGIN,
        frame=frame,
        rules=None,
        simulator=maze_simulator,
        objective=lambda layout, runs: maze_world.is_solvable(layout).astype(jnp.float32),
        price=lambda layout: jnp.ones(layout.shape, jnp.float32),
        measures=(measure, PATH_LENGTH),
    )


MAZE_WALLS = _maze("maze-walls", WALLS)
MAZE_ENTROPY = _maze("maze-entropy", ENTROPY)
