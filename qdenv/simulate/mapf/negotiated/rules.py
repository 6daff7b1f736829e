"""The rules of the negotiated planner that both backends run as they stand.

In `xla` their arguments are traced arrays, in `numba` machine integers: so a rule is made of
operators alone, without a branch. A *truth* is a bool, or 1 and 0.

An agent looks at a square of cells, E rows and E columns with itself in the middle. It has two
*legs*: 0 on the way to its current goal, 1 on the way to the next one. A path may drive over
reservations of others: each is one (soft) conflict. Conflicts are counted up to a cap, the last of
the *conflict levels*, which stands for all larger numbers. These are the soft obstacles of SIPPS
in MAPF-LNS2 (Li et al. 2022, https://doi.org/10.1609/aaai.v36i9.21266), at a price as in PathFinder
(McMurchie & Ebeling 1995, https://doi.org/10.1145/201310.201328).

How a path ends and is read back is in `path_rules`. The five moves, in the order of every tuple and
plane, are those of `qdenv.grid`: wait, right, left, down, up.
"""

from typing import TypeVar

import jax

from qdenv.grid import DOWN, LEFT, RIGHT, UP
from qdenv.native import shared

# Any odd number that spreads over many bits: ties are broken in another way in every round.
_ROUND_TIE_BREAK = 0x5851
SWEEPS = 3  # of the greedy choice; an odd number errs towards choosing too few

Value = TypeVar("Value", int, jax.Array)


# Reservations.


@shared
def move_plane(change: Value, width: int) -> Value:
    """Number the move that changes a position by `change` on a grid of `width` columns."""
    across = (change == 1) * RIGHT + (change == -1) * LEFT
    return across + (change == width) * DOWN + (change == -width) * UP


@shared
def opposite(move: Value) -> Value:
    """Return the move against a move; waiting has none but itself."""
    return move + (move > 0) * (2 * (move % 2) - 1)


@shared
def steps_conflict(before: Value, after: Value, other_before: Value, other_after: Value) -> Value:
    """Return True where two steps meet in a cell (vertex conflict) or swap their cells."""
    swapped = (after == other_before) & (before == other_after)
    return (after == other_after) | swapped


@shared
def has_served(served: Value, timesteps: Value) -> Value:
    """Return 1 where a path has served for exactly this many timesteps, one bit each, else 0."""
    return (served >> timesteps) & 1


# The local window.


@shared
def goal_row(cell: Value, position: Value, width: int, window: int) -> Value:
    """Find the row of a cell in the window of an agent at `position`."""
    return cell // width - position // width + window


@shared
def goal_column(cell: Value, position: Value, width: int, window: int) -> Value:
    """Find the column of a cell in the window of an agent at `position`."""
    return cell % width - position % width + window


@shared
def is_visible(row: Value, column: Value, side: int) -> Value:
    """Return True where a cell lies in a local window of `side` rows and columns."""
    return (row >= 0) & (row < side) & (column >= 0) & (column < side)


@shared
def ends_leg(leg: int, service_time: Value) -> Value:
    """Return True where paths stop at the goal of a leg.

    What follows the next goal is not known: without service there, it is driven over freely.
    """
    return (leg == 0) | (service_time > 0)


# Ties and turns.


@shared
def random_rank(bits: Value, serving: Value) -> Value:
    """Draw an agent's place in the order (smallest first) from 32 random bits.

    Agents that serve cannot give way: the others had better know of them first.
    """
    return (bits >> 2) + (1 - serving) * (1 << 30)


@shared
def tie_break_of(bits: Value) -> Value:
    """Take an agent's random bits of a window."""
    return bits >> 8


@shared
def tie_break_of_round(tie_break: Value, turn: Value) -> Value:
    """Change an agent's random bits from round to round."""
    return tie_break ^ (turn * _ROUND_TIE_BREAK)


@shared
def urgency(order: Value, attempts: Value, agents: int) -> Value:
    """Rank agents: the fewer attempts the earlier, then by lot (smallest first)."""
    return attempts * agents + order


@shared
def penalty_index(attempts: Value, count: int) -> Value:
    """Find the penalty of an attempt among `count` of them; the last serves all further ones."""
    return attempts - (attempts >= count) * (attempts - (count - 1))
