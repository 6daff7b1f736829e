"""A whole run by priority-based search in compiled host code."""

import numpy as np

from qdenv.native import kernel
from qdenv.simulate.mapf import chance
from qdenv.simulate.mapf.host.crew import TIME, Crew, Run, drive_window, is_going
from qdenv.simulate.mapf.host.fields import Fields
from qdenv.simulate.mapf.host.measure import lacks_room
from qdenv.simulate.mapf.pbs.errands import list_errands
from qdenv.simulate.mapf.pbs.fallback import Resort, choose_falls, make_resort
from qdenv.simulate.mapf.pbs.settings import PbsConfig
from qdenv.simulate.mapf.pbs.tree import solve
from qdenv.simulate.mapf.pbs.workspace import (
    UNSOLVED,
    WANTED,
    WINDOWS,
    Terms,
    Workspace,
    make_workspace,
)
from qdenv.simulate.mapf.pibt.numba import roll_out

FIRST_DEPTH = 512  # nodes of a branch that there is room for at first
FINISHED, LACKS_FIELDS, LACKS_DEPTH = range(3)  # how driving ended


def drive(config: PbsConfig, run: Run, fields: Fields) -> bool:
    """Drive a whole run; returns whether `fields` had room for it (`Planner.drive`)."""
    agents, horizon = run.crew.position.size, run.numbers.horizon
    nodes = int(config.nodes_per_agent * agents)
    terms = Terms(config.rule == "published", nodes, horizon)
    resort = make_resort(agents, horizon, run.site.free.size)
    depth, end = FIRST_DEPTH, LACKS_DEPTH
    while end == LACKS_DEPTH:
        work = make_workspace(agents, run.numbers.window, run.site.free.size, depth, terms)
        end = drive_windows(run, fields, work, resort)
        depth *= 2
    return bool(end == FINISHED)


@kernel
def drive_windows(run: Run, fields: Fields, work: Workspace, resort: Resort) -> int:
    """Plan and drive window after window, until the end or until something lacks room."""
    plans = chance.mix(run.numbers.seed, chance.PLANS)
    while is_going(run):
        seed = chance.mix(plans, run.tally.total[TIME])
        list_errands(run, fields, work.errands)
        solved = solve(work, fields, run.site, chance.mix(seed, chance.TIES))
        if lacks_room(fields):
            return LACKS_FIELDS
        if work.tree.number[WANTED]:
            return LACKS_DEPTH
        if not solved:
            roll_out(run, fields, resort.rollout, seed)
            if lacks_room(fields):
                return LACKS_FIELDS
            choose_falls(resort, work.tree.best)
        adopt(run.crew, work, resort, solved)
        work.tally[WINDOWS] += 1
        work.tally[UNSOLVED] += not solved
        drive_window(run)
    return FINISHED


@kernel
def adopt(crew: Crew, work: Workspace, resort: Resort, solved: bool) -> None:
    """Make what was planned the crew's paths; where a path has ended its last cell is repeated."""
    plan = work.plan.cell if solved else work.tree.best
    horizon = resort.rollout.path.shape[1] - 1
    for agent in range(crew.position.size):
        crew.paths[agent, 0] = crew.position[agent]
        for t in range(1, crew.paths.shape[1]):
            if not solved and resort.falls[agent]:
                cell = resort.rollout.path[agent, min(t, horizon)]
            else:
                cell = np.int64(plan[t, agent])
            crew.paths[agent, t] = cell if cell >= 0 else crew.paths[agent, t - 1]
