"""The report on mazes: how often the agent reaches the goal, where it walks, how soon it ends."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.agent.evaluate import Success, default_horizon, evaluate_agent, run_alone
from qdenv.grid import of_tiles
from qdenv.progress import Progress, silent
from qdenv.simulate.maze.policy import load_weights
from qdenv.simulate.maze.world import WALL
from qdenv.study.table import about
from qdenv.view.layouts import draw_plan
from qdenv.view.maze import draw_arrivals, draw_walks
from qdenv.view.report.build import (
    Report,
    domain_of,
    listed,
    make_report,
    searches_of,
    to_svg,
)
from qdenv.view.report.subjects import Subject
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
    names = listed([one.name for one in subjects])
    horizons = listed([f"{one.horizon:,}" for one in found])
    facts = {
        "layouts": {
            one.subject.name: {"source": one.subject.source, **one.success._asdict()}
            for one in found
        }
    }
    settings = {
        **{f"maze {one.name}": one.source for one in subjects},
        "domain": domain_of(subjects[0]),
        "agent": "the one that ships",
        "episodes": str(EPISODES),
        "actions per episode": horizons,
        "seed": str(SEED),
    }
    arrivals = {one.subject.name: one.arrivals for one in found}
    figure = draw_arrivals(arrivals, max(one.horizon for one in found), CURVES)
    return make_report(
        "report_maze",
        f"{names}: the agent's success",
        facts,
        settings,
        again,
        mazes=[_maze(one, place) for place, one in enumerate(found)],
        runs=searches_of(subjects),
        horizons=horizons,
        episodes=EPISODES,
        seed=SEED,
        arrivals=to_svg(figure, "arrivals"),
        rates=[
            (
                one.subject.name,
                f"{np.isfinite(one.arrivals).sum()} of {one.success.runs}",
                f"{one.success.rate:.1%}",
                f"{one.success.low:.1%} to {one.success.high:.1%}",
                f"{one.success.mean_length:.1f}",
                f"{one.success.shortest} moves",
            )
            for one in found
        ],
    )


def _maze(one: Solved, place: int) -> dict[str, Any]:
    """Collect what the page shows of one maze."""
    domain, layout = one.subject.plan.domain, one.subject.layout
    free = ~np.asarray(of_tiles(layout, domain.tiles[WALL], domain.tiles))
    plan, walks = draw_plan(layout, domain.tiles, domain.names), draw_walks(free, one.usage, MAP)
    for figure in (plan, walks):
        draw_marks(figure.axes[0], domain.mark_cells(layout))
    return {
        "name": one.subject.name,
        "title": f"{one.subject.name} ({one.subject.size} cells)",
        "size": one.subject.size,
        "success": one.success,
        "plan": to_svg(plan, f"plan-{place}", crop=True),
        "walks": to_svg(walks, f"walks-{place}"),
    }
