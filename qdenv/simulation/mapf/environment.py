"""The simulator step by step, for learners: one action for every robot, pure functions.

The rules are those of `qdenv.simulation`; who drives is up to the caller. `reset` and `step` can be
jitted, vmapped over keys and layouts, and scanned. Starts and goals are drawn as in
`fleet.simulate`: the same key and moves give the same tasks where goals have no stay.

    # layouts: int8 [B, H, W]
    environment = qdenv.make_environment(layouts, agents=30, domain="hall", auto_reset=True)
    states, timesteps = jax.vmap(environment.reset)(jax.random.split(key, B), jnp.arange(B))
    states, timesteps = jax.vmap(environment.step)(states, actions)  # int32 [B, A]

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

from qdenv.grid import MOVES, fixed_point, of_tiles
from qdenv.ranges import PositiveInt, check_range
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.agents import FleetState, drive, place
from qdenv.simulation.mapf.goals import check_playable
from qdenv.simulation.mapf.planner import NOBODY, World, goal_table
from qdenv.types import Array, InputError, TaskRule

RIGHT, LEFT, DOWN, UP, WAIT = range(len(MOVES) + 1)


class EnvironmentState(NamedTuple):
    """A simulation between two steps."""

    fleet: FleetState  # the robots, as the simulator knows them
    goal: jax.Array  # int32 [2, A], cells of the current and of the next goal
    time: jax.Array  # int32, steps so far
    seed: jax.Array  # uint32 [], of all that is drawn
    layout: jax.Array  # int32, which of the environment's layouts

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
    time: jax.Array  # int32 [], steps so far


class Timestep(NamedTuple):
    """What a step gives."""

    observation: Any  # what the environment's `observe` made of the state
    reward: jax.Array  # float32 [A], tasks that each robot finished, 0 or 1
    refused: jax.Array  # bool [A], the robot's move became a wait
    # bool, the run ended with this step; with `auto_reset` the observation is the next run's first,
    # all else the ended run's; without, steps beyond it are possible
    last: jax.Array


Observe = Callable[[EnvironmentState], Any]


def observe_plainly(state: EnvironmentState) -> Observation:
    """Return positions, goals, services and the time."""
    goal, next_goal = state.goal
    return Observation(state.position, goal, next_goal, state.remaining_service, state.time)


class Environment:
    """A fleet of `agents` robots (A) on a layout, or one of B; the last step is at `timesteps`.

    Actions are int32 [A], 0 right, 1 left, 2 down, 3 up, 4 wait. One that breaks a rule of movement
    becomes a wait, and so does every other number.
    """

    layout: np.ndarray  # int8 [H, W] or [B, H, W]
    free: np.ndarray  # bool, as `layout`: cells robots may drive on
    actions = len(MOVES) + 1

    def __init__(
        self,
        layout: np.ndarray,
        rule: TaskRule,
        agents: int,
        timesteps: int = 1000,
        observe: Observe = observe_plainly,
        auto_reset: bool = False,
    ) -> None:
        """Prepare layouts; `observe`, traceable, makes the observation of a state.

        With `auto_reset` the step that ends a run begins the next one, on the same layout. Raises
        InputError if the fleet could not work on a layout, a number is below one, or tasks of the
        `rule` arrive at a rate.
        """
        check_range("agents", agents, PositiveInt)
        check_range("timesteps", timesteps, PositiveInt)
        if rule.rate:
            raise InputError("robots of an environment always have a task: leave the rate out")
        layouts = layout.reshape(-1, *layout.shape[-2:])
        for one in layouts:
            check_playable(one, rule, agents)
        self.layout, self.agents, self.timesteps = layout, agents, timesteps
        self.free = np.asarray(of_tiles(layout, rule.traversable, rule.tiles))
        self._observe, self._auto_reset = observe, auto_reset
        tables = [goal_table(one, rule, one.size) for one in layouts]
        self._goals = jax.tree.map(lambda *leaves: jnp.stack(leaves), *tables)
        self._traversable = jnp.asarray(self.free).reshape(layouts.shape)
        self._everyone = jnp.ones((agents,), bool)

    def _world(self, layout: jax.Array) -> World:
        goals = jax.tree.map(lambda leaf: leaf[layout], self._goals)
        distance = jnp.zeros((0, 0), jnp.int16)  # no planner needs to know how far it is
        return World(self._traversable[layout], goals, distance, jnp.bool_(True), margin=0)

    def reset(self, key: jax.Array, layout: Array | int = 0) -> tuple[EnvironmentState, Timestep]:
        """Begin a run on one of the layouts (`layout`, int32 []); traceable.

        Consumes `key`, which decides starts and goals. Returns the state, and its observation in a
        `Timestep` without rewards.
        """
        state = self._begin(chance.seed_of(key), jnp.asarray(layout, jnp.int32))
        nothing = jnp.zeros((self.agents,), jnp.float32)
        return state, Timestep(self._observe(state), nothing, ~self._everyone, jnp.bool_(False))

    def _begin(self, seed: jax.Array, layout: jax.Array) -> EnvironmentState:
        world = self._world(layout)
        fleet = place(world, 0, self._everyone, seed)
        return EnvironmentState(fleet, world.goals.cells[fleet.goal], jnp.int32(0), seed, layout)

    def step(self, state: EnvironmentState, actions: Array) -> tuple[EnvironmentState, Timestep]:
        """Drive all robots by one step from `state` as `actions` (int32 [A]) say; traceable.

        Returns the next state, and observation, rewards and refusals.
        """
        fleet, seed, world = state.fleet, state.seed, self._world(state.layout)
        actions = jnp.asarray(actions)
        ahead = self.targets(fleet.position, actions, state.layout)
        cell = jnp.where(fleet.remaining_service > 0, fleet.position, ahead)
        cell = settle(fleet.position, cell, world.traversable.size)
        drawn = chance.draw(chance.draw(seed, chance.GOALS), state.time)
        refused = (cell == fleet.position) & (actions >= 0) & (actions < WAIT)
        fleet, finished = drive(world, fleet, cell, self._everyone, drawn)
        # Each step is a new plan: a stay never has to wait for the next one.
        fleet = fleet._replace(legs=jnp.zeros_like(fleet.legs))
        cells = world.goals.cells[fleet.goal]
        after = EnvironmentState(fleet, cells, state.time + 1, seed, state.layout)
        reward, last = finished.astype(jnp.float32), after.time >= self.timesteps
        if self._auto_reset:
            fresh = self._begin(chance.draw(seed, chance.NEXT_RUN), state.layout)
            after = jax.tree.map(lambda new, old: jnp.where(last, new, old), fresh, after)
        return after, Timestep(self._observe(after), reward, refused, last)

    def targets(
        self, position: jax.Array, actions: jax.Array, layout: Array | int = 0
    ) -> jax.Array:
        """Find the cells that actions lead to where no agent is in the way (int32 [A]).

        `position` (cells) and `actions` are int32 [A], `layout` (int32 []) is one of the layouts.
        """
        rows, cols = self.free.shape[-2:]
        steps = jnp.array([*MOVES, (0, 0)], jnp.int32)
        step = steps[jnp.where((actions >= 0) & (actions < self.actions), actions, WAIT)]
        row, col = position // cols + step[:, 0], position % cols + step[:, 1]
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        target = jnp.where(inside, row * cols + col, position)
        return jnp.where(self._traversable[layout].reshape(-1)[target], target, position)


def settle(position: jax.Array, ahead: jax.Array, cells: int) -> jax.Array:
    """Turn moves that conflict into waits until none does (int32 [A]).

    Robots at `position` (int32 [A], all different) would go to `ahead` (int32 [A], the same cell
    or a neighbouring one) on a layout of `cells` cells. Every pass turns at least one move into a
    wait or is the last.
    """
    everyone = jnp.arange(position.shape[0], dtype=jnp.int32)
    there = jnp.full((cells,), NOBODY, jnp.int32).at[position].set(everyone)[ahead]
    swaps = (there != NOBODY) & (there != everyone) & (ahead[there] == position)

    def give_way(cell: jax.Array) -> jax.Array:
        crowd = jnp.zeros((cells,), jnp.int32).at[cell].add(1)
        return jnp.where(crowd[cell] > 1, position, cell)

    return fixed_point(give_way, jnp.where(swaps, position, ahead))
