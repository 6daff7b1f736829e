"""The rules of a path, once: what its end costs, how ends are told apart, how it is read back.

Plain operators for both backends, as in `rules`.
"""

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


# The cost and the code of an end.


@shared
def cost_after_goal(distance: Value, next_service: Value) -> Value:
    """Price what follows the current goal: the way to the next one and the service there."""
    return COST_UNIT * (distance + next_service)


@shared
def driving_cost(distance: Value, service_time: Value, after: Value) -> Value:
    """Price what is left at the end of a window, on the way to a goal.

    Args:
        distance: steps still to go.
        service_time: of that goal.
        after: cost of what follows it; 0 on leg 1.
    """
    return COST_UNIT * distance + (COST_UNIT * service_time + after)


@shared
def serving_cost(service_time: Value, elapsed: Value, after: Value) -> Value:
    """Price what is left at the end of a window, while serving for `elapsed` timesteps."""
    left = service_time - elapsed
    return COST_UNIT * left * (left > 0) + after


@shared
def f_cost(cost: Value, conflicts: int, penalty: Value) -> Value:
    """Add the price of the conflicts on the way."""
    return cost + conflicts * penalty


@shared
def driving_end(
    leg: int, conflicts: int, levels: int, row: Value, column: Value, side: int
) -> Value:
    """Give the end of a path in a cell its code, below ``2 * levels * side**2``."""
    return ((leg * levels + conflicts) * side + row) * side + column


@shared
def serving_end(leg: int, conflicts: int, levels: int, elapsed: Value, side: int) -> Value:
    """Give the end of a path in service its code; they follow those of `driving_end`."""
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
def end_key(cost: Value, code: Value, tie_breaker: Value) -> Value:
    """Pack cost and code into one number: the smallest is the best end, ties fall by chance."""
    return (cost << CODE_BITS) | (code ^ tie_breaker)


# Ties between ends.


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
    """Return whether leg 1 began here, by ending the service at the current goal."""
    return (state.elapsed < 0) & (state.leg == 1) & on_first_goal & just_served


@shared
def service_conflict(conflicts: Value, disturbed: Value, fewer_served: Value) -> Value:
    """Return whether the last timestep of a service added a conflict.

    Args:
        conflicts: after it.
        disturbed: another agent has reserved the goal then.
        fewer_served: a path with one conflict less served for one timestep less.
    """
    return (conflicts > 0) & disturbed & fewer_served


@shared
def move_at(rank: int, flipped: Value) -> Value:
    """Name the move to try at each rank: waiting first, so a path drives early and waits late.

    Its own inverse: it also gives the rank of a move.
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
    """Return whether a path can have come from a cell.

    Args:
        same: paths go on from there with as many conflicts.
        fewer: paths go on from there with one conflict less.
        conflicting: the step conflicts.
        cap: this is the last conflict level.
    """
    return (same & ((conflicting == 0) | cap)) | (fewer & conflicting)
