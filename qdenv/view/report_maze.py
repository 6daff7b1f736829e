"""The report on mazes: how often the agent reaches the goal, where it walks, how soon it ends."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.agent.evaluate import default_horizon, evaluate_agent, run_alone
from qdenv.progress import Progress, silent
from qdenv.simulation.maze.policy import load_weights
from qdenv.simulation.maze.world import WALL
from qdenv.types import about
from qdenv.view.layouts import draw_marks, draw_plan
from qdenv.view.page import Page, listed
from qdenv.view.report import WIDTH, make_report
from qdenv.view.report_subjects import Subject
from qdenv.view.style import to_svg
from qdenv.view.traffic import draw_arrivals, draw_walks

_EPISODES, _SEED = 100, 0  # those of `qdenv evaluate-agent`
_MAP = 5.0  # inches of a map of a maze


def report_mazes(
    subjects: list[Subject],
    timesteps: int | None = None,
    command: str = "",
    progress: Progress = silent,
) -> Page:
    """Let the agent walk through mazes, as `qdenv evaluate-agent` does, and make the page.

    `timesteps` are the actions per episode, twice the tiles of the ringed maze unless given;
    `command` is the line that makes the page again. Raises InputError if there is nothing to solve
    in one of them.
    """
    weights = load_weights("")
    mazes: list[dict[str, Any]] = []
    for number, one in enumerate(subjects):
        progress("solving mazes", number / len(subjects), one.name)
        domain, layout = one.plan.domain, one.plan.layout
        size = "{} x {}".format(*layout.shape)
        horizon = timesteps or default_horizon(layout)
        with about(one.source):
            success = evaluate_agent(weights, layout, _SEED, _EPISODES, horizon)
        # The same episodes again, now with their paths.
        key = jax.random.key(_SEED)
        episodes = run_alone(weights, jnp.asarray(layout), key, _EPISODES, horizon)
        # Actions to the goal, NaN where it was not reached.
        arrivals = np.where(np.asarray(episodes.success), np.asarray(episodes.length), np.nan)
        usage = np.asarray(episodes.usage).mean(axis=0)
        # The agent may walk on whatever is no wall.
        free = layout != WALL
        plan, walks = draw_plan(layout, domain.tiles, domain.names), draw_walks(free, usage, _MAP)
        for figure in (plan, walks):
            draw_marks(figure.axes[0], domain.mark_cells(layout))
        mazes.append(
            {
                "name": one.name,
                "title": f"{one.name} ({size} cells)",
                "size": size,
                "horizon": horizon,
                "success": success,
                "arrivals": arrivals,
                "reached": np.isfinite(arrivals).sum(),
                "plan": to_svg(plan, f"plan-{number}", crop=True),
                "walks": to_svg(walks, f"walks-{number}"),
            }
        )
    figure = draw_arrivals(
        {one["name"]: one["arrivals"] for one in mazes}, max(one["horizon"] for one in mazes), WIDTH
    )
    facts = {
        one["name"]: {"source": subject.source, **one["success"]._asdict()}
        for one, subject in zip(mazes, subjects, strict=True)
    }
    return make_report(
        "maze",
        f"{listed([one.name for one in subjects])}: the agent's success",
        subjects,
        {"layouts": facts},
        command,
        mazes=mazes,
        horizons=listed(list(dict.fromkeys(f"{one['horizon']:,}" for one in mazes))),
        episodes=_EPISODES,
        seed=_SEED,
        arrivals=to_svg(figure, "arrivals"),
    )
