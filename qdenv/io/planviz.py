"""A recorded run as the League of Robot Runners writes it in JSON, which PlanViz shows.

Format of 2024 (https://github.com/MAPF-Competition/Start-Kit, Input_Output_Format.md) with its
action model without turns: a path is a row of the moves R, L, D, U and W. Each goal of an agent is
a task with one errand, scheduled when the agent sets out for it.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.grid import move_steps
from qdenv.io.files import write_atomically

MOVES = "WRLDU"  # letters of the moves in the order of `grid`


def write_planviz(
    path: str | Path, positions: np.ndarray, goals: np.ndarray, finished: np.ndarray, width: int
) -> None:
    """Write a run for PlanViz, atomically.

    Args:
        path: JSON file to write.
        positions: int [T + 1, A], cells (row * width + column) before each step and at the end.
        goals: int [T + 1, A], the cells that agents head for at these times.
        finished: bool [T, A], whether the step finished the task.
        width: columns of the layout.

    Raises:
        InputError: the place cannot be written to.
    """
    write_atomically(
        Path(path), f"{json.dumps(planviz(positions, goals, finished, width))}\n".encode()
    )


def planviz(
    positions: np.ndarray, goals: np.ndarray, finished: np.ndarray, width: int
) -> dict[str, Any]:
    """Describe a run in JSON-ready values, see `write_planviz`."""
    steps = np.diff(positions, axis=0)
    # Up and down come last: in a layout of one column they are the same steps as right and left.
    kinds = [steps == step for step in move_steps(width)[::-1]]
    names = np.array([*MOVES])
    letters = names[::-1][np.argmax(np.stack(kinds), axis=0)] if len(steps) else names[:0]
    tasks: list[list[Any]] = []
    events: list[list[int]] = []
    schedules = []
    for agent in range(positions.shape[1]):
        ends = [int(step) + 1 for step in np.flatnonzero(finished[:, agent])]
        schedule = []
        for since, end in zip([0, *ends], [*ends, None], strict=True):
            if end is not None:
                events.append([end, agent, len(tasks), 1])
            schedule.append(f"{since}:{len(tasks)}")
            tasks.append([len(tasks), since, [int(x) for x in divmod(goals[since, agent], width)]])
        schedules.append(",".join(schedule))
    paths = [",".join(column) for column in letters.T] if len(steps) else [""] * len(schedules)
    starts = [[int(cell) // width, int(cell) % width, "N/A"] for cell in positions[0]]
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
