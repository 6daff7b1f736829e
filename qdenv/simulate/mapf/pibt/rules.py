"""The rules of one PIBT step as plain operators: `jax.numpy` traces them, numba compiles them.

They are the conditions in function PIBT of algorithm 1 of Okumura et al. 2022, "Priority
inheritance with backtracking for iterative multi-agent path finding", Artificial Intelligence 310
(https://arxiv.org/abs/1901.11282). Every argument is one integer, `NOBODY` where there is none.
"""

from typing import TypeVar

import jax

from qdenv.native import shared
from qdenv.simulate.mapf.planner import NOBODY

Number = TypeVar("Number", int, jax.Array)

RANKS, TIE_BREAKS = 0, 1  # what is drawn for a rollout; the ties of step t by TIE_BREAKS + t
RANK_BITS, TIE_BITS = 12, 5
_OLDEST = (1 << 17) - 1  # agents that have waited longer are equally urgent


@shared
def urgency(fixed: Number, age: Number, bits: Number) -> Number:
    """Rank agents (smallest first): those that cannot move, the longest without a task, by chance.

    The age counts timesteps since the agent last finished a task; of 32 random bits the first few
    break ties.
    """
    age = age - (age > _OLDEST) * (age - _OLDEST)
    return (1 - fixed) * (((_OLDEST - age) << RANK_BITS) + (bits >> (32 - RANK_BITS)) + 1)


@shared
def preference(to_go: Number, taken: Number, bits: Number, way: Number) -> Number:
    """Rank a way (smallest first): nearer to the goal, then empty before taken, then by chance."""
    tie_break = (bits >> (TIE_BITS * way)) & ((1 << TIE_BITS) - 1)
    return (((to_go << 1) + taken) << TIE_BITS) + tie_break


@shared
def is_admissible(
    cell: Number, position: Number, claimant: Number, other_next: Number, pusher_position: Number
) -> Number:
    """Return True if an agent at `position` may take a candidate cell.

    Not if another one takes it in this step already (a vertex conflict), nor if the agent that
    stands there comes here (a swap), nor if the agent's pusher stands there: it wants to come here.
    """
    return (claimant == NOBODY) & (other_next != position) & (cell != pusher_position)


@shared
def is_pushed(other: Number, agent: Number, other_next: Number) -> Number:
    """Return True if `other`, which stands where `agent` goes, inherits its priority.

    It does if it is another agent that has not decided yet where it goes (`other_next`).
    """
    return (other != NOBODY) & (other != agent) & (other_next == NOBODY)
