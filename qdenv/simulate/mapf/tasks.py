"""Task rules as data: where goals lie, how they are drawn, and in which order they are visited."""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from scipy import ndimage

from qdenv.grid import count_neighbours, of_tiles
from qdenv.native import shared
from qdenv.simulate.mapf import chance
from qdenv.types import Array, Goal, InputError, TaskRule

Counts = TypeVar("Counts", int, jax.Array)


class GoalTable(NamedTuple):
    """The goals of one layout; G is the goal capacity, n the number of kinds in the cycle.

    Attributes:
        cells: int32 [G], the goal cells in row-major order; unused slots hold 0.
        used: bool [G].
        odds: float32 [n, G], cumulated odds of each slot within its kind, ending in 1.
        complete: bool, every kind has a goal and no goal was left out for want of slots.
    """

    cells: jax.Array
    used: jax.Array
    odds: jax.Array
    complete: jax.Array


def tile_goal(symbol: str, tiles: str, stay: int = 0) -> Goal:
    """Make every cell that holds `symbol` a goal.

    Args:
        symbol: the tile agents drive onto.
        tiles: the alphabet of the layouts.
        stay: timesteps spent on the goal after arriving.
    """
    return Goal(
        lambda layout: of_tiles(layout, symbol, tiles).astype(jnp.float32), stay, f"{symbol!r}"
    )


def beside_goal(symbol: str, station: str, stay: int, tiles: str) -> Goal:
    """Make every `symbol` cell beside a `station` a goal, once per station at its sides.

    Args:
        symbol: the tile agents drive onto.
        station: the tile that must lie at one of its four sides.
        stay: timesteps spent on the goal after arriving.
        tiles: the alphabet of the layouts.
    """

    def weight(layout: Array) -> jax.Array:
        stations = count_neighbours(of_tiles(layout, station, tiles))
        return (of_tiles(layout, symbol, tiles) * stations).astype(jnp.float32)

    return Goal(weight, stay, f"{symbol!r} beside {station!r}")


def favour_left(goal: Goal, odds: float) -> Goal:
    """Make goals in column 0 `odds` times likelier (uneven warehouse of appendix B.1: 5)."""

    def weight(layout: Array) -> jax.Array:
        left = jnp.arange(layout.shape[1]) == 0
        return jnp.where(left, odds, 1.0)[None, :] * goal.weight(layout)

    return goal._replace(weight=weight)


def service_times(rule: TaskRule) -> np.ndarray:
    """List the timesteps served at each kind of goal (int32 [n])."""
    return np.array([goal.stay for goal in rule.cycle], dtype=np.int32)


def check_playable(layout: np.ndarray, rule: TaskRule, agents: int) -> None:
    """Refuse a layout (int8 [H, W]) on which the fleet could not work.

    Raises:
        InputError: there are fewer free cells than agents, a kind of goal has no cell, or some
            free cells cannot be reached from the others.
    """
    free = np.asarray(of_tiles(layout, rule.traversable, rule.tiles))
    if free.sum() < agents:
        raise InputError(
            f"{agents} agents need as many free cells, the layout has {free.sum()}: "
            "simulate fewer agents"
        )
    for goal in rule.cycle:
        if not (np.asarray(goal.weight(layout)) > 0).any():
            raise InputError(f"no agent could work: the layout has no {goal.name}")
    labels, parts = ndimage.label(free)
    if parts > 1:
        smallest = 1 + np.argmin(np.bincount(labels.ravel())[1:])
        row, column = np.argwhere(labels == smallest)[0]
        raise InputError(
            f"the free cells fall into {parts} parts, row {row}, column {column} is cut off: "
            "repair the layout first"
        )


def goal_table(layout: Array, rule: TaskRule, capacity: int) -> GoalTable:
    """List the goals of `layout` (int8 [H, W]) in `capacity` slots."""
    weights = jnp.stack([goal.weight(layout).reshape(-1) for goal in rule.cycle])
    weights = weights.astype(jnp.float32)
    wanted = (weights > 0).any(0)
    cells = jnp.nonzero(wanted, size=capacity, fill_value=0)[0].astype(jnp.int32)
    used = jnp.arange(capacity) < wanted.sum()
    cumulated = jnp.cumsum(jnp.where(used, weights[:, cells], 0.0), axis=1)
    total = cumulated[:, -1:]
    complete = (total > 0).all() & (wanted.sum() <= capacity)
    return GoalTable(cells, used, cumulated / jnp.maximum(total, 1e-6), complete)


def draw_goals(table: GoalTable, kinds: jax.Array, seed: jax.Array) -> jax.Array:
    """Draw one goal slot per agent, independently and with the odds of its kind.

    Args:
        table: goals of the layout.
        kinds: int32 [A], index into the cycle.
        seed: of the draw. Agent i's goal does not depend on the number of agents.

    Returns:
        int32 [A], slots of `table`.
    """
    values = chance.uniform(chance.draw_many(seed, kinds.shape[0]))
    per_kind = jax.vmap(lambda odds: jnp.searchsorted(odds, values, side="right"))(table.odds)
    slots = jnp.take_along_axis(per_kind, kinds[None].astype(jnp.int32), axis=0)[0]
    return jnp.minimum(slots, table.cells.shape[0] - 1).astype(jnp.int32)


@shared
def serve(
    remaining_service: Counts, on_goal: Counts, service_time: Counts
) -> tuple[Counts, Counts]:
    """Begin, continue and end services; the one place that has the rule, for both backends.

    An agent that reaches its goal while it drives begins to serve there. The task is finished
    when nothing is left to serve, at once where a goal asks for no service.

    Args:
        remaining_service: int32 [A], timesteps left to serve before the step; 0 while driving.
        on_goal: bool [A], the agent is on its goal after the step.
        service_time: int32 [A], timesteps its goal asks for, at least 0.

    Returns:
        remaining_service after the step (int32 [A]), who finished a task (bool [A]).
    """
    serving = remaining_service > 0
    arrived = (remaining_service == 0) & on_goal
    left = arrived * service_time + serving * (remaining_service - 1)
    return left, (arrived | serving) & (left == 0)
