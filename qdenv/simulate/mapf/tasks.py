"""The goals of one layout: listed, drawn, and served."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

from qdenv.lazy import jax, jnp
from qdenv.native import shared
from qdenv.simulate.mapf import chance
from qdenv.types import Array, TaskRule

Counts = TypeVar("Counts", int, jax.Array)
KNOWN = 2  # goals that planners know of each agent: the current and the next


class GoalTable(NamedTuple):
    """The goals of one layout; G is the goal capacity, n the number of kinds in the cycle."""

    cells: jax.Array  # int32 [G], the goal cells in row-major order; unused slots hold 0
    used: jax.Array  # bool [G]
    odds: jax.Array  # float32 [n, G], cumulated odds of each slot within its kind, ending in 1
    complete: jax.Array  # bool, every kind has a goal and no goal was left out for want of slots


def goal_table(layout: Array, rule: TaskRule, capacity: int) -> GoalTable:
    """List the goals of `layout` (int8 [H, W]) in `capacity` slots."""
    weights = jnp.stack([goal.weight(layout).reshape(-1) for goal in rule.cycle])
    weights = weights.astype(jnp.float32)
    is_goal = (weights > 0).any(0)
    cells = jnp.nonzero(is_goal, size=capacity, fill_value=0)[0].astype(jnp.int32)
    used = jnp.arange(capacity) < is_goal.sum()
    cumulated = jnp.cumsum(jnp.where(used, weights[:, cells], 0.0), axis=1)
    total = cumulated[:, -1:]
    complete = (total > 0).all() & (is_goal.sum() <= capacity)
    return GoalTable(cells, used, cumulated / jnp.maximum(total, 1e-6), complete)


def draw_goals(table: GoalTable, kinds: jax.Array, seed: jax.Array) -> jax.Array:
    """Draw one goal slot per agent (int32 [A]), independently and with the odds of its kind.

    `kinds` (int32 [A]) are indices into the cycle. Agent i's goal does not depend on the number of
    agents.
    """
    values = chance.uniform(chance.draw(seed, jnp.arange(kinds.shape[0])))
    per_kind = jax.vmap(lambda odds: jnp.searchsorted(odds, values, side="right"))(table.odds)
    slots = jnp.take_along_axis(per_kind, kinds[None].astype(jnp.int32), axis=0)[0]
    return jnp.minimum(slots, table.cells.shape[0] - 1).astype(jnp.int32)


@shared
def serve(
    remaining_service: Counts, on_goal: Counts, service_time: Counts
) -> tuple[Counts, Counts]:
    """Begin, continue and end services; the one place that has the rule, for both backends.

    An agent that is `on_goal` (bool [A]) after a step by which it drove begins to serve there, for
    `service_time` timesteps (int32 [A]). The task is finished when nothing is left to serve, at
    once where a goal has no service. `remaining_service` (int32 [A]) is 0 while driving. Returns
    what remains after the step and who finished a task (bool [A]).
    """
    serving = remaining_service > 0
    arrived = (remaining_service == 0) & on_goal
    left = arrived * service_time + serving * (remaining_service - 1)
    return left, (arrived | serving) & (left == 0)
