"""All that a search works on, made once for a run."""

from typing import NamedTuple

import numpy as np

from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.pbs.errands import Errands, make_errands
from qdenv.simulate.mapf.pbs.path import Search, make_search
from qdenv.simulate.mapf.pbs.plans import Changes, Plan, make_changes, make_plan
from qdenv.simulate.mapf.pbs.priorities import Priorities, make_priorities
from qdenv.simulate.mapf.pbs.reservations import Reservations, make_reservations

NODES, FAILED, REPLANS, CAMPS, UNSOLVED, WINDOWS = range(6)  # entries of `Workspace.count`
CONFLICTS, WANTED, DEAD_ENDS = range(3)  # entries of `Tree.number`


class Tree(NamedTuple):
    """The branch of the search tree in hand; D nodes deep, K conflicts, A agents."""

    low: np.ndarray  # int32 [D, 2], who is put below whom in each child
    high: np.ndarray  # int32 [D, 2], and who above
    cost: np.ndarray  # int64 [D, 2], the delay of all paths of a child
    # int64 [D, 2, 2], the first of the changes that lead to a child, and one past them
    change: np.ndarray
    clash: np.ndarray  # int64 [D, 2, 2], likewise its conflicts
    base: np.ndarray  # int64 [D, 2], how many changes and conflicts there were before the children
    turn: np.ndarray  # int64 [D, 2], the children in the order in which they are searched
    children: np.ndarray  # int64 [D, 2], how many there are, and how many were entered
    conflict: np.ndarray  # int64 [K], the conflicts of all these nodes
    # bool [A, A], pairs of agents, the smaller number first, that had no feasible child once
    dead_end: np.ndarray
    # int64 [3], how many conflicts are kept, whether room was wanting, and how many dead ends there
    # are
    number: np.ndarray
    best: np.ndarray  # int32 [w + 1, A], the plan whose first conflict was latest
    score: np.ndarray  # int64 [2], the time of that conflict, and the delay of the plan


class Crowd(NamedTuple):
    """Who matters to whom, and who waits to be planned again; A agents."""

    near: np.ndarray  # int32 [A, A], the agents that each may meet within a window
    nears: np.ndarray  # int64 [A], how many they are
    waiting: np.ndarray  # int32 [A], agents to be planned again
    is_waiting: np.ndarray  # bool [A]


class Terms(NamedTuple):
    """The numbers of a search."""

    published: bool  # whether agents without a path stay, and waiting at the start has precedence
    node_limit: int  # most nodes to expand
    horizon: int  # timesteps that will be driven


class Workspace(NamedTuple):
    """Everything at hand."""

    errands: Errands  # what agents have to do
    plan: Plan  # the joint plan
    changes: Changes  # of it
    order: Priorities  # who is above whom
    table: Reservations  # what the agent that is being planned must avoid
    search: Search  # room for its search
    crowd: Crowd  # who may meet whom
    tree: Tree  # the branch in hand
    terms: Terms  # the numbers
    # int64 [6], over all windows: nodes expanded, children that failed, paths planned, agents that
    # stayed against reservations, unsolved windows, windows
    tally: np.ndarray


def make_workspace(agents: int, window: int, site: Site, depth: int, terms: Terms) -> Workspace:
    """Make room for searches.

    Args:
        agents: how many take part.
        window: timesteps planned ahead.
        site: the layout.
        depth: nodes of a branch; changes and conflicts get room in proportion.
        terms: the numbers.
    """
    crowd = Crowd(
        np.empty((agents, agents), np.int32),
        np.zeros(agents, np.int64),
        np.zeros(agents, np.int32),
        np.zeros(agents, np.bool_),
    )
    return Workspace(
        make_errands(agents, site),
        make_plan(agents, window),
        make_changes(CHANGES_PER_NODE * depth + 2 * agents, window),
        make_priorities(agents, depth + 1),
        make_reservations(window, site.free.size),
        make_search(window, site.width),
        crowd,
        _make_tree(agents, window, depth),
        terms,
        np.zeros(6, np.int64),
    )


CHANGES_PER_NODE = 16
CONFLICTS_PER_NODE = 4  # and agent


def _make_tree(agents: int, window: int, depth: int) -> Tree:
    low, high = np.empty((2, depth, 2), np.int32)
    change, clash = np.empty((2, depth, 2, 2), np.int64)
    cost, base, turn, children = np.empty((4, depth, 2), np.int64)
    return Tree(
        low,
        high,
        cost,
        change,
        clash,
        base,
        turn,
        children,
        np.empty((CONFLICTS_PER_NODE * depth + 64) * agents, np.int64),
        np.zeros((agents, agents), np.bool_),
        np.zeros(3, np.int64),
        np.empty((window + 1, agents), np.int32),
        np.zeros(2, np.int64),
    )
