"""What each agent has to do in the window that is planned."""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.crew import Run
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.measure import distance
from qdenv.simulate.mapf.host.site import Site

GOALS = 2  # that are known: the current one and the next
DONE = GOALS  # the leg of an agent that has served both; legs 0 and 1 lead to a goal


class Errands(NamedTuple):
    """What A agents have to do; a leg is the way to one goal, and the service there."""

    start: np.ndarray  # int64 [A], where they stand
    row: np.ndarray  # int64 [A], of the start
    column: np.ndarray  # int64 [A], of the start
    begin: np.ndarray  # int64 [A], timesteps of the service in progress; until then the agent stays
    goal: np.ndarray  # int64 [2, A], slots of the goals
    cell: np.ndarray  # int64 [2, A], where they are
    service_time: np.ndarray  # int64 [2, A], timesteps to serve there
    between: np.ndarray  # int64 [A], steps from the first goal to the second
    # bool [N], cells on which some goal asks for service: an agent that has served both goals may
    # find its next one there, and be held until the service ends
    holds: np.ndarray


def make_errands(agents: int, site: Site) -> Errands:
    """Make room for what agents have to do on a layout."""
    start, row, column, begin, between = np.zeros((5, agents), np.int64)
    goal, cell, service_time = np.zeros((3, GOALS, agents), np.int64)
    likely = np.diff(site.odds, axis=1, prepend=np.float32(0)) > 0
    holds = np.zeros(site.free.size, np.bool_)
    holds[site.goals[likely[site.service_time > 0].any(axis=0)]] = True
    return Errands(start, row, column, begin, goal, cell, service_time, between, holds)


@kernel
def list_errands(run: Run, fields: Fields, errands: Errands) -> None:
    """Note what the crew has to do now."""
    site, crew = run.site, run.crew
    kinds = site.service_time.size
    for agent in range(crew.position.size):
        errands.start[agent] = crew.position[agent]
        errands.row[agent] = crew.position[agent] // site.width
        errands.column[agent] = crew.position[agent] % site.width
        errands.begin[agent] = crew.remaining_service[agent]
        for leg in range(GOALS):
            slot = crew.goal[leg, agent]
            errands.goal[leg, agent], errands.cell[leg, agent] = slot, site.goals[slot]
            kind = (crew.kind[agent] + leg) % kinds
            errands.service_time[leg, agent] = site.service_time[kind]
        second = errands.goal[1, agent]
        errands.between[agent] = distance(fields, site, second, errands.cell[0, agent])


@formula
def first_leg(errands: Errands, agent: int) -> int:
    """Find the leg on which an agent sets out: what it serves now is behind it then."""
    return 1 if errands.begin[agent] > 0 else 0


@formula
def to_go(fields: Fields, site: Site, errands: Errands, agent: int, leg: int, cell: int) -> int:
    """Count the steps from a cell to the last known goal, through those before it."""
    if leg == DONE:
        return 0
    steps = distance(fields, site, errands.goal[leg, agent], cell)
    return steps + errands.between[agent] if leg == 0 else steps
