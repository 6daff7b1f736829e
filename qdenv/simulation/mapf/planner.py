"""What a planner gets, gives and understands: the world and its goals, the agents, the limits.

A planner gives every agent a path of `window` steps, of which the next `horizon` are driven before
it plans again (RHCR, Li et al. 2021, https://arxiv.org/abs/2005.07371). Those must obey the
movement rules (`qdenv.simulation`); the rest is a plan the planner gets back.

A layout of `cols` columns, surrounded by `margin` walls on each side, makes the padded grid. Both
number their cells ``row * width + column``, each with its own width.

A planner is chosen by the type of its settings: `PLANNERS.make(settings)` gives a `Planner`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import flax.struct
import jax
import jax.numpy as jnp
import numpy as np

from qdenv.grid import DOWN, LEFT, RIGHT, UP, of_tiles
from qdenv.native import shared
from qdenv.simulation.mapf import chance
from qdenv.types import Array, TaskRule

Counts = TypeVar("Counts", int, jax.Array)

KNOWN = 2  # goals that planners know of each agent: the current and the next
NOBODY = -1  # in place of an agent's number
NEAR = 2  # cells from its place at which an idle agent waits where it is
UNREACHABLE = 32_000  # steps to where no way leads, on grids of at most this many cells
_UNREACHABLE_AFAR = 1 << 20  # the same on larger ones, of a thousand rows and columns at most
UNREACHABLE_COST = 1 << 23  # the same where moves have costs; twice as much is what PIBT can rank


def distance_type(
    cells: int, has_costs: bool = False
) -> tuple[type[np.int16] | type[np.int32], int]:
    """Return the type of distances on a grid of this many cells, and the number for no way.

    No way is longer than the grid, where no move has a cost of its own.
    """
    if has_costs:
        return np.int32, UNREACHABLE_COST
    return (np.int16, UNREACHABLE) if cells <= UNREACHABLE else (np.int32, _UNREACHABLE_AFAR)


class GoalTable(NamedTuple):
    """The goals of one layout; G is the goal capacity, n the number of kinds in the cycle."""

    cells: jax.Array  # int32 [G], the goal cells in row-major order; unused slots hold 0
    used: jax.Array  # bool [G]
    odds: jax.Array  # float32 [n, G], cumulated odds of each slot within its kind, ending in 1
    # int32 [n + 1, G], timesteps served at each slot by its kind; an idle agent, of kind n, serves
    # nowhere
    service_time: jax.Array
    complete: jax.Array  # bool, every kind has a goal and no goal was left out for want of slots


@flax.struct.dataclass
class World:
    """One layout made ready to be simulated, shared by all its runs, on the padded grid."""

    traversable: jax.Array  # bool [H', W'], cells agents may drive on
    goals: GoalTable  # the goal table; its cells are positions of the padded grid
    # [G, H' * W'], steps from every cell to every goal, see `distance_type`; None where they are
    # measured on demand
    distance: jax.Array | None
    valid: jax.Array  # bool, agents and goals fit the layout
    # rows and columns of walls on each side, so that planners look around without testing for the
    # border; compile-time
    margin: int = flax.struct.field(pytree_node=False)
    # int32 [5, H' * W'], the cost of each move at each cell (`guidance.fixed_costs`), 0 where it is
    # not allowed; None where every move costs one step. With costs, distances are sums of them.
    costs: jax.Array | None = None
    # int32 [K], odds of orders per timestep (`chance.poisson`); None where work never runs out
    orders: jax.Array | None = None


class AgentState(NamedTuple):
    """Where the agents are and where they go."""

    position: jax.Array  # int32 [A]. Padding agents are somewhere too, but do not count.
    active: jax.Array  # bool [A], False for padding
    goal: jax.Array  # int32 [2, A], slots of the current and of the next goal
    service_time: jax.Array  # int32 [2, A], timesteps to serve at each of them
    # int32 [A], timesteps the agent must still remain on its goal; 0 while driving
    remaining_service: jax.Array
    age: jax.Array  # int32 [A], timesteps since the agent last finished a task
    # int32 [window + 1, A], the last paths from here on; their last cell is repeated
    previous: jax.Array
    distance: jax.Array  # [rows, H' * W'], steps from every cell to some goals, see `distance_type`
    row: jax.Array  # int32 [2, A], the rows of `distance` that belong to `goal`
    # int32 [A], which of the two goals the agent heads for; 1 while it is idle, when both are one
    # cell, where it may stay
    leg: jax.Array | int = 0


class Planner(NamedTuple):
    """A planner and its limits."""

    # (world, state, horizon, key) -> paths int32 [window + 1, A]; traceable, consumes the key. The
    # window is the length of ``state.previous`` less one. None where a planner drives whole runs
    # only.
    plan: Callable[[World, AgentState, int, jax.Array], jax.Array] | None
    max_window: int = 1000  # most timesteps it plans ahead
    max_service: int = 1000  # longest service at a goal that it understands
    margin: int = 1  # rows and columns of walls that it needs around the grid, at least 1
    # from `host.run.compile_windows`: whole runs in compiled host code instead of `plan`
    run_windows: Callable[..., int] | None = None
    # (run, size) -> what those work on; the size is 1, and doubled when that is too small
    make_plan: Callable[[Any, int], Any] = lambda run, size: None
    fallback_waits: bool = False  # whether agents without a path stand still instead of PIBT's plan
    fallback_swaps: bool = False  # whether PIBT's plan lets agents change places in passages
    reads_costs: bool = False  # whether it drives by the costs of a world that has some

    @property
    def on_host(self) -> bool:
        """Whether runs are computed by compiled host code instead of XLA."""
        return self.run_windows is not None


def goal_table(layout: Array, rule: TaskRule, capacity: int) -> GoalTable:
    """List the goals of `layout` (int8 [H, W]) in `capacity` slots.

    Where tasks arrive at a rate, idle agents wait anywhere: all free cells are goals, most of them
    without odds.
    """
    weights = jnp.stack([goal.weight(layout).reshape(-1) for goal in rule.cycle])
    weights = weights.astype(jnp.float32)
    is_goal = (weights > 0).any(0)
    if rule.rate:
        is_goal |= of_tiles(layout, rule.traversable, rule.tiles).reshape(-1)
    cells = jnp.nonzero(is_goal, size=capacity, fill_value=0)[0].astype(jnp.int32)
    used = jnp.arange(capacity) < is_goal.sum()
    cumulated = jnp.cumsum(jnp.where(used, weights[:, cells], 0.0), axis=1)
    total = cumulated[:, -1:]
    complete = (total > 0).all() & (is_goal.sum() <= capacity)
    stays = [jnp.asarray(goal.stays(layout)).reshape(-1) for goal in rule.cycle]
    stays.append(jnp.zeros_like(stays[0]))
    service_time = jnp.stack(stays).astype(jnp.int32)[:, cells]
    odds = cumulated / jnp.where(total > 0, total, 1.0)
    return GoalTable(cells, used, odds, service_time, complete)


def draw_goals(table: GoalTable, kinds: jax.Array, seed: jax.Array) -> jax.Array:
    """Draw one goal slot per agent (int32 [A]), independently and with the odds of its kind.

    `kinds` (int32 [A]) are indices into the cycle. Agent i's goal does not depend on the number of
    agents.
    """
    bits = chance.draw(seed, jnp.arange(kinds.shape[0])) >> (32 - chance.CHANCE_BITS)
    values = bits.astype(jnp.float32) * 2.0**-chance.CHANCE_BITS  # in [0, 1)
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


@shared
def next_kind(kind: Counts, cycle: int) -> Counts:
    """Return the kind of goal after one of `cycle` kinds; an idle agent remains idle."""
    return (kind + 1) % cycle * (kind < cycle) + cycle * (kind == cycle)


@shared
def move_of(change: Counts, width: int) -> Counts:
    """Number the move that changes a position by `change` on a padded grid of `width` columns."""
    across = (change == 1) * RIGHT + (change == -1) * LEFT
    return across + (change == width) * DOWN + (change == -width) * UP
