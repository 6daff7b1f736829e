"""A whole run by priority-based search in compiled host code."""

import numpy as np

from qdenv.native import kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.crew import TIME, Crew, Run, drive_window, is_going
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.measure import lacks_room
from qdenv.simulate.mapf.pbs.desk import UNSOLVED, WANTED, WINDOWS, Desk, Terms, make_desk
from qdenv.simulate.mapf.pbs.errands import list_errands
from qdenv.simulate.mapf.pbs.fallback import Resort, choose_falls, make_resort
from qdenv.simulate.mapf.pbs.settings import PbsConfig
from qdenv.simulate.mapf.pbs.tree import solve
from qdenv.simulate.mapf.pibt.numba import roll_out

FIRST_DEPTH = 512  # nodes of a branch that there is room for at first
FINISHED, LACKS_FIELDS, LACKS_DEPTH = range(3)  # how driving ended


def drive(config: PbsConfig, run: Run, fields: Fields) -> bool:
    """Drive a whole run; returns whether `fields` had room for it (`Planner.drive`)."""
    agents, horizon = run.crew.position.size, run.numbers.horizon
    terms = Terms(config.rule == "published", config.node_limit, horizon)
    resort = make_resort(agents, horizon, run.site.free.size)
    depth, end = FIRST_DEPTH, LACKS_DEPTH
    while end == LACKS_DEPTH:
        desk = make_desk(agents, run.numbers.window, run.site.free.size, depth, terms)
        end = drive_windows(run, fields, desk, resort)
        depth *= 2
    return bool(end == FINISHED)


@kernel
def drive_windows(run: Run, fields: Fields, desk: Desk, resort: Resort) -> int:
    """Plan and drive window after window, until the end or until something lacks room."""
    plans = chance.mix(run.numbers.seed, chance.PLANS)
    while is_going(run):
        seed = chance.mix(plans, run.tally.total[TIME])
        list_errands(run, fields, desk.errands)
        solved = solve(desk, fields, run.site, chance.mix(seed, chance.TIES))
        if lacks_room(fields):
            return LACKS_FIELDS
        if desk.tree.number[WANTED]:
            return LACKS_DEPTH
        if not solved:
            roll_out(run, fields, resort.rollout, seed)
            if lacks_room(fields):
                return LACKS_FIELDS
            choose_falls(resort, desk.tree.best)
        adopt(run.crew, desk, resort, solved)
        desk.count[WINDOWS] += 1
        desk.count[UNSOLVED] += not solved
        drive_window(run)
    return FINISHED


@kernel
def adopt(crew: Crew, desk: Desk, resort: Resort, solved: bool) -> None:
    """Make what was planned the crew's paths; where a path has ended its last cell is repeated."""
    plan = desk.plan.cell if solved else desk.tree.best
    horizon = resort.rollout.path.shape[1] - 1
    for agent in range(crew.position.size):
        crew.paths[agent, 0] = crew.position[agent]
        for t in range(1, crew.paths.shape[1]):
            if not solved and resort.falls[agent]:
                cell = resort.rollout.path[agent, min(t, horizon)]
            else:
                cell = np.int64(plan[t, agent])
            crew.paths[agent, t] = cell if cell >= 0 else crew.paths[agent, t - 1]
