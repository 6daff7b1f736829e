"""PIBT in compiled host code: agent by agent, as the algorithm is printed.

The rules are those of `rules`; the result is that of `xla`, bit for bit.
"""

from typing import NamedTuple

import numpy as np

from qdenv.native import kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.crew import TIME, Crew, Run, drive_window, is_going
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.measure import distance, lacks_room
from qdenv.simulate.mapf.host.order import agent_of, ranked, sort
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.pibt import rules
from qdenv.simulate.mapf.planner import NOBODY
from qdenv.simulate.mapf.tasks import serve


class Rollout(NamedTuple):
    """The agents within a rollout of h steps; A agents, N cells."""

    path: np.ndarray  # int64 [A, h + 1], where they go
    stage: np.ndarray  # int64 [A], 0 on the way to the current goal, 1 afterwards
    remaining_service: np.ndarray  # int64 [A], timesteps left to serve
    age: np.ndarray  # int64 [A], timesteps since the last finished task
    order: np.ndarray  # int64 [A], the agents packed with their urgency, the most urgent first
    candidates: np.ndarray  # int64 [A, 5], the cells each may go to, from best to worst
    key: np.ndarray  # int64 [5], what orders the candidates of one agent
    allowed: np.ndarray  # int64 [A], how many of them count
    tried: np.ndarray  # int64 [A], how many were tried
    pusher: np.ndarray  # int64 [A], the agent that pushed it, or `NOBODY`
    # int32 [N], the agent on each cell, or `NOBODY`; so between two steps everywhere
    standing: np.ndarray
    claimant: np.ndarray  # int32 [N], the agent that takes each cell, likewise


def make_rollout(agents: int, horizon: int, cells: int) -> Rollout:
    """Make room for rollouts."""
    path, candidates = (np.zeros((agents, size), np.int64) for size in (horizon + 1, rules.WAYS))
    stage, remaining, age, order, allowed, tried, pusher = np.zeros((7, agents), np.int64)
    standing, claimant = np.full((2, cells), NOBODY, np.int32)
    key = np.zeros(rules.WAYS, np.int64)
    return Rollout(
        path,
        stage,
        remaining,
        age,
        order,
        candidates,
        key,
        allowed,
        tried,
        pusher,
        standing,
        claimant,
    )


def drive(run: Run, fields: Fields) -> bool:
    """Drive a whole run by PIBT; returns whether `fields` had room for it (`Planner.drive`)."""
    rollout = make_rollout(run.crew.position.size, run.numbers.horizon, run.site.free.size)
    finished: bool = drive_windows(run, fields, rollout)
    return finished


@kernel
def drive_windows(run: Run, fields: Fields, rollout: Rollout) -> bool:
    """Plan and drive window after window; returns whether `fields` had room for all of them."""
    while is_going(run):
        plans = chance.mix(run.numbers.seed, chance.PLANS)
        roll_out(run, fields, rollout, chance.mix(plans, run.tally.total[TIME]))
        if lacks_room(fields):
            return False
        adopt(run.crew, rollout)
        drive_window(run)
    return True


@kernel
def adopt(crew: Crew, rollout: Rollout) -> None:
    """Make the rollout everybody's path; afterwards they wait."""
    horizon = rollout.path.shape[1] - 1
    for agent in range(crew.position.size):
        for t in range(crew.paths.shape[1]):
            crew.paths[agent, t] = rollout.path[agent, min(t, horizon)]


@kernel
def roll_out(run: Run, fields: Fields, rollout: Rollout, seed: int) -> None:
    """Find where PIBT drives all agents, as `planner.rollout` does."""
    crew, resort = run.crew, chance.mix(seed, chance.RESORT)
    luck = chance.mix(resort, rules.LUCK)
    for agent in range(crew.position.size):
        rollout.path[agent, 0], rollout.stage[agent] = crew.position[agent], 0
        rollout.remaining_service[agent] = crew.remaining_service[agent]
        rollout.age[agent] = crew.age[agent]
    for t in range(rollout.path.shape[1] - 1):
        noise = chance.mix(resort, rules.NOISE + t)
        for agent in range(crew.position.size):
            fixed = rollout.remaining_service[agent] > 0
            urgency = rules.urgency(fixed, rollout.age[agent], chance.mix(luck, agent))
            rollout.order[agent] = ranked(urgency, agent)
            rollout.standing[rollout.path[agent, t]] = agent
        for agent in range(crew.position.size):
            prefer(run, fields, rollout, agent, t, chance.mix(noise, agent))
        sort(rollout.order)
        push_along(rollout, t)
        for agent in range(crew.position.size):
            serve_goal(run.site, crew, rollout, agent, t)


