"""Operations that search: presets and the zoo, a new run, a run continued; what a search costs."""

from __future__ import annotations

import dataclasses
import os
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from tyro.conf import Positional, Suppress, arg

from qdenv.agent.settings import TrainConfig
from qdenv.configurations import PRESETS, find_preset
from qdenv.domains.base import DOMAINS, find_domain, make_domain
from qdenv.io.files import check_writable, reserve
from qdenv.io.records import read_json
from qdenv.ops import options as args
from qdenv.ops.costs import describe_cost, remember_cost
from qdenv.ops.guidance import finish_guide
from qdenv.ops.improve import SETTINGS, improve_folder
from qdenv.ops.networks import train_agent
from qdenv.ops.output import PICTURES, Result, format_table, place, say
from qdenv.ops.runs import plot_one
from qdenv.run.config import override, planner_of, resolve
from qdenv.run.directory import RunDirectory, find_start
from qdenv.run.executors import Execution
from qdenv.search.registry import ALGORITHMS
from qdenv.shipped import PREFIX, Collection, Driven, Origin, Shipped, named, names
from qdenv.simulation.mapf.settings import describe_planner
from qdenv.study.options import keep_from
from qdenv.study.plans import resolve_plan, with_tasks
from qdenv.types import InputError

# Name of a preset, or a whole configuration.
Preset: TypeAlias = Annotated[Any, Positional, args.option("PRESET", str, names=tuple(PRESETS))]
ZooName: TypeAlias = Annotated[str, Positional, arg(metavar="[DOMAIN[/NAME]]")]
_ZOO_PLANNERS = {"high": "high effort", "published": "PBS", "agent": "the agent"}


def presets() -> Result:
    """List the presets: what each searches for, and how long that takes on this machine.

    Returns:
        ``presets``, a record for each, and ``sizes`` with numbers of their own.

    Examples:
        ``qdenv presets``
    """
    table, sizes = [], []
    for name, config in PRESETS.items():
        settings = config.evaluation.domain
        table.append(
            {
                "preset": name,
                "domain": DOMAINS.name_of(settings),
                "size": f"{settings.rows} x {settings.cols}",
                "agents": settings.fleet.agents if settings.fleet else 1,
                "steps": settings.horizon,
                "evaluations": config.evaluations,
                "takes": describe_cost(config) or "not known",
                "alpha": config.evaluation.alpha,
                "algorithm": ALGORITHMS.name_of(config.algorithm),
                "simulations": config.evaluation.simulations,
            }
        )
    head = ("preset", "domain", "algorithm", "size", "agents", "steps", "evaluations", "takes")
    say(*format_table([head, *([row[name] for name in head] for row in table)]))
    say("agents: robots in a simulation; steps: its timesteps; evaluations: layouts simulated")
    say("", "sizes with defaults of their own (for train, fleets' timesteps are not among them):")
    for name in dict.fromkeys(str(row["domain"]) for row in table):
        domain = find_domain(name)
        for (rows, cols), size in domain.known.items():
            agents = {"agents": size.agents} if domain.simulator.tasks else {}
            steps = {"timesteps": size.timesteps, "steps of growth": size.steps}
            numbers = dict(size.numbers) | agents | steps
            sizes.append({"domain": name, "size": f"{rows} x {cols}", **numbers})
            listed = ", ".join(f"{value} {name}" for name, value in numbers.items())
            say(f"  {domain.name}, {rows} x {cols}: {listed}")
    return Result({"presets": table, "sizes": sizes, "settings": {}})


