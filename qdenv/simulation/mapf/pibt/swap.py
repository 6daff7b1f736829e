"""Swap: how agents of PIBT change places where there is no room for two to pass.

Okumura 2023, "Improving LaCAM for scalable eventually optimal multi-agent pathfinding"
(https://arxiv.org/abs/2305.03632), section 4. An agent that can reach its goal only through
another one, which must come the other way, turns its preferences round and pulls the other along,
to where the passage ends.
"""

from typing import Any

from qdenv.grid import NUM_MOVES
from qdenv.native import inlined, kernel
from qdenv.simulation.mapf.host.distances import DistanceFields, distance
from qdenv.simulation.mapf.host.state import HostRun
from qdenv.simulation.mapf.planner import NOBODY, move_of

_Rollout = Any  # `numba.Rollout`, which imports this file


@inlined
def pull(run: HostRun, fields: DistanceFields, rollout: _Rollout, agent: int, t: int) -> None:
    """Before its first try, turn round an agent that must swap, and let its partner follow it.

    Before later ones, take that back. The partner's place is reserved at once: as printed, after
    the chain has moved, others in the chain take it again and again where costs leave no ties.
    """
    here, partner = rollout.path[agent, t], rollout.partner[agent]
    if rollout.num_tried[agent] > 0:
        if partner != NOBODY:
            rollout.path[partner, t + 1] = rollout.claimant[here] = NOBODY
            rollout.partner[agent] = NOBODY
        return
    partner = _find_partner(run, fields, rollout, agent, t)
    if partner == NOBODY:
        return
    if run.grid.costs.size > 0:  # not against a one-way lane
        begin = rollout.path[partner, t]
        if run.grid.costs[move_of(here - begin, run.grid.width), begin] == 0:
            return
    ways, low, high = rollout.candidates[agent], 0, rollout.num_allowed[agent] - 1
    while low < high:
        ways[low], ways[high] = ways[high], ways[low]
        low, high = low + 1, high - 1
    if ways[0] == here:
        ways[0], ways[1] = ways[1], here
    if rollout.path[partner, t + 1] == NOBODY and rollout.claimant[here] == NOBODY:
        rollout.path[partner, t + 1], rollout.claimant[here] = here, partner
        rollout.partner[agent] = partner


@inlined
def _find_partner(
    run: HostRun, fields: DistanceFields, rollout: _Rollout, agent: int, t: int
) -> int:
    """Find the agent to change places with in a passage that has no room for two, if any.

    Either it stands where this one wants to go, or beside this one, which clears the way for it.
    """
    here, first = rollout.path[agent, t], rollout.candidates[agent, 0]
    # Where two ways or more lead on from the cell ahead, as in most places, the agent there can
    # step aside: no swap is needed, and the search for a partner is saved.
    if first == here or _step_back(run, rollout, first, here)[0] > 1:
        return NOBODY
    if not _can_swap(run, rollout, first, here):
        return NOBODY
    ahead = rollout.occupant[first]
    is_free = ahead != NOBODY and rollout.path[ahead, t + 1] == NOBODY
    is_free = is_free and rollout.num_allowed[ahead] > 1
    if is_free and _must_swap(run, fields, rollout, agent, ahead, here, first):
        return ahead
    for move in range(1, NUM_MOVES):
        cell = here + run.grid.steps[move]
        other = rollout.occupant[cell]
        if other == NOBODY or cell == first or rollout.num_allowed[other] < 2:
            continue
        if _must_swap(run, fields, rollout, other, agent, here, first):
            return other
    return NOBODY


@inlined
def _step_back(run: HostRun, rollout: _Rollout, puller: int, pusher: int) -> tuple[int, int]:
    """Return how many ways lead from the puller's cell away from the pusher's, and one of them.

    A dead end that is its occupant's goal is no way.
    """
    ways, back = 0, puller
    for move in range(1, NUM_MOVES):
        cell = puller + run.grid.steps[move]
        if cell == pusher or not run.grid.free[cell]:
            continue
        other = rollout.occupant[cell]
        if other != NOBODY and run.grid.goals[run.goal[rollout.stage[other], other]] == cell:
            exits = 0
            for step in range(1, NUM_MOVES):
                exits += run.grid.free[cell + run.grid.steps[step]]
            if exits == 1:
                continue
        ways, back = ways + 1, cell
    return ways, back


@kernel
def _must_swap(
    run: HostRun,
    fields: DistanceFields,
    rollout: _Rollout,
    pusher: int,
    puller: int,
    behind: int,
    ahead: int,
) -> bool:
    """Return True if the pusher, at `behind`, can reach its goal only past the puller, at `ahead`.

    Both go on along the passage, the puller first, as long as that brings the pusher nearer: it
    ends where the puller can step aside, or wants to go the other way.
    """
    push = run.goal[rollout.stage[pusher], pusher]
    pull = run.goal[rollout.stage[puller], puller]
    while distance(fields, run.grid, push, ahead) < distance(fields, run.grid, push, behind):
        ways, back = _step_back(run, rollout, ahead, behind)
        if ways > 1:
            return False
        if ways == 0:
            break
        behind, ahead = ahead, back
    if distance(fields, run.grid, pull, behind) >= distance(fields, run.grid, pull, ahead):
        return False
    to_go = distance(fields, run.grid, push, behind)
    return to_go == 0 or distance(fields, run.grid, push, ahead) < to_go


@kernel
def _can_swap(run: HostRun, rollout: _Rollout, behind: int, ahead: int) -> bool:
    """Return True if a puller that goes from `ahead`, away from `behind`, finds room to pass."""
    begin = behind
    while ahead != begin:
        ways, back = _step_back(run, rollout, ahead, behind)
        if ways != 1:
            return ways > 1
        behind, ahead = ahead, back
    return False