@kernel
def prefer(run: Run, fields: Fields, rollout: Rollout, agent: int, t: int, bits: int) -> None:
    """Sort the ways of one agent: nearer to the goal, then empty before taken, then luck."""
    cell, slot = rollout.path[agent, t], run.crew.goal[rollout.stage[agent], agent]
    ways = 1 if rollout.remaining_service[agent] > 0 else rules.WAYS
    candidates, keys, count = rollout.candidates, rollout.key, 0
    for way in range(ways):
        other = cell + run.site.steps[way]
        if not run.site.free[other]:
            continue
        taken = way > 0 and rollout.standing[other] != NOBODY
        key = rules.preference(distance(fields, run.site, slot, other), taken, bits, way)
        place = count
        while place > 0 and keys[place - 1] > key:
            keys[place], candidates[agent, place] = keys[place - 1], candidates[agent, place - 1]
            place -= 1
        keys[place], candidates[agent, place] = key, other
        count += 1
    rollout.allowed[agent] = count


@kernel
def serve_goal(site: Site, crew: Crew, rollout: Rollout, agent: int, t: int) -> None:
    """Begin, continue or end an agent's service after its step at `t`."""
    stage = rollout.stage[agent]
    kind = (crew.kind[agent] + stage) % site.service_time.size
    on_goal = rollout.path[agent, t + 1] == site.goals[crew.goal[stage, agent]]
    left, finished = serve(rollout.remaining_service[agent], on_goal, site.service_time[kind])
    rollout.remaining_service[agent] = left
    rollout.age[agent] += 1
    if finished:
        # The goal after the next is not known here: who has done both drives on freely.
        rollout.stage[agent], rollout.age[agent] = 1, 0


@kernel
def push_along(rollout: Rollout, t: int) -> None:
    """Move all agents by one step: the most urgent first, and whoever stands in the way before.

    The recursion of the paper is a chain that each agent leaves towards its pusher.

    Args:
        rollout: with everybody's candidates and order; receives where they go at t + 1.
        t: the timestep.
    """
    path, standing, claimant = rollout.path, rollout.standing, rollout.claimant
    for agent in range(path.shape[0]):
        path[agent, t + 1] = NOBODY
        rollout.tried[agent], rollout.pusher[agent] = 0, NOBODY
    for index in range(path.shape[0]):
        first = agent_of(rollout.order[index])
        agent = first if path[first, t + 1] == NOBODY else NOBODY
        while agent != NOBODY:
            here, behind = path[agent, t], rollout.pusher[agent]
            if rollout.tried[agent] >= rollout.allowed[agent]:
                # Nowhere to go: stay, and let the pusher try on.
                path[agent, t + 1] = here
                claimant[here] = agent
                agent = behind
                continue
            cell = rollout.candidates[agent, rollout.tried[agent]]
            rollout.tried[agent] += 1
            other = standing[cell]
            other_next = path[other, t + 1] if other != NOBODY else NOBODY
            pusher_position = path[behind, t] if behind != NOBODY else NOBODY
            if not rules.is_admissible(cell, here, claimant[cell], other_next, pusher_position):
                continue
            path[agent, t + 1] = cell
            claimant[cell] = agent
            if rules.is_pushed(other, agent, other_next):
                rollout.pusher[other] = agent
                agent = other
            else:
                agent = NOBODY
    for agent in range(path.shape[0]):
        standing[path[agent, t]] = NOBODY
        claimant[path[agent, t + 1]] = NOBODY
