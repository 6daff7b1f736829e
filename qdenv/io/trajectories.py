"""Where robots were at each timestep: our own runs to write, foreign ones to read.

Two forms: lines of timestep, robot, row and column, and the JSON of the League of Robot Runners in
its generations of 2023, 2024 and 2026 (https://github.com/MAPF-Competition/Start-Kit,
Input_Output_Format.md), which PlanViz shows.
"""

import json
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv import grid
from qdenv.io.files import MEGABYTE, damaged, read_text, write_atomically, write_csv
from qdenv.io.records import parse_json, structured

HEAD = ("timestep", "robot", "row", "column")
_GOALS = ("goal_row", "goal_column", "finished")  # of our own lines
_MOST = 20_000_000  # robots times timesteps of a run; a hostile file may not fill the memory
# Action -> (rows, columns) of a step; of robots that turn a step leads ahead, clockwise from east.
# Of the moves in the order of `grid`: PlanViz goes down for U, where older versions went up.
_LETTERS = "WRLUD"
_STEPS = dict(zip(_LETTERS[1:], grid.MOVES, strict=True))
_AHEAD = np.array([_STEPS[letter] for letter in "RULD"])
# A stretch of a path of 2026: where it begins, which is ignored, and actions with their numbers.
_STRETCH = re.compile(r"\[\([^()]*\):\(([^()]*)\)\]")


class Errand(NamedTuple):
    """A goal that was reached, as a file says."""

    time: int  # timestep at which the robot is there
    robot: int  # which
    place: tuple[int, int]  # row and column of the goal
    task: int  # number of the task
    last: bool  # with it the task is finished


class Trajectories(NamedTuple):
    """The run of a fleet of A robots over T timesteps."""

    cells: np.ndarray  # int64 [T + 1, A, 2], row and column of each robot at each time
    errands: list[Errand]  # goals that were reached; empty where the file knows no goals
    finished: int | None = None  # number of finished tasks that the file states


class _Output(NamedTuple):
    """What is read of the League's JSON."""

    actionModel: str  # noqa: N815
    start: list[tuple[int, int, str]]
    actualPaths: list[str]  # noqa: N815
    tasks: Any = ()  # see `_errands`
    events: Any = ()
    numTaskFinished: int | None = None  # noqa: N815
    agentMaxCounter: int = 1  # noqa: N815


def write_paths(
    path: Path, positions: np.ndarray, goals: np.ndarray, finished: np.ndarray, width: int
) -> None:
    """Write a run by the ending of its file: JSON for PlanViz, else CSV, a line a position.

    `positions` and `goals` (int [T + 1, A]) are cells of a layout of `width` columns, where agents
    are before each step and at the end, and where they head for, -1 without an order; `finished`
    (bool [T, A]) are tasks finished by the step. Lines have 1 under "finished" just after that.
    Raises InputError if the place cannot be written to.
    """
    if path.suffix.lower() == ".json":
        text = json.dumps(planviz(positions, goals, finished, width))
        write_atomically(path, f"{text}\n".encode())
        return
    times, robots = np.indices(positions.shape).reshape(2, -1)
    done = np.concatenate([np.zeros_like(finished[:1]), finished]).astype(int)
    cells, ends = (
        np.where(part < 0, -1, np.divmod(part, width)).reshape(2, -1) for part in (positions, goals)
    )
    columns = np.stack([times, robots, *cells, *ends, done.reshape(-1)], axis=1)
    write_csv(path, (*HEAD, *_GOALS), columns.tolist())