def train(
    preset: Preset = "quick",
    path: args.Folder = None,
    progress: bool = True,
    execution: Annotated[Execution, arg(name="")] = Execution(),  # noqa: B008 (frozen)
    plan: args.PlanFile = None,
    keep: args.KeepCells = None,
    pictures: Suppress[args.OnCommandLine] = False,
    **settings: Annotated[Any, args.Mark.PRESET],
) -> RunDirectory:
    """Search for generators of floor plans by a preset; any setting can be overridden.

    Args:
        preset: settings to begin with; `qdenv presets` lists what each is and how long it takes.
        path: folder of the run; by default a new one under runs/.
        progress: show a progress bar.
        execution: where layouts are repaired and simulated; the result is the same everywhere.
        plan: floor plan; all layouts get its size, numbers of tiles, walls and stations.
        keep: what must stay of the plan: tiles (w), a rectangle (0:7,33:40), or a drawing (? is
            free).
        pictures: draw the run when it ends, as the command does.
        **settings: in place of the preset's, by the names of `qdenv train --help-all` with
            underscores: evaluations=300, seed=3, alpha=1.0, agents=40, shelves=60. Domains,
            planners, generators and algorithms may be named, or given as settings:
            planner="pbs", planner=PbsConfig(rule="plain"). What is not stated follows the size:
            numbers of tiles, agents, steps and axes.

    Returns:
        the run, whose ``archive`` and ``best`` are what was found.

    Raises:
        InputError: a name is unknown, a setting is impossible, or the folder holds a run already.

    Examples:
        ``qdenv train laptop --algorithm map-elites --seed 3 --out runs/first``
    """
    base, name = (find_preset(preset), preset) if isinstance(preset, str) else (preset, "run")
    if execution.workers is not None:
        settings = {"workers": execution.workers, **settings}
    if plan is not None:
        domain = settings.pop("domain", None)
        if not isinstance(domain, str | None):
            raise InputError("domain: with a plan give a name, the settings are the plan's")
        whose = args.read_plan(plan, domain)
        if "demand" in settings:
            whose = with_tasks(whose, {"demand": settings.pop("demand")})
        config, scaled = resolve_plan(base, settings, whose, keep)
    elif "demand" in settings:
        raise InputError("demand belongs to places on a plan: add --plan FILE")
    else:
        config, scaled = resolve(base, settings)
    find_start(config)  # it refuses what cannot be one before anything is logged
    execution = dataclasses.replace(execution, workers=config.evaluation.repair.workers)
    if keep is not None and plan is None:
        kept = keep_from(keep, make_domain(config.evaluation.domain))
        config = override(config, {"evaluation__domain": kept.config})
    fresh = path is None
    path = Path(f"runs/{name}-{datetime.now():%Y%m%d-%H%M%S}" if path is None else path)
    if path.as_posix().startswith(PREFIX):
        raise InputError(f"{path}: names that begin with {PREFIX} ship with qdenv: name a folder")
    # A place that cannot be written to is refused now, not after hours of search.
    check_writable(path / "config.json")
    RunDirectory(path).demand_new()
    path = reserve(path, folder=True) if fresh else path
    if scaled:
        say(f"for this size: {scaled}")
    cost, planner = describe_cost(config), planner_of(config)
    who = f"; planner: {describe_planner(planner)}" if planner else ""
    say(f"{name}: {config.evaluations} evaluations into {path}{cost and f', {cost}'}{who}")
    # This imports both compilers: refusals are faster without them.
    from qdenv.run import loop

    run = loop.train(config, path, progress, execution)
    if pictures:
        plot_one(run)
    remember_cost(config, run.read_metrics())
    return run


def resume(
    run: args.Run,
    progress: bool = True,
    evaluations: int | None = None,
    execution: Annotated[Execution, arg(name="")] = Execution(),  # noqa: B008 (frozen)
    pictures: Suppress[args.OnCommandLine] = False,
) -> RunDirectory | Path:
    """Continue a run where it stopped: a search, an improvement, or an agent's training.

    Args:
        run: folder of the run.
        progress: show a progress bar.
        evaluations: a new total of one search, to continue beyond the configured one.
        execution: where layouts are repaired and simulated; the result is the same everywhere.
        pictures: draw the run when it ends, as the command does.

    Returns:
        the run; of an improvement its folder, of an agent its file.

    Raises:
        InputError: there is no run, it was written by a newer version or with other settings, or
            another process is at work on it.

    Examples:
        ``qdenv resume runs/first``
    """
    path = run.path if isinstance(run, RunDirectory) else Path(run)
    improved = [path] if (path / SETTINGS).exists() else []
    part = Path(os.path.abspath(path))
    if (part.parent / SETTINGS).exists():  # the searches of an improvement go on together
        from qdenv.study.improve import SECTIONS  # imports both compilers

        improved += [part.parent] * (part.name in SECTIONS)
    agent = (path / "checkpoint.npz").exists() and (path / "config.json").exists()
    if evaluations is not None and (improved or agent):
        raise InputError(f"{path} is not the run of one search: leave --evaluations out")
    if improved:
        improve_folder(improved[0], progress, execution)
        return improved[0]
    if agent:
        return train_agent(read_json(path / "config.json", TrainConfig), path, resume=True)
    opened = RunDirectory.open(path)
    opened.demand_own()
    total = opened.config.evaluations
    if evaluations is not None and evaluations < total:
        more = "give a larger number, or leave --evaluations out"
        raise InputError(f"{path}: {total} evaluations are configured already: {more}")
    from qdenv.run import loop  # imports both compilers

    done = loop.resume(path, progress, evaluations, execution)
    if not getattr(opened.config.evaluation.generator, "draws", True):
        finish_guide(done, path.name)
    elif pictures:
        plot_one(done)
    return done


