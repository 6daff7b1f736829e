"""The layout as compiled host code sees it."""

from typing import NamedTuple

import numpy as np

from qdenv.simulate.mapf.planner import World

MOVES = 5
RIGHT, LEFT, DOWN, UP = 1, 2, 3, 4  # 0 is to wait


class Site(NamedTuple):
    """One layout; N cells of the padded grid, G goals, n kinds."""

    free: np.ndarray  # bool [N], cells agents may drive on
    goals: np.ndarray  # int64 [G], the goal cells
    odds: np.ndarray  # float32 [n, G], cumulated odds of each goal within its kind
    service_time: np.ndarray  # int64 [n], timesteps served at each kind of goal
    steps: np.ndarray  # int64 [5], what each move adds to a position: wait, right, left, down, up
    width: int  # columns of the padded grid
    margin: int  # rows and columns of walls on each side


def site_of(world: World) -> Site:
    """Take what host code needs of a world of numpy arrays."""
    width = world.traversable.shape[1]
    # Copies: jax's own buffers cannot be written to, for which kernels would be compiled twice.
    return Site(
        np.array(world.traversable).reshape(-1),
        np.asarray(world.goals.cells, np.int64),
        np.array(world.goals.odds),
        np.asarray(world.service_time, np.int64),
        np.array([0, 1, -1, width, -width]),
        width,
        world.margin,
    )