def planviz(
    positions: np.ndarray, goals: np.ndarray, finished: np.ndarray, width: int
) -> dict[str, Any]:
    """Describe a run (see `write_paths`) as the League's JSON of 2024 without turns, JSON-ready.

    A path is a row of the moves R, L, D, U and W. Each goal of an agent is a task with one errand,
    scheduled when the agent sets out for it.
    """
    steps, letters = np.diff(positions, axis=0), np.full(finished.shape, "W")
    # Up and down come last: in a layout of one column right and left are the same steps.
    for letter, step in zip(_LETTERS, grid.move_steps(width), strict=True):
        letters[steps == step] = letter
    tasks: list[list[Any]] = []
    events: list[list[int]] = []
    schedules = []
    for agent in range(positions.shape[1]):
        ends = (np.flatnonzero(finished[:, agent]) + 1).tolist()
        schedule = []
        for last, end in zip([0, *ends], [*ends, None], strict=True):
            ahead = np.flatnonzero(goals[last:, agent] >= 0)
            if not len(ahead):  # no order any more
                break
            since = last + int(ahead[0])
            if end is not None:
                events.append([end, agent, len(tasks), 1])
            schedule.append(f"{since}:{len(tasks)}")
            tasks.append([len(tasks), since, [*divmod(int(goals[since, agent]), width)]])
        schedules.append(",".join(schedule))
    paths = [",".join(column) for column in letters.T]
    starts = [[*divmod(cell, width), "N/A"] for cell in positions[0].tolist()]
    return {
        "actionModel": "MAPF",
        "version": "2024 LoRR",
        "AllValid": "Yes",
        "teamSize": len(starts),
        "start": starts,
        "numTaskFinished": len(events),
        "sumOfCost": int(steps.size),
        "makespan": len(steps),
        "actualPaths": paths,
        "plannerPaths": paths,
        "plannerTimes": [],
        "errors": [],
        "actualSchedule": schedules,
        "plannerSchedule": schedules,
        "scheduleErrors": [],
        "events": sorted(events),
        "tasks": tasks,
    }


def read_run(path: str | Path) -> Trajectories:
    """Read the run of a fleet: JSON of the League of Robot Runners, or lines in any other file.

    Lines hold timestep, robot, row and column, parted by commas, semicolons or blanks; a first line
    with these names may put them in another order, beside others. Raises InputError, in one line,
    if the file is neither.
    """
    if Path(path).suffix.lower() == ".json":
        content = parse_json(read_text(path, 256 * MEGABYTE, "JSON"), path, _MOST)
        return _read_league(path, structured(content, _Output, path))
    return _read_lines(path)


def _read_lines(path: str | Path) -> Trajectories:
    """Read lines, each of one robot at one time."""
    lines = [re.split(r"[,;\s]+", line.strip()) for line in read_text(path).splitlines()]
    lines = [line for line in lines if line != [""]]
    names = list(HEAD)
    if lines and not lines[0][0].lstrip("-").isdigit():
        names = [name.lower().replace("agent", "robot") for name in lines.pop(0)]
    if missing := [name for name in HEAD if name not in names]:
        raise damaged(path, f"no column {missing[0]}: lines hold {', '.join(HEAD)}")
    if not lines:
        raise damaged(path, f"no lines of {', '.join(HEAD)}")
    try:
        table = dict(zip(names, zip(*lines, strict=True), strict=True))
        columns = {one: np.array(table[one], np.int64) for one in (*HEAD, *_GOALS) if one in table}
    except (ValueError, OverflowError):
        whole = re.compile(r"-?\d{1,18}").fullmatch
        wrong = (one for one in lines if len(one) != len(names) or not all(map(whole, one)))
        shown = " ".join(next(wrong, lines[0]))[:60]
        raise damaged(path, f"{shown!r} is not a line of {', '.join(names)} in integers") from None
    times, robots = columns["timestep"] - columns["timestep"].min(), columns["robot"]
    known, agent = np.unique(robots, return_inverse=True)
    shape = (int(times.max()) + 1, len(known))
    if shape[0] * shape[1] > _MOST or times.min() < 0:  # a difference beyond 64 bits
        raise damaged(path, f"more than {_MOST:,} robots times timesteps")
    seen = np.zeros(shape, int)
    np.add.at(seen, (times, agent), 1)
    if (seen != 1).any():
        time, robot = np.argwhere(seen != 1)[0]
        number = f"{seen[time, robot]} places" if seen[time, robot] else "no place"
        raise damaged(path, f"robot {known[robot]} has {number} at timestep {time}: give it one")
    cells = np.empty((*shape, 2), np.int64)
    cells[times, agent] = np.stack([columns["row"], columns["column"]], axis=1)
    errands: list[Errand] = []
    if set(_GOALS) <= columns.keys():
        rows = np.empty((*shape, 3), np.int64)
        rows[times, agent] = np.stack([columns[name] for name in _GOALS], axis=1)
        for time, robot in np.argwhere(rows[..., 2] > 0).tolist():
            row, column, _ = rows[max(time - 1, 0), robot].tolist()  # where it was heading for
            errands.append(Errand(time, robot, (row, column), len(errands), True))
    return Trajectories(cells, errands)


