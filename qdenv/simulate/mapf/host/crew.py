"""The agents of one run in compiled host code: `agents` and `metrics`, number for number."""

from typing import NamedTuple

import numpy as np

from qdenv.native import kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.site import Site
from qdenv.simulate.mapf.padding import unpad
from qdenv.simulate.mapf.tasks import KNOWN, serve

TIME, CONGESTED, MOVES = range(3)  # entries of `Tally.total`


class Crew(NamedTuple):
    """The agents that take part, between two windows; A of them, w steps planned ahead."""

    position: np.ndarray  # int64 [A]
    kind: np.ndarray  # int64 [A], the current goal's place in the cycle
    goal: np.ndarray  # int64 [2, A], slots of the current and the next goal
    remaining_service: np.ndarray  # int64 [A], timesteps still to serve
    age: np.ndarray  # int64 [A], timesteps since the last finished task
    legs: np.ndarray  # int64 [A], tasks finished since all were planned
    paths: np.ndarray  # int64 [A, w + 1], the plan from here on
    stuck: np.ndarray  # bool [A], whether the agent neither moved nor served in this window


class Numbers(NamedTuple):
    """The numbers of a run."""

    seed: int  # of all that is drawn
    timesteps: int  # T
    window: int  # timesteps planned ahead (w)
    horizon: int  # timesteps driven before planning again (h)
    stop_when_congested: bool  # whether the first congested window ends the run


class Tally(NamedTuple):
    """What was counted so far, see `metrics.Metrics`; T is rounded up to whole windows."""

    # int64 [3], timesteps driven, those when the first congested window ended, moves
    total: np.ndarray
    finished: np.ndarray  # int32 [T], tasks finished at each timestep
    visits: np.ndarray  # int32 [N], agent-steps on each cell


class Tape(NamedTuple):
    """Every driven step, see `metrics.Block`; [T, A], or without rows where nothing is kept."""

    positions: np.ndarray
    remaining_service: np.ndarray
    finished: np.ndarray
    goals: np.ndarray


class Run(NamedTuple):
    """One run under way, as planners see it."""

    site: Site  # the layout
    crew: Crew  # the agents
    tally: Tally  # what was counted
    tape: Tape  # what was recorded
    numbers: Numbers  # of the run


def place(run: Run) -> None:
    """Put the agents on distinct free cells and draw their first goals."""
    site, crew, seed = run.site, run.crew, run.numbers.seed
    count, cells = crew.position.size, np.flatnonzero(site.free)
    numbers = unpad(cells, site.width - 2 * site.margin, site.margin)
    luck = chance.draw_on_host(chance.draw_on_host(seed, chance.STARTS), numbers) >> 1
    crew.position[:] = cells[np.argsort(-luck.astype(int), kind="stable")[:count]]
    crew.paths[:] = crew.position[:, None]
    for ahead, purpose in enumerate((chance.FIRST_GOAL, chance.SECOND_GOAL)):
        bits = chance.draw_on_host(chance.draw_on_host(seed, purpose), np.arange(count))
        odds = site.odds[ahead % site.service_time.size]
        drawn = np.searchsorted(odds, _chance_of(bits), side="right")
        crew.goal[ahead] = np.minimum(drawn, site.goals.size - 1)


def _chance_of(bits: np.ndarray) -> np.ndarray:
    """Turn bits into chances, as `chance.uniform` does."""
    whole = (bits >> (32 - chance.CHANCE_BITS)).astype(np.float32)
    return whole * np.float32(2.0**-chance.CHANCE_BITS)


@kernel
def _draw_goal(site: Site, kind: int, bits: int) -> int:
    """Draw a goal of a kind with its odds, as `tasks.draw_goals` does."""
    low, high = 0, site.goals.size
    value = np.float32(bits >> (32 - chance.CHANCE_BITS)) * np.float32(2.0**-chance.CHANCE_BITS)
    while low < high:
        middle = (low + high) // 2
        if site.odds[kind, middle] <= value:
            low = middle + 1
        else:
            high = middle
    return min(low, site.goals.size - 1)


@kernel
def is_going(run: Run) -> bool:
    """Tell whether there is another window to drive."""
    halted = run.tally.total[CONGESTED] != 0 and run.numbers.stop_when_congested
    return run.tally.total[TIME] < run.numbers.timesteps and not halted


@kernel
def drive_window(run: Run) -> None:
    """Drive the first steps of the crew's paths; count, record and look for a jam."""
    crew, tally, horizon = run.crew, run.tally, run.numbers.horizon
    begin, count, stuck = tally.total[TIME], crew.position.size, 0
    goals = chance.mix(run.numbers.seed, chance.GOALS)
    for agent in range(count):
        crew.stuck[agent], crew.legs[agent] = True, 0
    for step in range(horizon):
        drawn = chance.mix(goals, begin + step)
        for agent in range(count):
            _drive(run, agent, step, drawn)
    for agent in range(count):
        stuck += crew.stuck[agent]
        _shift_path(crew, agent, horizon)
    # A window that T cuts short is no window of the jam rule.
    jam = begin + horizon <= run.numbers.timesteps and stuck > count // 2
    if jam and tally.total[CONGESTED] == 0:
        tally.total[CONGESTED] = begin + horizon
    tally.total[TIME] = min(begin + horizon, run.numbers.timesteps)


@kernel
def _drive(run: Run, agent: int, step: int, drawn: int) -> None:
    """Move one agent by one step of its path and serve its goal, as `agents.drive` does."""
    site, crew, tally = run.site, run.crew, run.tally
    time = tally.total[TIME] + step
    cell, goal = crew.paths[agent, step + 1], site.goals[crew.goal[0, agent]]
    moves = cell != crew.position[agent]
    if time < run.numbers.timesteps:
        tally.visits[cell] += 1
        tally.total[MOVES] += moves
    # Stuck: the same cell at all timesteps of the window but the last, and never serving.
    if (moves and step < run.numbers.horizon - 1) or crew.remaining_service[agent] > 0:
        crew.stuck[agent] = False
    crew.position[agent] = cell
    kind = crew.kind[agent]
    service_time = site.service_time[kind]
    known = crew.legs[agent] < KNOWN or service_time == 0
    on_goal = cell == goal and known
    left, finished = serve(crew.remaining_service[agent], on_goal, service_time)
    crew.remaining_service[agent] = left
    crew.age[agent] += 1
    if run.tape.positions.size:
        run.tape.positions[time, agent] = cell
        run.tape.remaining_service[time, agent] = left
        run.tape.finished[time, agent] = finished
        run.tape.goals[time, agent] = goal
    if finished:
        kind = (kind + 1) % site.service_time.size
        coming = (kind + 1) % site.service_time.size
        crew.kind[agent], crew.age[agent] = kind, 0
        crew.legs[agent] += 1
        crew.goal[0, agent] = crew.goal[1, agent]
        crew.goal[1, agent] = _draw_goal(site, coming, chance.mix(drawn, agent))
        if time < run.numbers.timesteps:
            tally.finished[time] += 1


@kernel
def _shift_path(crew: Crew, agent: int, horizon: int) -> None:
    """Keep what is left of a path; its last cell is repeated."""
    last = crew.paths.shape[1] - 1
    for step in range(last + 1):
        crew.paths[agent, step] = crew.paths[agent, min(step + horizon, last)]
