"""The simulator step by step, for learners: one action for every robot, pure functions.

The rules are those of `qdenv.simulate`; who drives is up to the caller. `reset` and `step` can be
jitted, vmapped over keys and scanned. Starts and goals are drawn as in `fleet.simulate`: the same
key and moves give the same tasks.

**Actions** are int32 [A]: 0 right, 1 left, 2 down, 3 up, 4 wait. An action that the rules forbid
becomes a wait, so no step ever breaks one:

* a move off the layout or into an obstacle, and any move while serving at a goal;
* both moves of two robots that would swap cells;
* all moves of robots to one cell, or the cell of a robot that waits.

A robot that must wait keeps its cell, which may make others wait in turn. Following and cycles are
allowed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.grid import MOVES, of_tiles
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.fleet import FleetState, drive, place
from qdenv.simulate.mapf.goals import check_playable
from qdenv.simulate.mapf.planner import NOBODY, World, goal_table
from qdenv.types import Array, InputError, TaskRule

RIGHT, LEFT, DOWN, UP, WAIT = range(len(MOVES) + 1)


class EnvironmentState(NamedTuple):
    """A simulation between two steps."""

    fleet: FleetState  # the robots, as the simulator knows them
    goal: jax.Array  # int32 [2, A], cells of the current and of the next goal
    time: jax.Array  # int32, steps so far
    seed: jax.Array  # uint32, of all that is drawn

    @property
    def position(self) -> jax.Array:
        """The cell of each robot, int32 [A]: ``row * width + column``."""
        return self.fleet.position

    @property
    def remaining_service(self) -> jax.Array:
        """Timesteps that each robot must still remain on its goal, int32 [A]."""
        return self.fleet.remaining_service


class Observation(NamedTuple):
    """What a learner sees unless it brings another function."""

    position: jax.Array  # int32 [A], cells
    goal: jax.Array  # int32 [A], cells
    next_goal: jax.Array  # int32 [A], cells
    remaining_service: jax.Array  # int32 [A], timesteps
    time: jax.Array  # int32


class Timestep(NamedTuple):
    """What a step gives."""

    observation: Any  # what the environment's `observe` made of the state
    reward: jax.Array  # float32 [A], tasks that each robot finished, 0 or 1
    refused: jax.Array  # bool [A], the robot's move became a wait
    last: jax.Array  # bool, the horizon is reached; steps beyond it are possible


Observe = Callable[[EnvironmentState], Any]


def observe_plainly(state: EnvironmentState) -> Observation:
    """Return positions, goals, services and the time."""
    goal, next_goal = state.goal
    return Observation(state.position, goal, next_goal, state.remaining_service, state.time)


class Environment:
    """A fleet of `agents` robots (A) on one layout; the last step is that at `timesteps`."""

    layout: np.ndarray  # int8 [H, W]
    free: np.ndarray  # bool [H, W], cells robots may drive on
    actions = len(MOVES) + 1

    def __init__(
        self,
        layout: np.ndarray,
        rule: TaskRule,
        agents: int,
        timesteps: int = 1000,
        observe: Observe = observe_plainly,
    ) -> None:
        """Prepare a layout; `observe`, traceable, makes the observation of a state.

        Raises InputError if the fleet could not work on this layout, or a number is below one.
        """
        if agents < 1 or timesteps < 1:
            raise InputError("an environment needs at least one robot and one timestep")
        check_playable(layout, rule, agents)
        self.layout, self.agents, self.timesteps = layout, agents, timesteps
        self.free = np.asarray(of_tiles(layout, rule.traversable, rule.tiles))
        self._observe = observe
        self._world = World(
            traversable=jnp.asarray(self.free),
            goals=goal_table(layout, rule, layout.size),
            # No planner needs to know how far it is.
            distance=jnp.zeros((0, layout.size), jnp.int16),
            valid=jnp.bool_(True),
            margin=0,
        )
        self._everyone = jnp.ones((agents,), bool)

    def reset(self, key: jax.Array) -> tuple[EnvironmentState, Timestep]:
        """Begin a run; the key is consumed and decides starts and goals."""
        seed = chance.seed_of(key)
        fleet = place(self._world, 0, self._everyone, seed)
        cells = self._world.goals.cells[fleet.goal]
        state = EnvironmentState(fleet, cells, jnp.int32(0), seed)
        nothing, last = jnp.zeros((self.agents,), jnp.float32), state.time >= self.timesteps
        return state, Timestep(self._observe(state), nothing, ~self._everyone, last)

    def step(self, state: EnvironmentState, actions: Array) -> tuple[EnvironmentState, Timestep]:
        """Drive all robots by one step.

        Actions are int32 [A], 0 right, 1 left, 2 down, 3 up, 4 wait; every other number waits, too.
        """
        fleet, seed = state.fleet, state.seed
        ahead = self.targets(fleet.position, jnp.asarray(actions))
        cell = jnp.where(fleet.remaining_service > 0, fleet.position, ahead)
        cell = settle(fleet.position, cell, self.layout.size)
        drawn = chance.draw(chance.draw(seed, chance.GOALS), state.time)
        refused = (cell == fleet.position) & (actions >= 0) & (actions < WAIT)
        fleet, finished = drive(self._world, fleet, cell, self._everyone, drawn)
        # Each step is a new plan: a stay never has to wait for the next one.
        fleet = fleet._replace(legs=jnp.zeros_like(fleet.legs))
        after = EnvironmentState(fleet, self._world.goals.cells[fleet.goal], state.time + 1, seed)
        reward, last = finished.astype(jnp.float32), after.time >= self.timesteps
        return after, Timestep(self._observe(after), reward, refused, last)

    def targets(self, position: jax.Array, actions: jax.Array) -> jax.Array:
        """Find the cells that actions lead to where no agent is in the way (int32 [A])."""
        rows, cols = self.free.shape
        steps = jnp.array([*MOVES, (0, 0)], jnp.int32)
        known = (actions >= 0) & (actions < self.actions)
        step = steps[jnp.where(known, actions, WAIT)]
        row, col = position // cols + step[:, 0], position % cols + step[:, 1]
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        target = jnp.where(inside, row * cols + col, position)
        return jnp.where(self._world.traversable.reshape(-1)[target], target, position)


def settle(position: jax.Array, ahead: jax.Array, cells: int) -> jax.Array:
    """Turn moves that conflict into waits until none does (int32 [A]).

    Robots at `position` (int32 [A], all different) would go to `ahead` (int32 [A], the same cell
    or a neighbouring one) on a layout of `cells` cells. Every pass turns at least one move into a
    wait or is the last.
    """
    everyone = jnp.arange(position.shape[0], dtype=jnp.int32)
    there = jnp.full((cells,), NOBODY, jnp.int32).at[position].set(everyone)[ahead]
    swaps = (there != NOBODY) & (there != everyone) & (ahead[there] == position)
    first = jnp.where(swaps, position, ahead)

    def conflicts(cell: jax.Array) -> jax.Array:
        crowd = jnp.zeros((cells,), jnp.int32).at[cell].add(1)
        return (crowd[cell] > 1) & (cell != position)

    return jax.lax.while_loop(
        lambda cell: conflicts(cell).any(),
        lambda cell: jnp.where(conflicts(cell), position, cell),
        first,
    )
