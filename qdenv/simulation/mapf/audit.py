"""An independent check of a recorded run, in plain numpy.

It shares no code with the simulator but the goals' weights and stays. It walks through the
trajectory once and works out by itself what must have happened: arrivals, services, finished tasks,
jams. It names the first breach of each rule of movement, what is wrong with tasks at each timestep,
and numbers that disagree, but no lengths of paths and no waiting of orders.
"""

import numpy as np

from qdenv.io.trajectories import Trajectories
from qdenv.simulation.mapf.metrics import Recording
from qdenv.types import TaskRule, Traffic


def audit(
    layout: np.ndarray, rule: TaskRule, recording: Recording, traffic: Traffic, horizon: int = 5
) -> list[str]:
    """Find what a run on a layout (int8 [H, W]), or its report, has wrong by the rules.

    All agents are planned again every `horizon` timesteps, the windows of the jam rule. Returns
    messages, those on movement with the timestep; none when all is well.
    """
    layout, end = np.asarray(layout), int(traffic.end_timestep)
    parts = recording.positions, recording.goals, recording.finished
    driven = (np.asarray(part)[: end + 1, np.asarray(recording.active)] for part in parts)
    positions, goals, credited = driven
    positions = positions.astype(np.int64)
    broken = check_moves(layout, rule, positions)
    finished, working, more = replay_tasks(layout, rule, positions, goals, credited[:end], horizon)
    broken += more
    # The reported figures against figures counted again; they are float32.
    counts = np.zeros(len(np.asarray(traffic.finished)), int)
    counts[:end] = finished.sum(1)
    visits = np.bincount(positions[1:].reshape(-1), minlength=layout.size).reshape(layout.shape)
    usage, idle = visits / visits.sum(), goals < 0
    off = {
        "finished tasks per timestep": (counts != np.asarray(traffic.finished)).any(),
        "throughput": abs(float(traffic.throughput) - counts.mean()) > 1e-5,
        "tile usage": not np.allclose(np.asarray(traffic.usage), usage, atol=1e-6),
        "waiting": abs(float(traffic.waiting) - (positions[1:] == positions[:-1]).mean()) > 1e-5,
        "idle time": rule.rate and abs(np.asarray(traffic.idle) - idle[:end].mean()) > 1e-5,
    }
    broken += [f"{figure}: not what is counted again" for figure, wrong in off.items() if wrong]
    jams = jammed_windows(positions, working | idle, horizon)
    if bool(traffic.congested) != bool(jams):
        broken.append(f"jams at {jams}, but congested is {bool(traffic.congested)}")
    elif jams[:1] != [int(traffic.congested_at)][: len(jams)]:
        broken.append(f"jams at {jams}, but congested at {int(traffic.congested_at)}")
    return broken


def check_run(layout: np.ndarray, rule: TaskRule, run: Trajectories) -> tuple[list[str], int]:
    """Check a run read from a file on a layout (int8 [H, W]): its moves, and what it reached.

    Returns messages as `audit` does, and the number of tasks that were finished.
    """
    inside = ((run.cells >= 0) & (run.cells < layout.shape)).all(axis=-1)
    positions = np.where(inside, run.cells @ [layout.shape[1], 1], -1)
    broken, done = check_moves(layout, rule, positions), set()
    for time, robot, place, task, last in sorted(run.errands):
        what = f"t={time}: robot {robot} finishes task {task}"
        if not (0 <= time < len(run.cells) and 0 <= robot < run.cells.shape[1]):
            broken.append(f"{what}, and the run has no such time or robot")
        elif tuple(run.cells[time, robot]) != place:
            here = tuple(run.cells[time, robot].tolist())
            broken.append(f"{what} at {here}, and its goal is {place}")
        elif last and task in done:
            broken.append(f"{what} for a second time")
        elif last:
            done.add(task)
    if run.finished not in (None, len(done)):
        broken.append(f"the file states {run.finished} finished tasks, its events show {len(done)}")
    return broken, len(done)


