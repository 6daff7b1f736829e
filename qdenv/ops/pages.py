"""Operations that make pages: a run to replay, an archive to explore, a report to send."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, Unpack

from tyro.conf import Positional, Suppress, arg

from qdenv import devices
from qdenv.domains.base import make_domain
from qdenv.ops import options as args
from qdenv.ops.output import format_duration, place, say
from qdenv.progress import Bar
from qdenv.ranges import NonNegativeInt, PositiveInt, Ranged, Seed
from qdenv.run.directory import RunDirectory
from qdenv.shipped import PREFIX, file_name
from qdenv.simulation.mapf.settings import OWN, PLANNERS, record_planner
from qdenv.study import recordings as studies
from qdenv.study.options import fleet_tasks, parse_counts, parse_seeds
from qdenv.study.plans import Plan, name_guidance
from qdenv.study.recordings import MAZES, Motion
from qdenv.study.table import Row
from qdenv.types import InputError, require_package
from qdenv.view.page import Page
from qdenv.view.replay import about_fleet, make_replay
from qdenv.view.report_subjects import Subject, distinct

if TYPE_CHECKING:  # imports the simulator
    from qdenv.view.report_fleet import FleetRequest

_LONG = 20.0  # seconds from which on an estimate of the time is logged

# Layouts and runs, one or several; both are named in the same way on command lines.
Subjects: TypeAlias = Annotated[
    Any, Positional, arg(metavar="RUN|LAYOUT ...", constructor=tuple[Path, ...])
]


@dataclasses.dataclass(frozen=True)
class FilmOptions(Ranged):
    """Films beside the page, for where no page can be opened."""

    gif: args.Picture = None  # draw an animated GIF
    mp4: args.Picture = None  # draw a film
    first: NonNegativeInt = 0  # timestep at which films begin
    # timestep at which films end; by default the end of the run, but in a GIF of robots 100
    # timesteps after the first
    last: PositiveInt | None = None

    def __post_init__(self) -> None:
        """Refuse impossible stretches of time."""
        super().__post_init__()
        if self.last is not None and self.last <= self.first:
            stretch = f"--first {self.first} --last {self.last}"
            raise InputError(f"{stretch}: give timesteps, the first before the last")
        if (self.first or self.last is not None) and not (self.gif or self.mp4):
            raise InputError("--first and --last are for films: add --gif or --mp4")

    def check_end(self, timesteps: int | None) -> None:
        """Refuse films that begin when the run is over; None where its end is not known yet."""
        if timesteps is not None and self.first >= timesteps:
            raise InputError(f"--first {self.first}: the run ends at timestep {timesteps}")


def replay(
    layout: args.Source,
    agents: args.Agents = None,
    seed: Seed = 0,
    films: Annotated[FilmOptions, arg(name="")] = FilmOptions(),
    out: args.Out = None,
    **fleet: Unpack[args.RunOptions],
) -> Page:
    """Replay one run in a browser: robots, goals, jams, tile usage; in a maze, the agent's path.

    Args:
        layout: layout file.
        agents: number of agents (robots); by default that of the plan or its size, else 200.
        seed: seed of the run.
        films: beside the page.
        out: page to write (.html), one file that needs no network; by default LAYOUT_replay.html.
        **fleet: see `RunOptions`.

    Returns:
        the page, with throughput, tasks and share of waiting among its facts.

    Raises:
        InputError: a name is unknown, the fleet cannot work on this layout, or a package is
            missing.

    Examples:
        ``qdenv replay plan.txt --robots 60 --out replay.html``
    """
    options = args.Fleet(fleet, args.RunOptions)
    plan = options.read_plan(layout)
    outputs = {".html": out, ".gif": films.gif, ".mp4": films.mp4}
    target, *drawn = (
        place(path, f"{plan.name}_replay{ending}", (ending,), [layout])
        for ending, path in outputs.items()
    )
    require_package("pages", "jinja2")
    if films.mp4:
        require_package("films", "imageio-ffmpeg")
    if plan.domain.name in MAZES:
        _refuse_fleet(agents, options, plan)
        page, motion, facts = _replay_episode(plan, options.timesteps, seed, films)
    else:
        page, motion, facts = _replay_fleet(plan, agents, options, seed, films)
    if any(drawn):
        films.check_end(motion.steps)
    if target:
        page.save(target.path)
        say(target)
        facts["page"] = target.path
    for film in filter(None, drawn):
        from qdenv.view.film import save_film  # imports matplotlib

        last, ending = films.last or motion.steps, film.path.suffix.lower()
        if ending == ".gif" and not films.last and motion.headings is None:
            last = films.first + 100  # a GIF of robots grows by megabytes
        with Bar(f"drawing {film.path}") as bar:
            save_film(film.path, plan.layout, plan.domain.tiles, motion, (films.first, last), bar)
        say(film)
        facts[ending[1:]] = film.path
    facts["megabytes"] = len(page.html.encode()) / 1e6
    settings = {"layout": args.name_of(layout), "domain": plan.domain.name, "seed": seed}
    facts["settings"] = {**settings, "timesteps": motion.timesteps}
    return dataclasses.replace(page, facts=facts)


def _refuse_fleet(agents: object, options: args.Fleet, plan: Plan) -> None:
    """Raise InputError where a maze is to have agents or their planner."""
    if agents is not None:
        cure = ", or add --domain map" if plan.assumed else ""
        raise InputError(f"one agent walks in a maze: leave --agents out{cure}")
    if options.effort or PLANNERS.name_of(options.planner) != OWN or not options.stop:
        raise InputError("mazes have no planner: leave --planner, --effort and --no-stop out")


def _replay_fleet(
    plan: Plan, agents: int | None, options: args.Fleet, seed: int, films: FilmOptions
) -> tuple[Page, Motion, dict[str, Any]]:
    """Simulate a fleet once and make its page."""
    agents, timesteps, note = options.usual(plan, agents)
    films.check_end(timesteps)
    config = options.config(agents, timesteps)
    fleet_tasks(plan.layout, plan.domain.simulator.tasks, agents)
    with Bar("simulating") as bar:
        motion, traffic = studies.record_fleet(plan, config, seed, bar)
    about = about_fleet(plan, config, seed, motion, traffic)
    guidance = name_guidance([plan])
    about += [f"guidance: {guidance}"] * bool(guidance)
    say(*about, plan.whose, *[note] * bool(note))
    facts = {
        "agents": config.agents,
        "planner": record_planner(config.planner),
        "stop": options.stop,
        "throughput": float(traffic.throughput),
        "finished_tasks": int(motion.finished.sum()),
        "congested_at": int(traffic.congested_at) or None,
        "end_timestep": motion.steps,
        "waiting_share": float(motion.waits.mean()) if motion.steps else None,
    } | ({"guidance": guidance} if guidance else {})
    return make_replay(plan, motion, traffic, about), motion, facts


def _replay_episode(
    plan: Plan, timesteps: int | None, seed: int, films: FilmOptions
) -> tuple[Page, Motion, dict[str, Any]]:
    """Let the agent walk through a maze once and make its page."""
    films.check_end(timesteps)
    with Bar("walking"):
        motion = studies.trace_agent(plan, seed, timesteps)
    success = bool(motion.finished.any())
    about = (
        f"goal {'reached' if success else 'not reached'} after {motion.steps:,} actions of at most "
        f"{motion.timesteps:,}, shortest path {motion.shortest} moves, seed {seed}"
    )
    say(about)
    facts = {"success": success, "actions": motion.steps, "shortest": motion.shortest}
    return make_replay(plan, motion, None, [about]), motion, facts


def explore(run: args.Run, growth: NonNegativeInt | None = None, out: args.Out = None) -> Page:
    """Make a page on which to explore a run's archive: layouts, numbers, growth.

    The page is one file, which a browser opens from disk, without a network.

    Args:
        run: folder of the run.
        growth: number of elites whose growth the page shows, the best among them; by default as
            many as take about 12 MB.
        out: page to write; by default explorer.html.

    Returns:
        the page, with the numbers of elites among its facts.

    Raises:
        InputError: there is no elite, there are more than two measures, or a package is missing.

    Examples:
        ``qdenv explore zoo:warehouse-even``
    """
    opened, target = args.open_run(run), place(out, "explorer.html", (".html",))
    from qdenv.view.explorer import make_explorer  # imports jax

    with Bar("growing") as bar:
        page = make_explorer(opened, growth, bar)
    if target:
        page.save(target.path)
        elites = f"{page.facts['elites']} elites, {page.facts['growth']} of them grow"
        say(f"{target}: {elites}, {page.facts['megabytes']:.1f} MB")
    settings = {"run": str(run), "growth": growth}
    return dataclasses.replace(page, facts={**page.facts, "settings": settings})


def report(
    sources: Subjects,
    agents: args.Counts = None,
    out: args.Out = None,
    again: Suppress[str] = "",
    **fleet: Unpack[args.FleetOptions],
) -> Page:
    """Make a page to send or print: which floor plan moves more, by how much, where robots wait.

    Further layouts are compared with the first one, and each with what people draw by hand at its
    size, if both have the same stations.

    Args:
        sources: layout files, and runs or zoo:DOMAIN/NAME, whose best layout is reported on.
        agents: number of agents (robots); by default the first plan's or that of their size, else
            200. Half as many to half as many again are simulated as well. Several (50,100 or
            50:400:50) replace those; the first layout's peak is then looked at closely.
        out: page to write (.html); by default report.html.
        again: the command line that makes the page again, which it shows.
        **fleet: see `FleetOptions`.

    Returns:
        the page, with all its numbers among its facts.

    Raises:
        InputError: something cannot be read, a fleet cannot work there, or a package is missing.

    Examples:
        ``qdenv report before.txt after.txt --robots 60``
    """
    require_package("pages", "jinja2")
    given = list(sources) if type(sources) in (list, tuple) else [sources]
    target = place(out, "report.html", (".html",), given)
    counts, options, subjects = parse_counts(agents), args.Fleet(fleet), []
    for one in given:
        named = isinstance(one, str | Path)
        if isinstance(one, RunDirectory) or (
            named and (str(one).startswith(PREFIX) or Path(one).is_dir())
        ):
            run = args.open_run(one)
            name = str(run.shipped).removeprefix(PREFIX) if run.shipped else file_name(run.path)
            domain = make_domain(run.config.evaluation.domain)
            best = options.with_tasks(Plan(name, run.best.layout, domain, assumed=False))
            if (drawn := run.path / "best_layout.json").exists():
                saved = args.read_plan(drawn, domain.name)
                best = best._replace(costs=saved.costs, guidance=saved.guidance)
            subjects.append(Subject(name, str(run), options.guide(best), run))
        else:
            plan = options.read_plan(one)
            subjects.append(Subject(plan.name, args.name_of(one), plan))
    subjects = distinct(subjects)
    if subjects[0].plan.domain.simulator.tasks is None:
        _refuse_fleet(counts or None, options, subjects[0].plan)
        if options.seeds != parse_seeds(10):
            raise InputError("each maze has 100 episodes of seed 0: leave --seeds out")
        from qdenv.view.report_maze import report_mazes

        with Bar("solving mazes") as bar:
            page = report_mazes(subjects, options.timesteps, again, bar)
        settings = {"domain": options.domain, "timesteps": options.timesteps}
    else:
        # This imports the simulator: refusals are faster without it.
        from qdenv.view.report_fleet import make_request

        steps, hour = options.timesteps, options.per_hour
        request = make_request(subjects, counts, steps, options.config, options.seeds, hour)
        page = _report_fleet(request, again)
        settings = options.settings(options.timesteps, [one.plan for one in subjects])
    if target:
        page.save(target.path)
        say(f"{target}: {target.path.stat().st_size / 1e6:.1f} MB")
    facts = {**page.facts, "settings": settings | {"sources": [*map(str, given)]}}
    return dataclasses.replace(page, facts=facts)


def _report_fleet(request: FleetRequest, again: str) -> Page:
    """Simulate, log how long that will take, and make the page."""
    from qdenv.view.report_fleet import report_fleet

    # The first row tells what all the others will take.
    first = True
    with Bar("simulating") as bar:

        def show(row: Row) -> None:
            nonlocal first
            # A run costs as much as it has agents.
            per_agent = row.cpu_seconds_per_run * row.runs / row.agents / devices.threads()
            closely = (request.agents or max(request.counts)) * len(request.subjects)
            rest = per_agent * (len(request.floors) * sum(request.counts) + closely)
            if first and rest > _LONG:
                say(f"this takes about {format_duration(rest)} in all (an estimate)")
            first = False
            rate = f"{row.success_rate:.0%} never congested"
            say(f"{row.layout}, {row.agents} agents: {row.mean_of_all:.3f}, {rate}")

        page = report_fleet(request, again, show, bar)
    say(*(one["sentence"] for one in page.facts["decisions"]))
    agents = page.facts["agents"]
    for name, one in page.facts["layouts"].items():
        say(f"{name}, {agents} agents: {one['verdict']}, {one['verdict_reason']}")
    return page