def zoo(name: ZooName = "", plot: args.Picture = None) -> Result:
    """List the trained generators that ship with qdenv, and how good their layouts are.

    Commands that read a run take zoo:DOMAIN/NAME as well, except `resume` and `surrogate`.

    Args:
        name: a domain, to list only its own, or one generator, to list all about it.
        plot: picture to write, of their layouts at the trained size; by default zoo.png.

    Returns:
        ``domains``, each with its generators, and for these what was measured at each size.

    Raises:
        InputError: there is no such domain or generator.

    Examples:
        ``qdenv zoo warehouse-even/best``
    """
    text = name.removeprefix(PREFIX)
    found = [named(one).collection for one in ([text] if text else names())]
    only, picture = named(text) if "/" in text else None, place(plot, "zoo.png", PICTURES)
    if only:
        found = [dataclasses.replace(only.collection, generators=(only.generator,))]
        say(*_describe_generator(only))
    else:
        for number, one in enumerate(found):
            say(*[""] * (number > 0), *_describe_collection(one))
    if picture:
        from qdenv.view.layouts import draw_sheet  # imports matplotlib

        panels = []
        for shipped in [Shipped(one, each) for one in found for each in one.generators]:
            run, sizes = RunDirectory.open(str(shipped)), shipped.generator.sizes
            lines = [f"{size.rows} x {size.cols}: {_figure(size.driven[0])}" for size in sizes]
            title = str(shipped).removeprefix(PREFIX) if len(found) > 1 else shipped.generator.name
            panels.append((run.best.layout, run.schema.tiles, title, "\n".join(lines)))
        picture.draw(draw_sheet(panels))
    return Result({"domains": [*map(dataclasses.asdict, found)], "settings": {"name": text}})


def _describe_collection(collection: Collection) -> list[str]:
    """Put the generators of a domain into a table, a line each."""
    generators, origin = collection.generators, collection.origin
    cases = [(size, row) for size in generators[0].sizes for row in size.driven]
    columns = [f"{size.rows} x {size.cols}, {_ZOO_PLANNERS[row.planner]}" for size, row in cases]
    lines = [["generator", *columns, "what it is"]]
    for one in generators:
        cells = [_figure(row) for size in one.sizes for row in size.driven]
        lines.append([f"{PREFIX}{collection.domain}/{one.name}", *cells, one.about])
    runs = [f"{column}: {_runs(row)}" for column, (_, row) in zip(columns, cases, strict=True)]
    return [
        f"{collection.domain}: from {_search(origin)}; {origin.counted}, "
        "+- standard error, (share of the runs that succeed)",
        "; ".join(runs),
        *format_table(lines),
    ]


def _describe_generator(shipped: Shipped) -> list[str]:
    """Describe one generator, line by line, and its layouts of all sizes."""
    one, origin = shipped.generator, shipped.collection.origin
    lines = [
        f"{shipped}: {one.about}",
        f"from         {_search(origin)}, begun {origin.created}",
        f"elite        {','.join(map(str, one.cell))}, objective {one.objective:.4g}",
    ]
    for size in one.sizes:
        numbers = "".join(f", {value} {name}" for name, value in size.numbers.items())
        measures = "".join(f", {name} {value:.4g}" for name, value in size.measures.items())
        repair = "" if size.repair == "none" else f", repair changed {size.changed} cells"
        shape = f"{size.rows} x {size.cols}"
        lines.append(f"{shape:12} {size.steps} steps of growth{numbers}{repair}{measures}")
        for row in size.driven:
            figure = f"{_figure(row)} {origin.counted}"
            lines.append(f"             {_ZOO_PLANNERS[row.planner]}, {_runs(row)}: {figure}")
    rows, cols = one.sizes[-1].rows, one.sizes[-1].cols
    return [*lines, f"grow it      qdenv generate {shipped} --rows {rows} --cols {cols}"]


def _search(origin: Origin) -> str:
    """Describe in a clause the runs that the generators of a domain come from."""
    further = f", {origin.further:,} more from other elites" if origin.further else ""
    start = f" from the former {origin.start}" if origin.start else ""
    return (
        f"{origin.evaluations:,} evaluations of {origin.run}{start}, {origin.algorithm}, "
        f"seed {origin.seed}{further}, qdenv {origin.qdenv}"
    )


def _runs(row: Driven) -> str:
    agents = f"{row.agents} agent{'s' * (row.agents != 1)}"
    return f"{agents}, {row.timesteps} timesteps, {row.runs} run{'s' * (row.runs != 1)}"


def _figure(row: Driven) -> str:
    error = "" if row.error is None else f" +- {row.error:.3f}"
    return f"{row.mean:.3f}{error} ({row.success:.0%})"
