"""Functions that return pages: shown in a notebook, saved as one file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from qdenv.api.plans import Source, read_plan
from qdenv.training.records import RunDirectory
from qdenv.types import InputError

if TYPE_CHECKING:
    from qdenv.pages.page import Page
    from qdenv.study.options import Driving


def explore(run: RunDirectory | str | Path, growth: int | None = None) -> Page:
    """Make a page on which a run's archive can be touched: layouts, numbers, growth.

    Args:
        run: the run, or its folder, or ``zoo:DOMAIN/NAME``.
        growth: how many elites the page shows growing; unless given as many as fit into 12 MB.

    Returns:
        the page; `Page.save` writes it as one file that needs no network.

    Raises:
        InputError: there is no elite, there are more than two measures, or a package is missing.
    """
    from qdenv.pages.explorer import make_explorer

    opened = run if isinstance(run, RunDirectory) else RunDirectory.open(run)
    return make_explorer(opened, growth)[0]


def replay(
    layout: Source,
    agents: int | None = None,
    domain: str | None = None,
    timesteps: int | None = None,
    seed: int = 0,
    **driving: Unpack[Driving],
) -> Page:
    """Replay one run: robots, goals, jams, tile usage; in a maze, the agent's way.

    Args:
        layout: see `qdenv.read_plan`.
        agents: number of robots; 200, or what is known of the layout's size, unless given.
        domain: whose tasks they do; what the file says unless given.
        timesteps: horizon T; 1000, or likewise, unless given.
        seed: of the run.
        **driving: effort, planner and stop, as in `qdenv.simulate`.

    Returns:
        a page, which a notebook shows; ``page.save("replay.html")`` writes it.

    Raises:
        InputError: a name is unknown, or the fleet cannot work on this layout.
    """
    from qdenv.pages.replay import about_episode, about_fleet, make_replay
    from qdenv.study.motion import MAZES, record_fleet, trace_agent
    from qdenv.study.options import make_fleet
    from qdenv.study.usual import usual_fleet

    plan = read_plan(layout, domain)
    if plan.domain.name in MAZES:
        if agents is not None or driving:
            raise InputError("one agent walks in a maze, and nobody plans: leave these words out")
        motion = trace_agent(plan, seed, timesteps)
        return make_replay(plan, motion, None, about_episode(motion, seed))
    usual = usual_fleet(plan.domain, [plan.layout], agents, timesteps)
    config = make_fleet(usual.agents, usual.timesteps, **driving)
    motion, traffic = record_fleet(plan, config, seed)
    return make_replay(plan, motion, traffic, about_fleet(plan, config, seed, motion, traffic))
