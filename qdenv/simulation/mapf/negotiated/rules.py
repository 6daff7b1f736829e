"""The rules of the negotiated planner that both backends run as they stand.

In `xla` their arguments are traced arrays, in `numba` machine integers: so a rule is made of
operators alone, without a branch. A *truth* is a bool, or 1 and 0.

An agent looks at a square of cells, E rows and E columns with itself in the middle. It has two
*legs*: 0 on the way to its current goal, 1 on the way to the next one. A path may drive over
reservations of others: each is one (soft) conflict. Conflicts are counted up to a cap, the last of
the *conflict levels*, which stands for all larger numbers.

Tuples and planes have the five moves in the order of `qdenv.grid`: wait, right, left, down, up.
"""

from typing import Generic, NamedTuple, TypeVar

import jax

from qdenv.grid import DOWN, LEFT, RIGHT, UP
from qdenv.native import shared
from qdenv.simulation.mapf.negotiated.settings import COST_UNIT, MOVE_UNIT

# Any odd number that spreads over many bits: its product with the number of the round changes an
# agent's bits, so that ties are broken in another way in every round.
ROUND_TIE_BREAK = 0x5851
SWEEPS = 3  # of the greedy choice; an odd number errs towards choosing too few

LEGS = 2
TIE_BITS = 24  # random bits of an agent in a window
# Room for the end of a path: leg, conflicts, row, column. As many of the random bits settle ties
# between ends; the next one says whether a path looks up and down before right and left.
CODE_BITS = 12
CODES = (1 << CODE_BITS) - 1
INFEASIBLE = 2**30  # above the key and the cost of every end
SERVED_BITS = 32  # of the word of timesteps served

Value = TypeVar("Value", int, jax.Array)


@shared
def find_in_window(cell: Value, position: Value, width: int, window: int) -> tuple[Value, Value]:
    """Find row and column of a cell in the window of an agent at `position`."""
    row = cell // width - position // width + window
    return row, cell % width - position % width + window


@shared
def ends_leg(leg: int, service_time: Value) -> Value:
    """Return True where paths stop at the goal of a leg.

    What follows the next goal is not known: without service there, it is driven over freely.
    """
    return (leg == 0) | (service_time > 0)


@shared
def units(has_costs: Value) -> tuple[Value, Value]:
    """Return the costs of a timestep of service, and of a unit of distance (truth: moves cost)."""
    return COST_UNIT + has_costs * (MOVE_UNIT - COST_UNIT), COST_UNIT - has_costs * (COST_UNIT - 1)


@shared
def random_rank(bits: Value, serving: Value) -> Value:
    """Draw an agent's place in the order (smallest first) from 32 random bits.

    Agents that serve cannot give way: the others had better know of them first.
    """
    return (bits >> 2) + (1 - serving) * (1 << 30)


# The ends of paths.


class PathState(NamedTuple, Generic[Value]):
    """Where a path is while it is read backwards: int32 [K], or numbers of one path."""

    leg: Value  # 0 or 1
    conflicts: Value  # how many there were so far, capped
    row: Value  # in the local window
    column: Value  # in the local window
    elapsed: Value  # timesteps served here; -1 while driving


@shared
def driving_end(
    leg: int, conflicts: int, levels: int, row: Value, column: Value, side: int
) -> Value:
    """Return the code of an end in a cell, below ``2 * levels * side**2``."""
    return ((leg * levels + conflicts) * side + row) * side + column


@shared
def serving_end(leg: int, conflicts: int, levels: int, elapsed: Value, side: int) -> Value:
    """Return the code of an end in service; they follow those of `driving_end`."""
    return LEGS * levels * side * side + (leg * levels + conflicts) * SERVED_BITS + elapsed


@shared
def unpack_end(code: Value, levels: int, side: int) -> PathState[Value]:
    """Read the code of an end; row and column mean nothing while serving."""
    area = side * side
    serving = code >= LEGS * levels * area
    code = code - serving * (LEGS * levels * area)
    size = area + serving * (SERVED_BITS - area)
    block, inside = code // size, code % size
    elapsed = serving * (inside + 1) - 1
    return PathState(block // levels, block % levels, inside // side, inside % side, elapsed)


# Reading a path backwards.


@shared
def service_conflict(conflicts: Value, disturbed: Value, fewer_served: Value) -> Value:
    """Return True where the last timestep of a service added a conflict.

    The goal was `disturbed` by another agent's reservation then, and a path with one conflict less
    had served for one timestep less.
    """
    return (conflicts > 0) & disturbed & fewer_served


@shared
def move_at(rank: int, flipped: Value) -> Value:
    """Return the move to try at a rank, and the rank of a move: it is its own inverse.

    Waiting comes first, so that a path, which is read backwards, drives early and waits late.
    """
    return rank + (rank > 0) * (5 - 2 * rank) * flipped


@shared
def cell_before(row: Value, column: Value, move: int) -> tuple[Value, Value]:
    """Find row and column of the cell from which a move leads to this one."""
    row = row - (move == DOWN) + (move == UP)
    return row, column - (move == RIGHT) + (move == LEFT)


@shared
def is_predecessor(same: Value, fewer: Value, conflicting: Value, cap: Value) -> Value:
    """Return True where a path can have come from a cell.

    Paths go on from there with as many conflicts (`same`) or with one less (`fewer`); the step is
    `conflicting`; `cap`, this is the last conflict level.
    """
    return (same & ((conflicting == 0) | cap)) | (fewer & conflicting)
