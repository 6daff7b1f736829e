"""The face of a planner: what it is told, and what it answers.

A planner is a hashable function ``(problem, situation, horizon, key) -> paths``. It gives every
agent a path of `window` steps, of which the next `horizon` are driven before it is asked again.
Those must obey the movement rules (`qdenv.simulate`); the rest is a plan the planner gets back.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf.tasks import GoalTable
from qdenv.types import Array


class Problem(NamedTuple):
    """One layout made ready to be simulated, shared by all its runs.

    The grid is surrounded by `margin` rows and columns of walls, so that planners look around
    without testing for the border. Positions are ``row * width + column`` of this walled grid.

    Attributes:
        traversable: bool [H', W'], cells agents may drive on.
        goals: the goal table; its cells are positions of the walled grid.
        distance: int16 [G, H' * W'], steps from every cell to every goal.
        stays: int32 [n], timesteps served at each kind of goal.
        valid: bool, agents and goals fit the layout.
    """

    traversable: Array
    goals: GoalTable
    distance: Array
    stays: Array
    valid: Array


class Situation(NamedTuple):
    """Where the agents are and where they want to go.

    Attributes:
        position: int32 [A]. Padding agents are somewhere too, but do not count.
        active: bool [A], False for padding.
        goal: int32 [2, A], slots of the current and of the next goal.
        stay: int32 [2, A], timesteps to serve at each of them.
        serving: int32 [A], timesteps the agent must still remain on its goal; 0 while driving.
        age: int32 [A], timesteps since the agent last finished a task.
        previous: int32 [window + 1, A], the last paths from here on; their last cell is repeated.
    """

    position: Array
    active: Array
    goal: Array
    stay: Array
    serving: Array
    age: Array
    previous: Array


Planner = Callable[[Problem, Situation, int, Array], Array]


def conflicts(ours: Array, theirs: Array) -> jax.Array:
    """Find pairs of paths with a vertex or swap conflict (int32 [t+1, A], [t+1, B] -> bool [A, B]).

    The common first row is where the agents stand and is not tested.
    """
    a, b = ours[:, :, None], theirs[:, None, :]
    met = (a[1:] == b[1:]).any(0)
    swapped = ((a[1:] == b[:-1]) & (a[:-1] == b[1:])).any(0)
    return met | swapped


def first_of_each_clash(clash: Array, candidates: Array) -> jax.Array:
    """Choose candidates (bool [K]) none of which clashes (bool [K, K]) with an earlier chosen one.

    Three sweeps of the greedy rule; an odd number of sweeps errs towards choosing too few.
    """
    count = candidates.shape[0]
    earlier = clash & (jnp.arange(count)[:, None] > jnp.arange(count)[None, :])
    chosen = candidates
    for _ in range(3):
        chosen = candidates & ~(earlier & chosen[None, :]).any(1)
    return chosen
