"""All that priority-based search works on, made once for a run.

Single numbers that kernels change are arrays without a dimension, read and set as ``number[()]``.
A agents, w timesteps, N cells, D nodes of a branch of the search tree.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import move_steps
from qdenv.native import Scalar
from qdenv.simulate.mapf.host.state import GridMap, HostRun
from qdenv.simulate.mapf.pbs.settings import PbsConfig
from qdenv.simulate.mapf.planner import NOBODY

NUM_GOALS = 2  # that are known: the current one and the next
DONE = NUM_GOALS  # the leg of an agent that has served both; legs 0 and 1 lead to a goal
HOLDING = DONE + 1  # added to the leg while an agent stays at its start against all reservations
NO_STATE = -1
FIRST_DEPTH = 512  # nodes of a branch that there are arrays for at first
_CHANGES_PER_NODE = 16
_CONFLICTS_PER_NODE = 4  # and agent

# The numbers of a path: the timestep at which it ends; the first timestep at which nothing binds
# the agent to its start any more; how much longer than the shortest way the path is.
_PATH = np.dtype([("end", np.int32), ("bound", np.int32), ("delay", np.int32)])
# A child of a node: who is put above whom, the delay of all paths together, and the range of the
# changes that lead to it, and of its conflicts (end: one past the last).
_CHILD = np.dtype(
    [("high", np.int32), ("low", np.int32)]
    + [(name, np.int64) for name in ("cost", "first_change", "end_change")]
    + [(name, np.int64) for name in ("first_conflict", "end_conflict")]
)
# A node: number of children, and of those entered; changes and conflicts before the children.
_NODE = np.dtype(
    [(name, np.int64) for name in ("num_children", "num_entered", "num_changes", "num_conflicts")]
)


class Goals(NamedTuple):
    """What the agents have to do; a leg is the way to one goal, and the service there."""

    start: np.ndarray  # int64 [A], where they are
    row: np.ndarray  # int64 [A], of the start
    column: np.ndarray  # int64 [A], of the start
    begin: np.ndarray  # int64 [A], timesteps of the service in progress; until then the agent stays
    goal: np.ndarray  # int64 [2, A], slots of the goals
    cell: np.ndarray  # int64 [2, A], where they are
    service_time: np.ndarray  # int64 [2, A], timesteps to serve there
    between: np.ndarray  # int64 [A], steps from the first goal to the second
    # bool [N], goal cells with a service: an agent that has served both goals may have its next one
    # there, and be held until the service ends
    holds: np.ndarray


class JointPlan(NamedTuple):
    """The joint plan in hand."""

    # int32 [w + 1, A], where they are; after a path's end a number of the agent's own below zero,
    # which is no cell
    cell: np.ndarray
    path: np.ndarray  # `_PATH` [A]
    delay: Scalar  # int64 [], the sum over all paths
    # int32 [A], the timesteps of conflicts of one agent with each other one, a bit each
    hit: np.ndarray


class Changes(NamedTuple):
    """Changes of paths, in the order in which they were made; R of them at most."""

    agent: np.ndarray  # int32 [R]
    cell: np.ndarray  # int32 [R, 2, w + 1], the column of `JointPlan.cell` before and after
    path: np.ndarray  # `_PATH` [R, 2], before and after
    num_changes: Scalar  # int64 []


class PartialOrder(NamedTuple):
    """Who has precedence over whom: the pairs of the branch in hand, as a graph; D pairs."""

    end: np.ndarray  # int32 [2, D], the agent above and the agent below of each pair
    following: np.ndarray  # int32 [2, D], the next pair of the same agent in either direction
    first: np.ndarray  # int32 [2, A], the first pair of each agent in either direction, or `NOBODY`
    num_pairs: Scalar  # int64 []
    mark: np.ndarray  # int64 [2, A], the last walk up, or down, that found an agent
    walk: Scalar  # int64 [], the number of the last walk
    stack: np.ndarray  # int32 [A], agents whose pairs are still to be looked at


class ReservationTable(NamedTuple):
    """What the agent that is planned must avoid."""

    # int32 [w + 1, N], the bits of a cell and above them the search that they belong to: bits of
    # other searches do not count
    entry: np.ndarray
    search: Scalar  # int64 [], the number of this search


class PathSearch(NamedTuple):
    """The arrays of the search of one path, among S states.

    All cells in reach lie in a square around the start, which has P = (2 w + 1)^2 places: so the
    arrays have the same size for all agents, and stay in the cache. A state is a number whose bits
    are, from the lowest, the place, the timestep and the layer: the leg, and `HOLDING` added.
    """

    seen: np.ndarray  # int64 [S], the search that last reached a state
    parent: np.ndarray  # int32 [S], the state before it
    following: np.ndarray  # int32 [S], the next state of the same bucket
    bucket: np.ndarray  # int32 [delays, w + 1], the first state of each bucket
    cells: np.ndarray  # int64 [w + 1], the path found
    search: Scalar  # int64 [], the number of this search
    delay: Scalar  # int64 [], of the states that are expanded, at last of the path found
    offset: np.ndarray  # int64 [P], what leads from the start to the cell at a place
    steps: np.ndarray  # int64 [5], what each move adds to a place: wait, right, left, down, up
    time_bit: int  # the lowest bit of the timestep
    layer_bit: int  # the lowest bit of the layer
    horizon: int  # timesteps that will be driven


class ReplanQueue(NamedTuple):
    """Who matters to whom, and who waits to be planned again."""

    near: np.ndarray  # int32 [A, A], the agents that each may meet within a window
    num_near: np.ndarray  # int64 [A]
    waiting: np.ndarray  # int32 [A], agents to be planned again
    is_waiting: np.ndarray  # bool [A]


class SearchTree(NamedTuple):
    """The branch of the search tree in hand; K conflicts."""

    node: np.ndarray  # `_NODE` [D]
    child: np.ndarray  # `_CHILD` [D, 2]
    order: np.ndarray  # int64 [D, 2], the children in the order in which they are searched
    conflict: np.ndarray  # int64 [K], the conflicts of all these nodes
    num_conflicts: Scalar  # int64 []
    is_full: Scalar  # bool [], the arrays of the tree or of the changes were too small
    # bool [A, A], pairs of agents, the smaller number first, that had no feasible child once
    dead_end: np.ndarray
    num_dead_ends: Scalar  # int64 []
    best: np.ndarray  # int32 [w + 1, A], the plan whose first conflict was latest
    best_time: Scalar  # int64 [], the time of that conflict
    best_delay: Scalar  # int64 [], the delay of that plan


class Workspace(NamedTuple):
    """All of it."""

    goals: Goals  # what agents have to do
    plan: JointPlan  # where they go
    changes: Changes  # of the plan
    order: PartialOrder  # who is above whom
    table: ReservationTable  # what the agent that is being planned must avoid
    search: PathSearch  # the search of its path
    queue: ReplanQueue  # who waits to be planned again
    tree: SearchTree  # the branch in hand
    published: bool  # whether agents without a path stay, and waiting at the start has precedence
    node_limit: int  # most nodes to expand
    num_nodes: Scalar  # int64 [], expanded in all windows
    num_unsolved: Scalar  # int64 [], windows without a solution


def make_workspace(run: HostRun, config: PbsConfig, depth: int) -> Workspace:
    """Make the workspace of a run.

    Args:
        run: gives the layout, the number of agents, window and horizon.
        config: the rule and the limit.
        depth: nodes of a branch; changes and conflicts get arrays in proportion.
    """
    agents, window, grid = run.agents.position.size, run.settings.window, run.grid
    end, following = np.zeros((2, 2, depth + 1), np.int32)
    first, mark = np.full((2, agents), NOBODY, np.int32), np.zeros((2, agents), np.int64)
    order = PartialOrder(
        end, following, first, _number(), mark, _number(), np.zeros(agents, np.int32)
    )
    room = _CHANGES_PER_NODE * depth + 2 * agents
    tree = SearchTree(
        _records(_NODE, depth),
        _records(_CHILD, depth, 2),
        np.empty((depth, 2), np.int64),
        np.empty((_CONFLICTS_PER_NODE * depth + 64) * agents, np.int64),
        _number(),
        np.array(False),
        np.zeros((agents, agents), np.bool_),
        _number(),
        np.empty((window + 1, agents), np.int32),
        _number(),
        _number(),
    )
    return Workspace(
        _make_goals(agents, grid),
        JointPlan(
            np.zeros((window + 1, agents), np.int32),
            _records(_PATH, agents),
            _number(),
            np.zeros(agents, np.int32),
        ),
        Changes(
            np.empty(room, np.int32),
            np.empty((room, 2, window + 1), np.int32),
            _records(_PATH, room, 2),
            _number(),
        ),
        order,
        ReservationTable(np.zeros((window + 1, grid.free.size), np.int32), _number()),
        _make_search(window, grid.width, run.settings.horizon),
        ReplanQueue(
            np.empty((agents, agents), np.int32),
            np.zeros(agents, np.int64),
            np.zeros(agents, np.int32),
            np.zeros(agents, np.bool_),
        ),
        tree,
        config.rule == "published",
        int(config.nodes_per_agent * agents),
        _number(),
        _number(),
    )


def _number() -> np.ndarray:
    """Make a number that kernels can change."""
    return np.zeros((), np.int64)


def _records(kind: np.dtype, *shape: int) -> np.ndarray:
    """Make an array of records."""
    return np.zeros(shape, kind).view(np.recarray)


def _make_goals(agents: int, grid: GridMap) -> Goals:
    """Make the arrays of what agents have to do."""
    start, row, column, begin, between = np.zeros((5, agents), np.int64)
    goal, cell, service_time = np.zeros((3, NUM_GOALS, agents), np.int64)
    likely = np.diff(grid.odds, axis=1, prepend=np.float32(0)) > 0
    holds = np.zeros(grid.free.size, np.bool_)
    holds[grid.goals[likely[grid.service_time > 0].any(axis=0)]] = True
    return Goals(start, row, column, begin, goal, cell, service_time, between, holds)


def _make_search(window: int, width: int, horizon: int) -> PathSearch:
    """Make the arrays of the search of one path in a padded grid of `width` columns."""
    side = 2 * window + 1
    row, column = np.divmod(np.arange(side * side), side)
    time_bit = (side * side).bit_length()
    layer_bit = time_bit + (window + 1).bit_length()
    states = 2 * HOLDING << layer_bit
    parent, following = np.empty((2, states), np.int32)
    # A step can lead away from the goal, which costs two.
    bucket = np.full((2 * window + 3, window + 1), NO_STATE, np.int32)
    return PathSearch(
        np.zeros(states, np.int64),
        parent,
        following,
        bucket,
        np.zeros(window + 1, np.int64),
        _number(),
        _number(),
        (row - window) * width + column - window,
        move_steps(side),
        time_bit,
        layer_bit,
        horizon,
    )