def check_moves(layout: np.ndarray, rule: TaskRule, positions: np.ndarray) -> list[str]:
    """Check cells, steps, vertex conflicts and swaps (positions int [t + 1, A])."""
    cells, width = layout.size, layout.shape[1]
    free = np.isin(layout, [rule.tiles.index(tile) for tile in rule.traversable]).reshape(-1)

    def at(cell: int) -> tuple[int, int]:  # row and column
        return int(cell) // width, int(cell) % width

    outside = (positions < 0) | (positions >= cells)
    if outside.any():
        return [_at("is outside the layout", outside)]
    broken = []
    for time, agent in np.argwhere(~free[positions])[:1]:
        here = at(positions[time, agent])
        broken.append(f"t={time}: agent {agent} stands on an obstacle at {here}")
    ordered = np.sort(positions, axis=1)
    shared = np.argwhere(ordered[:, 1:] == ordered[:, :-1])
    for time, index in shared[:1]:
        both = np.flatnonzero(positions[time] == ordered[time, index])[:2]
        names = " and ".join(map(str, both))
        broken.append(f"t={time}: two agents on cell {at(ordered[time, index])}: {names}")
    before, after = positions[:-1], positions[1:]
    steps = np.abs(before // width - after // width) + np.abs(before % width - after % width)
    if (steps > 1).any():
        broken.append(_at("makes more than one step at once", steps > 1))
    moved = steps > 0
    time = np.broadcast_to(np.arange(len(before))[:, None], before.shape)[moved]
    there = (time * cells + before[moved]) * cells + after[moved]
    back = (time * cells + after[moved]) * cells + before[moved]
    # No edge is driven twice where no cell holds two agents; sorting out doubles takes long.
    for edge in np.intersect1d(there, back, assume_unique=not len(shared))[:1]:
        places = f"{at(edge % cells)} and {at(edge // cells % cells)}"
        broken.append(f"t={edge // cells**2}: agents swap cells {places}")
    return broken


def replay_tasks(
    layout: np.ndarray,
    rule: TaskRule,
    positions: np.ndarray,
    goals: np.ndarray,
    credited: np.ndarray,
    horizon: int = 1,
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Work out arrivals, services and finished tasks from positions and goals (int [end + 1, A]).

    A goal is the cell an agent heads for before a step, -1 while it has no order, which ends with
    the last kind of goal; `credited` (bool [end, A]) are the tasks that the simulator says the step
    finished. The service rule is written a second time here on purpose: the audit trusts no code it
    checks. All agents are planned again every `horizon` timesteps. Returns finished bool [end, A],
    working bool [end + 1, A] (serving after the step), messages.
    """
    goal_cells = np.array([np.asarray(goal.weight(layout)).reshape(-1) > 0 for goal in rule.cycle])
    stays = np.array([np.asarray(goal.stays(layout)).reshape(-1) for goal in rule.cycle])
    end, agents = credited.shape
    kind, remaining, legs = (np.zeros(agents, int) for _ in range(3))
    finished = np.zeros((end, agents), bool)
    working = np.zeros((end + 1, agents), bool)
    broken = []
    for time in range(end):
        legs[:] = 0 if time % horizon == 0 else legs
        goal, cell = goals[time], positions[time + 1]
        idle = goal < 0
        proper = np.where(idle, bool(rule.rate) & (kind == 0), goal_cells[kind, goal])
        if not proper.all():
            broken.append(f"t={time}: agent {np.argmin(proper)} heads for a goal of another kind")
        serving = remaining > 0
        left = serving & (cell != goal)
        if left.any():
            broken.append(f"t={time}: agent {np.argmax(left)} cuts a stay short")
        # A third goal since the last planning was unknown then: a stay there has to wait.
        stay = stays[kind, goal]
        arrived = ~serving & (cell == goal) & ((legs < 2) | (stay == 0))
        remaining = np.where(serving, remaining - 1, np.where(arrived, stay, 0))
        done = (serving | arrived) & (remaining == 0)
        finished[time], working[time + 1] = done, remaining > 0
        legs += done
        kind = np.where(done, (kind + 1) % len(stays), kind)
        skips = (goals[time + 1] != goal) & ~done & ~idle
        if skips.any():
            broken.append(f"t={time}: agent {np.argmax(skips)} skips its goal")
    wrong = finished != credited
    if wrong.any():
        broken.append(_at("has a task credited wrongly", wrong))
    return finished, working, broken


def jammed_windows(positions: np.ndarray, working: np.ndarray, horizon: int) -> list[int]:
    """List the ends of all windows in which more than half of the agents were stuck.

    An agent is stuck if it stands still from the window's start until one timestep before its end
    and never serves meanwhile.
    """
    jams = []
    for start in range(0, len(positions) - horizon, horizon):
        path, at_work = positions[start : start + horizon], working[start : start + horizon]
        stuck = (path == path[0]).all(0) & ~at_work.any(0)
        if stuck.sum() > positions.shape[1] // 2:
            jams.append(start + horizon)
    return jams


def _at(what: str, where: np.ndarray) -> str:
    """Name the first timestep and agent at which something holds."""
    time, agent = np.argwhere(where)[0]
    return f"t={time}: agent {agent} {what}"
