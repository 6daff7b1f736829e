"""The rules of the negotiated planner, once; both backends run these functions as they stand.

In `xla` their arguments are traced arrays, in `numba` machine integers: so a rule is made of
operators alone, without a branch. XLA moves whole sets of cells at once; the host visits one state
after the other, so it asks the rules of moves, ties and turns, and finds the same paths.

A *set* is a word (or words) with one bit per cell, or per timestep served; a *mask* is a set that
is all ones or empty; a *truth* is a bool, or 1 and 0.

An agent looks at a square of cells, E rows and E columns with itself in the middle. It has two
*legs*: 0 on the way to its current goal, 1 on the way to the next one. A path may drive over
reservations of others: each is one (soft) conflict. Conflicts are counted up to a cap, the last of
the *conflict levels*, which stands for all larger numbers. These are the soft obstacles of SIPPS
in MAPF-LNS2 (Li et al. 2022, https://doi.org/10.1609/aaai.v36i9.21266), at a price as in PathFinder
(McMurchie & Ebeling 1995, https://doi.org/10.1145/201310.201328).

What a path costs and how it is read back is in `path_rules`.

The five moves, in the order of every tuple and plane, are those of `qdenv.grid`: wait, right, left,
down, up.
"""

from typing import TypeAlias, TypeVar

import jax

from qdenv.grid import DOWN, LEFT, RIGHT, UP
from qdenv.native import shared
from qdenv.simulate.mapf.planner import NOBODY

_ROUND_TIE_BREAK = 0x5851  # times the round: ties are broken in another way in every round
SWEEPS = 3  # of the greedy choice; an odd number errs towards choosing too few

Value = TypeVar("Value", int, jax.Array)
ByMove: TypeAlias = tuple[Value, Value, Value, Value, Value]


# Reservations.


@shared
def move_plane(change: Value, width: int) -> Value:
    """Number the move that changes a position by `change` on a grid of `width` columns."""
    across = (change == 1) * RIGHT + (change == -1) * LEFT
    return across + (change == width) * DOWN + (change == -width) * UP


@shared
def opposite(move: Value) -> Value:
    """Name the move against a move; waiting has none but itself."""
    return move + (move > 0) * (2 * (move % 2) - 1)


@shared
def steps_conflict(before: Value, after: Value, other_before: Value, other_after: Value) -> Value:
    """Return whether two steps meet in a cell (vertex conflict) or swap their cells."""
    swapped = (after == other_before) & (before == other_after)
    return (after == other_after) | swapped


@shared
def is_swapped(owner_ahead: Value, owner_behind: Value) -> Value:
    """Return whether a step swaps cells with a reserved one.

    Args:
        owner_ahead: who holds, before the step, the cell it enters.
        owner_behind: who holds, after the step, the cell it leaves.
    """
    return (owner_ahead != NOBODY) & (owner_behind == owner_ahead)


@shared
def conflicting_cells(reserved: ByMove[Value]) -> ByMove[Value]:
    """Find the cells where arriving by each move conflicts (five sets).

    Args:
        reserved: the cells occupied after the step, then those that are left by a move to the
            right, left, down, up. Entering one of these against the move is a swap.
    """
    cell, right, left, down, up = reserved
    return cell, cell | left, cell | right, cell | up, cell | down


# One timestep.


@shared
def arrivals(
    moved: ByMove[Value], conflicting: ByMove[Value], traversable: Value
) -> tuple[Value, Value]:
    """Arrive without and with a conflict (two sets).

    Args:
        moved: the cells that paths go on from, shifted by each move.
        conflicting: from `conflicting_cells`.
        traversable: cells without walls.
    """
    wait, right, left, down, up = moved
    at_wait, at_right, at_left, at_down, at_up = conflicting
    clean = (wait & ~at_wait) | (right & ~at_right) | (left & ~at_left)
    clean = clean | (down & ~at_down) | (up & ~at_up)
    clashing = (wait & at_wait) | (right & at_right) | (left & at_left)
    clashing = clashing | (down & at_down) | (up & at_up)
    return clean & traversable, clashing & traversable


@shared
def count_conflict(clean: Value, clashing: Value, fewer_clashing: Value, cap: Value) -> Value:
    """Collect what is reached with some number of conflicts.

    Args:
        clean: reached from this number, without a further conflict.
        clashing: reached from this number, with one more.
        fewer_clashing: reached from the number below, with one more.
        cap: mask, this is the last level: it keeps its own.
    """
    return clean | fewer_clashing | (clashing & cap)


@shared
def continue_service(served: Value, fewer_served: Value, disturbed: Value, cap: Value) -> Value:
    """Serve one timestep more; it conflicts where another agent has reserved the goal.

    Args:
        served: bit e, a path exists that has served for e timesteps.
        fewer_served: the same with one conflict less; empty for none less.
        disturbed: mask, the goal is reserved by another agent now.
        cap: mask, this is the last conflict level.
    """
    longer, fewer = served << 1, fewer_served << 1
    return count_conflict(longer & ~disturbed, longer & disturbed, fewer & disturbed, cap)


@shared
def begin_service(served: Value, arrived: Value) -> Value:
    """Serve from the timestep of arrival on (`arrived` 0 or 1)."""
    return served | arrived


@shared
def has_served(served: Value, timesteps: Value) -> Value:
    """Return whether a path has served for exactly so long (0 or 1)."""
    return (served >> timesteps) & 1


@shared
def expandable(reached: Value, goal: Value, just_served: Value, first_goal: Value) -> Value:
    """Find the cells that paths go on from: a goal is left only after service, on the next leg.

    Args:
        reached: cells reached on this leg.
        goal: the goal of this leg, one bit; empty where it ends no leg.
        just_served: mask, service at the current goal ended now and this is leg 1.
        first_goal: the current goal, one bit.
    """
    return (reached & ~goal) | (just_served & first_goal)


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
    """Return whether a cell lies in a local window of `side` rows and columns."""
    return (row >= 0) & (row < side) & (column >= 0) & (column < side)


@shared
def ends_leg(leg: int, service_time: Value) -> Value:
    """Return whether paths stop at the goal of a leg.

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
