"""All that priority-based search works on, made once for a run.

A agents, w timesteps, N cells, D nodes of a branch of the search tree.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import NUM_MOVES, move_steps
from qdenv.native import Numbers, numbers
from qdenv.simulation.mapf.host.state import HostRun
from qdenv.simulation.mapf.planner import KNOWN, NOBODY
from qdenv.simulation.mapf.settings import PbsConfig

SERVED = KNOWN  # the leg of an agent that has served both known goals; legs 0 and 1 lead to one
HOLDING = SERVED + 1  # added to the leg while an agent stays at its start against all reservations
NO_STATE = -1
FIRST_DEPTH = 512  # nodes of a branch that there are arrays for at first
_CHANGES_PER_NODE = 16
_CONFLICTS_PER_NODE = 4  # and agent

# The numbers of a path: the timestep at which it ends; the first timestep at which nothing binds
# the agent to its start any more; how much longer than the shortest way the path is.
_PATH = "end bound delay"
# A child of a node: the agent that is put above another, the delay of all paths together, and the
# range of the changes that lead to it, and of its conflicts (end: one past the last).
_CHILD = "high low cost first_change end_change first_conflict end_conflict"
# A node: number of children, and of those entered; whether the second is entered first; changes and
# conflicts before the children.
_NODE = "num_children num_entered is_swapped num_changes num_conflicts"


class Goals(NamedTuple):
    """What the agents have to do; a leg is the way to one goal, and the service there."""

    start: np.ndarray  # int64 [A], where they are
    begin: np.ndarray  # int64 [A], timesteps of the service in progress; until then the agent stays
    # int64 [A], the leg on which each sets out: `SERVED` of an idle agent, and 1 until it is at its
    # place; a service in progress is behind it
    leg: np.ndarray
    goal: np.ndarray  # int64 [2, A], slots of the goals
    cell: np.ndarray  # int64 [2, A], where they are
    service_time: np.ndarray  # int64 [2, A], timesteps to serve there
    between: np.ndarray  # int64 [A], steps from the first goal to the second
    # bool [N], goal cells with a service: an agent that has served both goals may have its next one
    # there, and be held until the service ends
    holds: np.ndarray


class JointPlan(NamedTuple):
    """The joint plan in hand, and the changes that led to it in their order; R at most."""

    # int32 [w + 1, A], where they are; after a path's end a number of the agent's own below zero,
    # which is not a cell
    cell: np.ndarray
    path: np.ndarray  # `_PATH` [A]
    # int32 [A], the timesteps of conflicts of one agent with each other one, a bit each
    hit: np.ndarray
    changed: np.ndarray  # int32 [R], the agent of each change
    change_cell: np.ndarray  # int32 [R, 2, w + 1], its cells before and after
    change_path: np.ndarray  # `_PATH` [R, 2], before and after
    numbers: Numbers  # delay, the sum over all paths; changes, how many there are


class PartialOrder(NamedTuple):
    """Which agent precedes which: the pairs of the branch in hand, as a graph; D pairs."""

    end: np.ndarray  # int32 [2, D], the agent above and the agent below of each pair
    following: np.ndarray  # int32 [2, D], the next pair of the same agent in either direction
    first: np.ndarray  # int32 [2, A], the first pair of each agent in either direction, or `NOBODY`
    mark: np.ndarray  # int64 [2, A], the last walk up, or down, that found an agent
    stack: np.ndarray  # int32 [A], agents whose pairs are still to be looked at
    numbers: Numbers  # pairs, how many there are; walk, the number of the last walk


class PathSearch(NamedTuple):
    """The arrays of the search of one path, among S states.

    All cells in reach lie in a square around the start, which has P = (2 w + 1)^2 places: so the
    arrays have the same size for all agents, and stay in the cache. A state is a number whose bits
    are, from the lowest, the place, the timestep and the layer: the leg, and `HOLDING` added.
    """

    # int32 [w + 1, N], what must be avoided: the bits of a cell, and above them the table that they
    # belong to: bits of other tables do not count
    reserved: np.ndarray
    seen: np.ndarray  # int64 [S], the search that last reached a state
    parent: np.ndarray  # int32 [S], the state before it
    following: np.ndarray  # int32 [S], the next state of the same bucket
    bucket: np.ndarray  # int32 [delays, w + 1], the first state of each bucket
    # With costs in place of `following` and `bucket`, else empty; E entries.
    least: np.ndarray  # int64 [S], the least delay at which a state was reached
    entry: np.ndarray  # int32 [E], the state of each entry of the heap
    heap: np.ndarray  # int64 [E], entries that wait, packed with what ranks them
    cells: np.ndarray  # int64 [w + 1], the path found
    offset: np.ndarray  # int64 [P], what leads from the start to the cell at a place
    steps: np.ndarray  # int64 [5], what each move adds to a place: wait, right, left, down, up
    # table and search, the numbers of this table of reservations and of this search; delay, of the
    # states that are expanded, at last of the path found; entries that the heap ever had, and those
    # waiting in it
    numbers: Numbers
    time_bit: int  # the lowest bit of the timestep
    layer_bit: int  # the lowest bit of the layer
    horizon: int  # timesteps that will be driven


class Workspace(NamedTuple):
    """All of it; K conflicts."""

    goals: Goals  # what agents have to do
    plan: JointPlan  # where they go
    order: PartialOrder  # who is above whom
    search: PathSearch  # the search of one path
    # The branch of the search tree in hand.
    node: np.ndarray  # `_NODE` [D]
    child: np.ndarray  # `_CHILD` [D, 2]
    conflict: np.ndarray  # int64 [K], the conflicts of all these nodes
    # bool [A, A], pairs of agents, the smaller number first, that had no feasible child once
    dead_end: np.ndarray
    best: np.ndarray  # int32 [w + 1, A], the plan whose first conflict was latest
    near: np.ndarray  # int32 [A, A], the agents that each may meet within a window
    num_near: np.ndarray  # int64 [A]
    waiting: np.ndarray  # int32 [A], agents to be planned again
    is_waiting: np.ndarray  # bool [A]
    # waiting, how many wait; conflicts, how many there are; is_full, whether the arrays of
    # conflicts, nodes or changes were too small; best_time and best_delay, of the first conflict of
    # the best plan and of that plan; nodes, expanded, and unsolved, of all windows
    numbers: Numbers
    published: bool  # whether agents without a path stay, and waiting at the start has precedence
    node_limit: int  # most nodes to expand


def make_workspace(run: HostRun, config: PbsConfig, depth: int) -> Workspace:
    """Make the workspace of a run; `depth` nodes, changes and conflicts in proportion."""
    window, grid, count = run.settings.window, run.grid, run.position.size
    changes = _CHANGES_PER_NODE * depth + 2 * count
    # Goals with a service; odds are cumulated.
    likely = np.diff(grid.odds, axis=1, prepend=np.float32(0)) > 0
    holds = np.zeros(grid.free.size, np.bool_)
    holds[grid.goals[(likely & (grid.service_time[:-1] > 0)).any(axis=0)]] = True
    return Workspace(
        goals=Goals(
            start=run.position,
            begin=run.remaining_service,
            leg=np.zeros(count, np.int64),
            goal=run.goal,
            cell=np.zeros((2, count), np.int64),
            service_time=np.zeros((2, count), np.int64),
            between=np.zeros(count, np.int64),
            holds=holds,
        ),
        plan=JointPlan(
            cell=np.zeros((window + 1, count), np.int32),
            path=_records(_PATH, count),
            hit=np.zeros(count, np.int32),
            changed=np.empty(changes, np.int32),
            change_cell=np.empty((changes, 2, window + 1), np.int32),
            change_path=_records(_PATH, changes, 2),
            numbers=numbers("delay", "changes"),
        ),
        order=PartialOrder(
            end=np.zeros((2, depth + 1), np.int32),
            following=np.zeros((2, depth + 1), np.int32),
            first=np.full((2, count), NOBODY, np.int32),
            mark=np.zeros((2, count), np.int64),
            stack=np.zeros(count, np.int32),
            numbers=numbers("pairs", "walk"),
        ),
        search=_make_search(run),
        node=_records(_NODE, depth),
        child=_records(_CHILD, depth, 2),
        conflict=np.empty((_CONFLICTS_PER_NODE * depth + 64) * count, np.int64),
        dead_end=np.zeros((count, count), np.bool_),
        best=np.empty((window + 1, count), np.int32),
        near=np.empty((count, count), np.int32),
        num_near=np.zeros(count, np.int64),
        waiting=np.zeros(count, np.int32),
        is_waiting=np.zeros(count, np.bool_),
        numbers=numbers(
            *("waiting", "conflicts", "is_full", "best_time", "best_delay", "nodes", "unsolved")
        ),
        published=config.rule == "published",
        node_limit=int(config.nodes_per_agent * count),
    )


def _records(names: str, *shape: int) -> np.ndarray:
    """Make an array of records of numbers."""
    return np.zeros(shape, [(name, np.int64) for name in names.split()]).view(np.recarray)


def _make_search(run: HostRun) -> PathSearch:
    """Make the arrays of the search of one path."""
    window, grid = run.settings.window, run.grid
    side = 2 * window + 1
    row, column = np.divmod(np.arange(side * side), side)
    time_bit = (side * side).bit_length()
    layer_bit = time_bit + (window + 1).bit_length()
    states = 2 * HOLDING << layer_bit
    costly = states if grid.costs.size > 0 else 0
    return PathSearch(
        reserved=np.zeros((window + 1, grid.free.size), np.int32),
        seen=np.zeros(states, np.int64),
        parent=np.empty(states, np.int32),
        following=np.empty(states, np.int32),
        # A step can lead away from the goal, which costs two.
        bucket=np.full((2 * window + 3, window + 1), NO_STATE, np.int32),
        least=np.empty(costly, np.int64),
        entry=np.empty(NUM_MOVES * costly, np.int32),  # each state is expanded once
        heap=np.empty(NUM_MOVES * costly, np.int64),
        cells=np.zeros(window + 1, np.int64),
        offset=(row - window) * grid.width + column - window,
        steps=move_steps(side),
        numbers=numbers("table", "search", "delay", "entries", "waiting"),
        time_bit=time_bit,
        layer_bit=layer_bit,
        horizon=run.settings.horizon,
    )
