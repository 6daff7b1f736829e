"""The replay: one run of a fleet, or one walk through a maze, to be played in a browser.

A robot moves by at most one cell in a timestep, so its path is a start and one of five moves for
each step, three of which fit a byte; its goals are the first one and each that follows.
`scripts/replay_film.js` decodes this.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qdenv.grid import move_steps
from qdenv.guidance import preferences
from qdenv.simulation.mapf.settings import FleetConfig, describe_planner
from qdenv.study.plans import Plan
from qdenv.study.recordings import Motion, throughput_over_time
from qdenv.types import InputError, Traffic
from qdenv.view.page import Page, make_page

_SCRIPTS = "film view ground marks robots chart panel controls start"


def make_replay(
    plan: Plan, motion: Motion, traffic: Traffic | None, about: Sequence[str] = ()
) -> Page:
    """Make the page that plays a run.

    `traffic` is what the simulator counted, None in a maze; `about` are the lines below the title.
    Raises InputError if jinja2 is not installed, or a planner let a robot jump.
    """
    # Only here: matplotlib takes half a second to import.
    from qdenv.view import film, guidance
    from qdenv.view.layouts import MARKS

    colours = film.floor_colours(plan.domain.tiles)
    rows, cols = plan.layout.shape
    tasks = plan.domain.simulator.tasks
    free = tasks.traversable if tasks else " "
    facts: dict[str, Any] = {
        "rows": rows,
        "cols": cols,
        "agents": motion.positions.shape[1],
        "steps": motion.steps,
        "free": [tile in free for tile in plan.domain.tiles],
        "colours": colours,
        "marks": MARKS,
        "warmth": film.WARMTH,
        "jam": [film.JAM_FROM, film.JAM_STEP],
        "congested": motion.congested,
        "shortest": motion.shortest,
        "ends": [],
        "throughput": [],
    }
    if traffic is not None:
        # A run that ended early has no throughput after its end.
        driven = traffic._replace(finished=traffic.finished[: motion.steps])
        ends, means, _ = throughput_over_time([driven])
        facts |= {"ends": ends.tolist(), "throughput": means.tolist()}
    packed = {"tiles": plan.layout.astype(np.uint8), **encode(motion, cols)}
    scripts = [f"replay_{name}" for name in _SCRIPTS.split()]
    if plan.costs is not None:
        passable = plan.domain.drivable(plan.layout)
        facts["arrows"] = guidance.ARROWS
        packed["arrows"] = guidance.pack_arrows(preferences(plan.costs, passable))
        scripts[-1:-1] = ["arrows", "replay_arrows"]
    used = [(kind, tile) for kind, tile in enumerate(plan.domain.tiles) if kind in plan.layout]
    return make_page(
        "replay",
        f"Replay of {plan.name}",
        scripts,
        facts,
        packed,
        name=plan.name,
        about=about,
        maze=motion.headings is not None,
        serves=tasks is not None and any(goal.stay for goal in tasks.cycle),
        tiles=[(plan.domain.names.get(tile, tile), colours[kind]) for kind, tile in used],
    )


def about_fleet(
    plan: Plan, config: FleetConfig, seed: int, motion: Motion, traffic: Traffic
) -> list[str]:
    """Describe a run in two lines: its settings and its outcome."""
    rows, cols = plan.layout.shape
    tasks, waits = int(motion.finished.sum()), motion.waits
    jam = ""
    if motion.congested:
        after = "which ended the run" if config.stop_when_congested else "and went on"
        jam = f"; congested at {int(traffic.congested_at)}, {after}"
    return [
        f"{config.agents:,} robots on {rows} x {cols}, {motion.timesteps:,} timesteps, "
        f"seed {seed}; planner: {describe_planner(config.planner)}",
        f"throughput {float(traffic.throughput):.3f} tasks per timestep, {tasks:,} tasks finished, "
        f"{waits.mean() if waits.size else 0:.1%} of the robots' time spent waiting{jam}",
    ]


def encode(motion: Motion, cols: int) -> Mapping[str, np.ndarray]:
    """Turn a recording into small arrays, agent by agent.

    These are starts and goals: uint32 [A], the first cells; moves: uint8 [A, ceil(E / 3)], three
    digits to base 5 each, the first one the highest; counts: uint32 [A], how often each gets
    another goal; times, next and done: uint32 or uint8 [sum of counts], the step of each, the goal
    from then on, and whether the step finished a task, left out where all did; headings: uint8
    [E + 1], empty for robots. A robot without an order has the goal 2^32 - 1. Raises InputError if
    a robot moved by more than one cell.
    """
    moves = np.full(motion.finished.shape, 255, np.uint8)
    steps = np.diff(motion.positions, axis=0)
    # In a layout of one column right and down are the same number, and down is meant.
    for move, step in enumerate(move_steps(cols)):
        moves[steps == step] = move
    if (moves == 255).any():
        step, agent = np.argwhere(moves == 255)[0]
        raise InputError(f"robot {agent} moves by more than one cell after timestep {step}")
    # Three moves to a byte: 5³ = 125 combinations.
    whole = np.pad(moves, ((0, -len(moves) % 3), (0, 0)))
    digits = whole.T.reshape(motion.finished.shape[1], -1, 3)
    # Robots may be given an order at any time, and have the same goal twice.
    turns = motion.finished | (motion.goals[1:] != motion.goals[:-1])
    agents, times = np.nonzero(turns.T)
    headings = np.zeros(0) if motion.headings is None else motion.headings
    arrays = {
        "starts": motion.positions[0].astype("<u4"),
        "moves": (digits @ np.array([25, 5, 1], np.uint8)).astype(np.uint8),
        "goals": motion.goals[0].astype("<u4"),
        "counts": turns.sum(0).astype("<u4"),
        "times": (times + 1).astype("<u4"),
        "next": motion.goals[times + 1, agents].astype("<u4"),
        "headings": headings.astype(np.uint8),
    }
    done = motion.finished[times, agents].astype(np.uint8)
    return arrays if done.all() else arrays | {"done": done}
