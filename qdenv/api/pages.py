"""Functions that make pages to look at and to send: they show themselves in a notebook."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, Unpack

from qdenv.api.plans import Source, read_plan
from qdenv.run.directory import RunDirectory
from qdenv.types import InputError

if TYPE_CHECKING:
    from qdenv.study.options import Driving
    from qdenv.view.page import Page
    from qdenv.view.report.subjects import Subject

# A run, its folder or its name in the zoo, or a layout as `read_plan` takes it.
Reported: TypeAlias = "RunDirectory | Source"


def report(
    layouts_or_run: Reported | Sequence[Reported],
    agents: int | Sequence[int] | None = None,
    domain: str | None = None,
    timesteps: int | None = None,
    seeds: int | str | Sequence[int] = 10,
    seconds_per_step: float | None = None,
    **driving: Unpack[Driving],
) -> Page:
    """Make a page to send to somebody: what layouts move, where robots wait, how sure that is.

    Args:
        layouts_or_run: a layout as `read_plan` takes it, a run or the name of one, whose best
            layout is reported on; or a list of them.
        agents: one number, around which others are chosen; or several, in place of those; as in
            `simulate` unless given.
        domain: whose tasks the agents do.
        timesteps: horizon T; as in `simulate` unless given.
        seeds: how many runs, or a list of their seeds.
        seconds_per_step: of a timestep, to report tasks per hour, too.
        **driving: effort, planner and stop, as in `simulate`.

    Raises:
        InputError: something cannot be read, a fleet cannot work there, or a package is missing.
    """
    from qdenv.view.report.subjects import distinct

    given: Sequence[Any] = (
        layouts_or_run if isinstance(layouts_or_run, list | tuple) else [layouts_or_run]
    )
    subjects = distinct([_subject(one, domain) for one in given])
    counts = (agents,) if isinstance(agents, int) else tuple(agents or ())
    if subjects[0].plan.domain.simulator.tasks is None:
        if counts:
            raise InputError("no fleet drives in mazes: leave agents out")
        from qdenv.view.report.mazes import maze_report, solve

        return maze_report(solve(subjects, timesteps)).page
    from qdenv.study.options import make_fleet, parse_seeds
    from qdenv.view.report.build import fleet_report
    from qdenv.view.report.fleet import ask, study

    listed = seeds if isinstance(seeds, int | str) else ",".join(map(str, seeds)) + ","
    asked = ask(
        subjects,
        counts,
        timesteps,
        lambda agents, timesteps: make_fleet(agents, timesteps, **driving),
        parse_seeds(listed),
    )
    per_hour = 3600 / seconds_per_step if seconds_per_step else None
    return fleet_report(study(asked._replace(per_hour=per_hour))).page


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
    from qdenv.view.explorer import make_explorer

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
    from qdenv.study.motion import MAZES, record_fleet, trace_agent
    from qdenv.study.options import make_fleet, usual_fleet
    from qdenv.view.replay import about_episode, about_fleet, make_replay

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


def _subject(source: Reported, domain: str | None) -> Subject:
    from qdenv.view.report.subjects import Subject, is_run, subject_of_run

    if isinstance(source, RunDirectory):
        return subject_of_run(source)
    if isinstance(source, str | Path) and is_run(source):
        return subject_of_run(RunDirectory.open(source))
    plan = read_plan(source, domain)
    name = str(source) if isinstance(source, str | Path) else plan.name
    return Subject(plan.name, name, plan)
