"""A whole run by the negotiated planner in compiled host code."""

from typing import NamedTuple

import numpy as np

from qdenv.native import kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.crew import TIME, Run, drive_window, is_going
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.measure import lacks_room
from qdenv.simulate.mapf.negotiated.numba.queue import draw_order, make_queue
from qdenv.simulate.mapf.negotiated.numba.reservations import (
    Reservations,
    holder,
    make_reservations,
    swapped_with,
)
from qdenv.simulate.mapf.negotiated.numba.rounds import (
    Negotiation,
    Terms,
    negotiate,
)
from qdenv.simulate.mapf.negotiated.numba.states import make_workspace
from qdenv.simulate.mapf.negotiated.records import (
    count_rounds,
    lanes_of,
    penalty_costs,
    planned_ahead,
)
from qdenv.simulate.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulate.mapf.pibt.numba import Rollout, make_rollout, roll_out
from qdenv.simulate.mapf.planner import NOBODY


class Resort(NamedTuple):
    """What agents without a reservation do."""

    rollout: Rollout  # a joint plan without conflicts
    falls: np.ndarray  # bool [A], who follows it
    waiting: np.ndarray  # int64 [A], those who fell and may make others fall
    waits: bool  # whether it is standing still, instead of PIBT's plan


def drive(config: NegotiatedConfig, run: Run, fields: Fields) -> bool:
    """Drive a whole run; returns whether `fields` had room for it (`Planner.drive`)."""
    agents, horizon = run.crew.position.size, run.numbers.horizon
    window = planned_ahead(config, run.crew.paths.shape[1] - 1, horizon)
    penalties, lanes = penalty_costs(config).astype(np.int64), lanes_of(config, agents)
    remembered = window - horizon if config.remember else 0
    plan = Negotiation(
        Terms(penalties, int(count_rounds(config, agents)), remembered),
        make_reservations(run.site, agents, window),
        make_queue(agents, lanes),
        make_workspace(window, config.conflict_levels, int(penalties.max())),
        fields,
    )
    resort = Resort(
        make_rollout(agents, horizon, run.site.free.size),
        np.zeros(agents, np.bool_),
        np.zeros(agents, np.int64),
        config.last_resort == "wait",
    )
    finished: bool = drive_windows(run, plan, resort)
    return finished


@kernel
def drive_windows(run: Run, plan: Negotiation, resort: Resort) -> bool:
    """Plan and drive window after window; returns whether the fields had room for all of them."""
    plans = chance.mix(run.numbers.seed, chance.PLANS)
    while is_going(run):
        seed = chance.mix(plans, run.tally.total[TIME])
        draw_order(plan.queue, run.crew, seed)
        negotiate(run, plan)
        fallen = list_unreserved(plan, resort)
        if fallen:
            if resort.waits:
                stand_still(run, resort)
            else:
                roll_out(run, plan.fields, resort.rollout, seed)
            widen(run, plan.reservations, resort, fallen)
        if lacks_room(plan.fields):
            return False
        adopt(run, plan, resort, fallen > 0)
        drive_window(run)
    return True


@kernel
def list_unreserved(plan: Negotiation, resort: Resort) -> int:
    """List the agents without a whole reserved path; returns how many."""
    count, window = 0, plan.work.mark.shape[0] - 1
    for agent in range(resort.falls.size):
        resort.falls[agent] = plan.reservations.steps[agent] < window
        if resort.falls[agent]:
            resort.waiting[count] = agent
            count += 1
    return count


@kernel
def stand_still(run: Run, resort: Resort) -> None:
    """Let everybody stay, the last resort that congests as PBS does."""
    path = resort.rollout.path
    for agent in range(path.shape[0]):
        for t in range(path.shape[1]):
            path[agent, t] = run.crew.position[agent]


@kernel
def widen(run: Run, reservations: Reservations, resort: Resort, waiting: int) -> None:
    """Let everybody fall, too, whose reserved path meets one of those who fell."""
    path, width = resort.rollout.path, run.site.width
    while waiting > 0:
        waiting -= 1
        agent = resort.waiting[waiting]
        for t in range(path.shape[1] - 1):
            before, after = path[agent, t], path[agent, t + 1]
            waiting = _fall(resort, holder(reservations, after, t), waiting)
            swapped = swapped_with(reservations, before, after, t, width)
            waiting = _fall(resort, swapped, waiting)


@kernel
def _fall(resort: Resort, agent: int, waiting: int) -> int:
    """Let an agent fall who did not yet; returns how many wait then."""
    if agent == NOBODY or resort.falls[agent]:
        return waiting
    resort.falls[agent] = True
    resort.waiting[waiting] = agent
    return waiting + 1


@kernel
def adopt(run: Run, plan: Negotiation, resort: Resort, mixed: bool) -> None:
    """Make what was planned the crew's paths; the last cell is repeated.

    Beyond the horizon the two kinds of path may conflict: that part is forgotten.
    """
    paths, reserved, horizon = run.crew.paths, plan.reservations.path, run.numbers.horizon
    last = horizon if mixed else reserved.shape[1] - 1
    for agent in range(paths.shape[0]):
        for t in range(paths.shape[1]):
            if resort.falls[agent]:
                paths[agent, t] = resort.rollout.path[agent, min(t, horizon)]
            else:
                paths[agent, t] = reserved[agent, min(t, last)]
