"""The least cost of getting anywhere in a window, where moves have costs.

What is a bit of a set in `search` is a number here: what the cheapest path has cost so far.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulation.mapf.negotiated import rules
from qdenv.simulation.mapf.negotiated.xla.window import FAR, LocalWindow, conflicting_cells


class LeastCosts(NamedTuple):
    """What the cheapest paths at one timestep have cost, by conflicts (L levels) and leg."""

    cells: jax.Array  # int32 [L, 2, E, E, K], of paths that go on from a cell
    served: jax.Array  # int32 [L, 2, elapsed, K], of paths in service


def start(local: LocalWindow, levels: int) -> LeastCosts:
    """Set what is reached before the first step: the middle, or the service under way."""
    agents, side, middle = local.penalty.shape[0], local.side, local.side // 2
    driving = local.remaining_service == 0
    elapsed = local.service_time[0] - local.remaining_service
    # Standing on the goal is not arriving: the path leaves it like any other cell.
    here = jnp.where(driving, 0, FAR)
    cells = jnp.full((levels, 2, side, side, agents), FAR, jnp.int32)
    serving = ~driving & (jnp.arange(rules.SERVED_BITS)[:, None] == elapsed)
    served = jnp.full((levels, 2, rules.SERVED_BITS, agents), FAR, jnp.int32)
    return LeastCosts(
        cells.at[0, local.leg, middle, middle, jnp.arange(agents)].set(here),
        served.at[0, 0].set(jnp.where(serving, 0, FAR)),
    )


def advance(
    local: LocalWindow, least: LeastCosts, reserved: jax.Array, disturbed: jax.Array
) -> LeastCosts:
    """Take one timestep past its reservations (uint32 [5, E, K]): drive, arrive, serve.

    `disturbed` (uint32 [2, K]) is the mask of goals that another agent has reserved.
    """
    assert local.costs is not None
    clean = conflicting = jnp.full_like(least.cells, FAR)
    moves = zip(local.costs, conflicting_cells(reserved), strict=True)
    for move, (price, taken) in enumerate(moves):
        # Around the border is no way: paths get there in the last step only.
        row, column = rules.cell_before(0, 0, move)
        after = jnp.roll(least.cells + price, (-row, -column), (2, 3))
        is_taken = _cells_of(taken)
        clean = jnp.minimum(clean, jnp.where(is_taken, FAR, after))
        conflicting = jnp.minimum(conflicting, jnp.where(is_taken, after, FAR))
    arrived = jnp.minimum(_by_conflicts(clean, conflicting), FAR)
    arrived = jnp.where(_cells_of(local.traversable), arrived, FAR)
    leg, elapsed, agent = jnp.ogrid[:2, : least.served.shape[2], : least.served.shape[3]]
    longer = least.served + local.staying_cost(leg, elapsed, agent)
    longer = jnp.roll(longer, 1, 2).at[:, :, 0].set(FAR)
    mask = disturbed[:, None] != 0
    served = _by_conflicts(jnp.where(mask, FAR, longer), jnp.where(mask, longer, FAR))
    on_goal = _cells_of(local.goal)
    begun = jnp.where(on_goal, arrived, FAR).min((2, 3))
    served = jnp.minimum(served, FAR).at[:, :, 0].set(begun)
    done = served[:, 0, local.service_time[0], agent[0, 0]]
    cells = jnp.where(on_goal, FAR, arrived)  # a goal is left only after service, on the next leg
    onwards = jnp.where(on_goal[0], done[:, None, None], FAR)
    return LeastCosts(cells.at[:, 1].min(onwards), served)


def _cells_of(words: jax.Array) -> jax.Array:
    """Unpack words (uint32 [..., E, K]) to one truth per cell (bool [..., E, E, K])."""
    column = jnp.arange(words.shape[-2], dtype=jnp.uint32)[:, None]
    return (words[..., None, :] >> column) & 1 == 1


def _by_conflicts(clean: jax.Array, conflicting: jax.Array) -> jax.Array:
    """Give each conflict level its least cost, as `search` gives each its set."""
    below = jnp.concatenate([jnp.full_like(conflicting[:1], FAR), conflicting[:-1]])
    least = jnp.minimum(clean, below)
    return least.at[-1].min(conflicting[-1])
