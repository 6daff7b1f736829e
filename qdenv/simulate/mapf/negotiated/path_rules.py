"""The codes of the ends of paths, and how a path is read back; for both backends, as `rules`."""

from typing import Generic, NamedTuple

from qdenv.grid import DOWN, LEFT, RIGHT, UP
from qdenv.native import shared
from qdenv.simulate.mapf.negotiated.rules import Value

LEGS = 2
COST_UNIT = 4  # costs are counted in quarters of a timestep
CODE_BITS = 12  # room for the end of a path: leg, conflicts, row, column
CODES = (1 << CODE_BITS) - 1
INFEASIBLE = 2**30  # above the key and the cost of every end
SERVED_BITS = 32  # of the word of timesteps served


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


@shared
def tie_breaker(tie_break: Value) -> Value:
    """Take the random bits that settle ties between ends."""
    return tie_break & CODES


@shared
def is_flipped(tie_break: Value) -> Value:
    """Take the random bit that says whether to look up and down before looking right and left."""
    return (tie_break >> CODE_BITS) & 1


# Reading a path backwards.


@shared
def is_entry(state: PathState[Value], on_first_goal: Value, just_served: Value) -> Value:
    """Return True where leg 1 began here, by ending the service at the current goal."""
    return (state.elapsed < 0) & (state.leg == 1) & on_first_goal & just_served


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
def row_before(row: Value, move: int) -> Value:
    """Find the row from which a move leads to `row`."""
    return row - (move == DOWN) + (move == UP)


@shared
def column_before(column: Value, move: int) -> Value:
    """Find the column from which a move leads to `column`."""
    return column - (move == RIGHT) + (move == LEFT)


@shared
def is_predecessor(same: Value, fewer: Value, conflicting: Value, cap: Value) -> Value:
    """Return True where a path can have come from a cell.

    Paths go on from there with as many conflicts (`same`) or with one less (`fewer`); the step is
    `conflicting`; `cap`, this is the last conflict level.
    """
    return (same & ((conflicting == 0) | cap)) | (fewer & conflicting)
