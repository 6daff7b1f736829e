"""Functions that return pages: shown in a notebook, saved as one file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from qdenv.api.plans import Source, read_plan
from qdenv.types import InputError

if TYPE_CHECKING:
    from qdenv.pages.page import Page
    from qdenv.study.options import Driving


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
