"""The report on mazes: how often the agent reaches the goal, where it walks, how soon it ends."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.agent.evaluate import Success, default_horizon, evaluate_agent, run_alone
from qdenv.grid import of_tiles
from qdenv.run.archive import mark_cells
from qdenv.simulate.maze.policy import load_weights
from qdenv.simulate.maze.world import WALL
from qdenv.study.options import Progress, silent
from qdenv.study.sweep import about
from qdenv.view.layouts import draw_plan
from qdenv.view.maze import draw_arrivals, draw_walks
from qdenv.view.page import make_page
from qdenv.view.report.blocks import Section, Table, Text, drawing, made_line, settings_section
from qdenv.view.report.build import Report, whose
from qdenv.view.report.sections import search_sections
from qdenv.view.report.subjects import Subject
from qdenv.view.report.text import listed
from qdenv.view.runs import draw_marks

EPISODES, SEED = 100, 0  # those of `qdenv evaluate-agent`
CURVES, MAP = 6.8, 5.0  # inches

_run = jax.jit(run_alone, static_argnums=(3, 4))


class Solved(NamedTuple):
    """How the agent does in one maze."""

    subject: Subject  # the maze
    horizon: int  # actions after which an episode fails
    success: Success  # how often it reached the goal
    arrivals: np.ndarray  # float [episodes], actions to the goal, NaN where it was not reached
    usage: np.ndarray  # float [H, W], share of its actions that it takes on each cell


def solve(
    subjects: list[Subject], timesteps: int | None = None, progress: Progress = silent
) -> list[Solved]:
    """Let the agent walk through mazes, as `qdenv evaluate-agent` does.

    Args:
        subjects: the mazes.
        timesteps: actions per episode; twice the tiles of the ringed maze unless given.
        progress: hears how far it is.

    Raises:
        InputError: there is nothing to solve in one of them.
    """
    weights, found = load_weights(""), []
    for place, one in enumerate(subjects):
        progress("solving mazes", place / len(subjects), one.name)
        horizon = timesteps or default_horizon(one.layout)
        with about(one.source):
            success = evaluate_agent(weights, one.layout, SEED, EPISODES, horizon)
        key = jax.random.key(SEED)
        episodes = _run(weights, jnp.asarray(one.layout), key, EPISODES, horizon)
        arrivals = np.where(np.asarray(episodes.success), np.asarray(episodes.length), np.nan)
        usage = np.asarray(episodes.usage).mean(axis=0)
        found.append(Solved(one, horizon, success, arrivals, usage))
    return found


def maze_report(found: list[Solved], again: str = "") -> Report:
    """Make the page of mazes.

    Args:
        found: the mazes.
        again: the command line that makes the page again.
    """
    subjects = [one.subject for one in found]
    title = f"{listed([one.name for one in subjects])}: the agent's success"
    facts = {
        "layouts": {
            one.subject.name: {"source": one.subject.source, **one.success._asdict()}
            for one in found
        }
    }
    horizons = listed([f"{one.horizon:,}" for one in found])
    settings = {
        **{f"maze {one.name}": one.source for one in subjects},
        "domain": whose(subjects[0]),
        "agent": "the one that ships",
        "episodes": str(EPISODES),
        "actions per episode": horizons,
        "seed": str(SEED),
    }
    parts = [
        _asked(found),
        *search_sections(subjects),
        _mazes(found),
        _successes(found),
        *_walks(found),
        Section("Against other mazes", [Text(OTHERS)]),
        settings_section(settings, again),
    ]
    page = make_page("report", title, facts=facts, sections=parts, made=made_line())
    return Report(page, facts)


OTHERS = (
    "Nobody designs mazes by hand for this agent. qdenv evaluate-agent MAZE --random-mazes 100 "
    "compares one with random mazes of as many walls and a path of like length."
)


def _asked(found: list[Solved]) -> Section:
    names = listed([f"{one.subject.name} ({one.subject.size} cells)" for one in found])
    question = (
        f"How hard is the maze {names} for an agent that sees only what is near? It begins at one "
        "end of the longest of all shortest paths and shall reach the other end; an episode fails "
        f"after {listed([f'{one.horizon:,}' for one in found])} actions. Each number is of "
        f"{EPISODES} episodes (seed {SEED})."
    )
    answers = [
        Text(
            f"{one.subject.name}: the agent reaches the goal in {one.success.rate:.1%} of the "
            f"episodes (95 % interval {one.success.low:.1%} to {one.success.high:.1%}), after "
            f"{one.success.mean_length:.0f} actions on average; the shortest path has "
            f"{one.success.shortest} moves.",
            "answer",
        )
        for one in found
    ]
    return Section("What was asked", [Text(question), *answers])


def _mazes(found: list[Solved]) -> Section:
    drawn = []
    for place, one in enumerate(found):
        domain, layout = one.subject.plan.domain, one.subject.layout
        figure = draw_plan(layout, domain.tiles, domain.names)
        draw_marks(figure.axes[0], mark_cells(layout, domain))
        caption = f"{one.subject.name}: {one.subject.size} cells, with start and goal"
        drawn.append(drawing(figure, caption, f"plan-{place}", len(found) > 1, crop=True))
    return Section("The mazes" if len(found) > 1 else "The maze", drawn)


def _successes(found: list[Solved]) -> Section:
    head = ("maze", "at the goal", "share", "95 % interval (Wilson)", "actions", "shortest path")
    rows = [
        (
            one.subject.name,
            f"{np.isfinite(one.arrivals).sum()} of {one.success.runs}",
            f"{one.success.rate:.1%}",
            f"{one.success.low:.1%} to {one.success.high:.1%}",
            f"{one.success.mean_length:.1f}",
            f"{one.success.shortest} moves",
        )
        for one in found
    ]
    arrivals = {one.subject.name: one.arrivals for one in found}
    figure = draw_arrivals(arrivals, max(one.horizon for one in found), CURVES)
    caption = "Share of the episodes that have reached the goal, over the actions taken."
    curves = drawing(figure, caption, "arrivals")
    return Section("Success", [Table(head, rows, "success"), curves])


def _walks(found: list[Solved]) -> list[Section]:
    sections = []
    for place, one in enumerate(found):
        domain, layout = one.subject.plan.domain, one.subject.layout
        free = ~np.asarray(of_tiles(layout, domain.tiles[WALL], domain.tiles))
        figure = draw_walks(free, one.usage, MAP)
        draw_marks(figure.axes[0], mark_cells(layout, domain))
        whose_maze = f": {one.subject.name}" if len(found) > 1 else ""
        caption = f"Share of its actions that the agent takes on each cell{whose_maze}."
        walks = drawing(figure, caption, f"walks-{place}")
        sections.append(Section(f"Where the agent walks{whose_maze}", [walks]))
    return sections