def _read_league(path: str | Path, output: _Output) -> Trajectories:
    """Follow the actions from the starts, and list the errands of the events."""
    if output.actionModel not in ("MAPF", "MAPF_T"):
        raise damaged(path, f"action model {output.actionModel[:40]!r}: known are MAPF and MAPF_T")
    if not 0 < len(output.actualPaths) <= len(output.start):
        paths, starts = len(output.actualPaths), len(output.start)
        raise damaged(path, f"{paths} paths with {starts} starts: each robot has one of both")
    turning, every = output.actionModel == "MAPF_T", max(output.agentMaxCounter, 1)
    known = "WT" + ("FRC" if turning else "".join(_STEPS))  # T: the planner was too late
    actions = []
    for robot, text in enumerate(output.actualPaths):
        letters, left = _expand(text), _MOST // len(output.actualPaths)
        wrong = sorted(set(letters or "?") - set(known))
        if len(letters) > left or wrong:
            reason = f"{wrong[0]!r} is none of {' '.join(known)}" if wrong else "too many actions"
            raise damaged(path, f"the path of robot {robot}: {reason}")
        actions.append(letters)
    ways = [
        _follow(letters.ljust(max(map(len, actions)), "W"), start, turning, every)
        for letters, start in zip(actions, output.start, strict=False)
    ]
    cells = np.stack(ways, axis=1)
    try:
        errands = _errands(output)
        if errands and not turning:  # an older file goes up for U
            upside_down = cells.copy()
            upside_down[..., 0] = 2 * cells[0, :, 0] - cells[..., 0]
            times, robots, places, *_ = map(list, zip(*errands, strict=True))
            when = np.minimum(times, len(cells) - 1)
            reached = lambda way: (way[when, robots] == places).all(axis=-1).sum()  # noqa: E731
            cells = max(cells, upside_down, key=reached)
        return Trajectories(cells, errands, output.numTaskFinished)
    except (TypeError, ValueError, LookupError, OverflowError):
        raise damaged(path, "events and tasks are not those of 2023, 2024 or 2026") from None


def _expand(text: str) -> str:
    """Write a path as one letter a timestep; "?" for a path that is none."""
    if not text.startswith("["):
        return text.replace(",", "")
    parts = [part.split(" ") for one in _STRETCH.findall(text) for part in one.split(",") if part]
    if _STRETCH.sub("", text) or not all(
        len(part) == 2 and re.fullmatch(r"\d{1,7}", part[1]) for part in parts
    ):
        return "?"
    if sum(int(number) for _, number in parts) > _MOST:
        return "W" * (_MOST + 1)
    return "".join(letter * int(number) for letter, number in parts)


def _follow(letters: str, start: tuple[int, int, str], turning: bool, every: int) -> np.ndarray:
    """Return rows and columns (int64 [T + 1, 2]); a step or a turn takes `every` actions."""
    actions = np.array(list(letters), "U1")
    if turning:
        drives, turns = actions == "F", np.isin(actions, ["R", "C"])
        ends = np.cumsum(turns) % every == 0
        turned = np.where(actions == "R", 1, -1) * (turns & ends)
        heading = max("ESWN".find(start[2]), 0) + np.cumsum(turned)
        steps = _AHEAD[heading % 4] * (drives & (np.cumsum(drives) % every == 0))[:, None]
    else:
        steps = np.zeros((len(actions), 2), np.int64)
        for letter, step in _STEPS.items():
            steps[actions == letter] = step
    return np.concatenate([[start[:2]], start[:2] + np.cumsum(steps, axis=0)]).astype(np.int64)


def _errands(output: _Output) -> list[Errand]:
    """List the goals that were reached: by robot in 2023, by time since then."""
    # Each task is [number, row, column] or [number, release, [row, column, row, column, ...]].
    goals = {
        task[0]: list(zip(task[2][::2], task[2][1::2], strict=True))
        if isinstance(task[2], list)
        else [(task[1], task[2])]
        for task in output.tasks
    }
    events = [
        (time, robot, task, 1)
        for robot, own in enumerate(output.events)
        if own and isinstance(own[0], list)
        for task, time, what in own
        if what == "finished"
    ] or [tuple(one) for one in output.events if one and not isinstance(one[0], list)]
    errands = []
    for time, robot, task, errand in events:
        if errand < 1:  # it would count from the last one
            raise IndexError
        row, column = goals[task][errand - 1]
        place, last = (int(row), int(column)), errand == len(goals[task])
        errands.append(Errand(int(time), int(robot), place, int(task), last))
    return errands
