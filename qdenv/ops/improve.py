"""From one's own plan to a better one: lanes, some racks, racks in rows, a new floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Unpack

import numpy as np
from tyro.conf import arg

from qdenv.domains.base import DOMAINS, make_domain
from qdenv.domains.hall import GENERATED, BuiltConfig
from qdenv.interrupt import advise
from qdenv.io.files import damaged, locked, write_csv, write_json
from qdenv.io.formats import holds
from qdenv.io.layouts import ENDINGS, endings_for
from qdenv.io.records import read_json, structured, unstructured
from qdenv.ops import options as args
from qdenv.ops.output import Layout, Place, Table, format_table, say
from qdenv.progress import Bar
from qdenv.repairs.rules import impossible
from qdenv.run.directory import RunDirectory
from qdenv.run.executors import Execution
from qdenv.simulation.mapf.settings import PLANNERS, describe_planner
from qdenv.study.options import fleet_tasks
from qdenv.study.plans import Plan
from qdenv.study.plans import read_plan as read_file
from qdenv.types import InputError, about

SETTINGS, PLAN = "improve.json", "plan.json"  # in the folder
ROWS, REPORT = "improve.csv", "report.html"
_CHOICES = {"domain": DOMAINS, "planner": PLANNERS}


class Improvement(NamedTuple):
    """What one section found, beside the plan."""

    section: str  # lanes, racks, rows or floor
    lanes: str  # costs of moves that are part of it; "none"
    racks_moved: int  # cells from which a shelf of the plan is gone
    agents: int  # for which the next three are
    throughput: float  # tasks per timestep, averaged over all seeds
    percent: float  # how much more than the plan
    low: float  # lower end of its 95 % interval
    high: float  # upper end
    # percent where all shelves are alike; None for more robots, stated demand, or no hall
    by_shelf: float | None
    better: bool  # all intervals of the section lie above the plan: its plan was written


def improve(
    layout: args.Source,
    agents: args.Agents = None,
    path: args.Folder = None,
    progress: bool = True,
    execution: Annotated[Execution, arg(name="")] = Execution(),  # noqa: B008 (frozen)
    keep: args.KeepCells = None,
    **search: Unpack[args.ImproveOptions],
) -> Table:
    """Search for a better plan than your own: lanes, some racks moved, racks in rows, a new floor.

    The folder gets up to four searches and a picture of what moving more racks brings. For each
    plan that is better (by its 95 % intervals, at this number of robots and at a quarter more) it
    gets the plan and a picture of before and after, for all of them a report. The same command, or
    `qdenv resume`, continues where it stopped.

    Args:
        layout: layout file.
        agents: number of agents (robots); by default that of the plan or its size, else 200.
        path: results folder; by default runs/improve-NAME-AGENTS.
        progress: show a progress bar.
        execution: where the searches simulate; the result is the same everywhere.
        keep: what must stay besides walls and stations: tiles, a rectangle of rows and columns, the
            last ones not included (0:7,33:40), or a drawing; + joins several.
        **search: see `ImproveOptions`.

    Returns:
        an `Improvement` for each section and number of agents.

    Raises:
        InputError: the fleet cannot work on this layout, or the folder holds something else.

    Examples:
        ``qdenv improve plan.txt --robots 60 --minutes 10 --out better``
    """
    given: dict[str, Any] = dict(search)
    minutes, evaluations = given.pop("minutes", None), given.pop("evaluations", None)
    if minutes is None and evaluations is None:
        minutes = 10.0
    numbers = {name: given.pop(name) for name in ("moves", "seed") if name in given}
    named = ("shelves", *BuiltConfig.__annotations__)
    rules: dict[str, Any] = {name: given.pop(name) for name in named if name in given}
    options = args.Fleet(given, args.RunOptions)
    plan = options.read_plan(layout)
    agents, timesteps, note = options.usual(plan, agents)
    fleet = options.config(agents, timesteps)
    tasks = fleet_tasks(plan.layout, plan.domain.simulator.tasks, agents)
    with about(f"a quarter more than {agents} robots are simulated, too"):
        fleet_tasks(plan.layout, tasks, round(1.25 * agents))
    fitted = plan.fitted(rules, keep)
    if fitted.rules and (reason := impossible(fitted.rules())):
        raise InputError(f"{plan.name}: no layout obeys all rules: {reason}")
    settings = replace(fitted.config, fleet=fleet)
    from qdenv.study.improve import ImproveConfig  # imports the whole chain

    ending = Path(args.name_of(layout)).suffix.lower()
    held = endings_for(fitted.tiles, fitted.meanings)
    ending = ending if ending in ENDINGS and ending in held else ".json"
    config = ImproveConfig(settings, ending, minutes=minutes, evaluations=evaluations, **numbers)
    folder = Path(path) if path else Path("runs") / f"improve-{plan.name}-{agents}"
    _begin(folder, plan, config)
    planner = describe_planner(options.planner)
    say(*filter(None, [note]), f"{agents} robots, {timesteps} timesteps; planner: {planner}")
    return improve_folder(folder, progress, execution)


def _begin(folder: Path, plan: Plan, config: Any) -> None:
    """Write plan and settings into a new folder, or check that an old one holds the same."""
    if (folder / SETTINGS).exists():
        # Compared as settings, not as text: what an earlier version lacked has its default.
        same = _read_settings(folder) == (plan.name, config)
        parts: Any = zip(read_file(folder / PLAN).floor, plan.floor, strict=True)
        if not same or not all(np.array_equal(*pair) for pair in parts):
            raise InputError(f"{folder}: holds another plan or other settings: name a new --out")
        return
    RunDirectory(folder).demand_own()
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder}: holds something else: name a new folder with --out")
    Layout(plan.layout, plan.domain, plan.facts.details, costs=plan.costs).save(folder / PLAN)
    write_json(folder / SETTINGS, unstructured(config, _CHOICES) | {"name": plan.name})


def _read_settings(folder: Path) -> tuple[str, Any]:
    """Read the plan's name and the settings (`ImproveConfig`) in a folder."""
    from qdenv.study.improve import ImproveConfig

    path = folder / SETTINGS
    content = read_json(path, dict[str, Any])
    name = structured(content.pop("name", None), str, path)
    return name, structured(content, ImproveConfig, path, choices=_CHOICES)


def improve_folder(
    folder: Path,
    progress: bool = True,
    execution: Execution = Execution(),  # noqa: B008 (frozen)
) -> Table:
    """Finish what `improve` began in `folder`; InputError if its files were altered."""
    from qdenv.study import improve as studies
    from qdenv.study.guides import find_guidance

    name, config = _read_settings(folder)
    if config.ending not in ENDINGS:  # it is part of names that are written
        raise damaged(folder / SETTINGS, f"ending: must be one of {', '.join(ENDINGS)}")
    with locked(folder):  # nothing is written through a link either
        domain, found, lanes = make_domain(config.domain), {}, None
        plan = read_file(folder / PLAN)._replace(name=name, domain=domain, keep=config.domain.keep)
        advise(folder)
        for section, (title, _) in studies.SECTIONS.items():
            if section == "lanes" and not PLANNERS.make(config.fleet.planner).reads_costs:
                say(f"{title}: the planner knows no costs of moves, so none are searched")
                continue
            if section == "rows" and domain.generated != GENERATED:
                say(f"{title}: {domain.name} has no shelves with endpoints, so none are drawn")
                continue
            if not (folder / section / "config.json").exists():
                say(f"{title}:")
            _search(folder, section, plan, config, progress, execution)
            if section == "lanes":
                lanes, _ = find_guidance(RunDirectory.open(folder / "lanes"))
            found[section] = studies.list_candidates(plan, folder, section, lanes)
        with Bar("judging") as bar:
            judged = studies.judge(plan, found, config, bar)
        return _finish(folder, plan, config, judged)


def _search(
    folder: Path, section: str, plan: Plan, config: Any, progress: bool, execution: Execution
) -> None:
    """Begin the run of a section or go on with it, as long as it has evaluations and minutes."""
    from qdenv.run import loop
    from qdenv.study import improve as studies

    path, minutes = folder / section, np.inf
    if config.minutes:
        minutes = config.minutes * studies.SECTIONS[section][1]
    if (path / "config.json").exists():
        run = RunDirectory.open(path)
        rows = run.read_metrics()
        spent = rows[-1].seconds / 60 if rows else 0.0
        if spent < minutes and (not rows or rows[-1].evaluations < run.config.evaluations):
            loop.resume(path, progress, None, execution, minutes - spent)
        return
    evaluations = studies.count_evaluations(plan, config, section)
    start = _choose_start(folder, plan, config) if section == "floor" else plan.layout
    run_config = studies.search_config(section, plan, start, config, evaluations)
    loop.train(run_config, path, progress, execution, minutes)


def _choose_start(folder: Path, plan: Plan, config: Any) -> np.ndarray:
    """Choose the best of the plan, racks in rows and floors that generators draw (int8 [H, W]).

    By whole runs: in the short ones of a search, floors that fill up later look as good.
    """
    from qdenv.study import improve as studies

    with Bar("growing generators of the zoo") as bar:
        zoo = [*studies.zoo_floors(plan.domain, config.seed, bar)]
    rows = studies.best_layouts(folder / "rows") if (folder / "rows").exists() else []
    others = [*zoo, *((f"racks in rows {n}", one) for n, one in enumerate(rows, 1))]
    floors = [plan, *(plan._replace(name=name, layout=one, costs=None) for name, one in others)]
    worths = [studies.mean_throughput(one, config.fleet, range(2)).mean() for one in floors]
    best = floors[int(np.argmax(worths))]
    lines = [(one.name, f"{worth:.3f}") for one, worth in zip(floors, worths, strict=True)]
    say(*format_table([("floor", "throughput"), *lines]), f"the search begins at {best.name}")
    return best.layout


def _finish(folder: Path, plan: Plan, config: Any, judged: Sequence[Any]) -> Table:
    """Write and print what is better, section by section, and draw what moving racks brings."""
    from qdenv.study import improve as studies
    from qdenv.view.change import draw_racks_moved  # imports matplotlib

    rows, counts = [], [config.fleet.agents, round(studies.CROWD * config.fleet.agents)]
    table = [("section", "lanes", "shelves moved", *(f"{one} robots (95 %)" for one in counts))]
    if any(one.by_shelf for one in judged):
        table[0] += (f"{counts[0]}, all shelves alike",)
    drivable = plan.domain.drivable
    for one in judged:
        title, lanes = studies.SECTIONS[one.section][0], one.plan.guidance
        moved = int((drivable(one.plan.layout) & ~drivable(plan.layout)).sum())
        cells: list[str] = []
        for number, agents, change in zip(one.throughput, counts, one.changes, strict=True):
            figures = change.percent, change.low, change.high
            facts = one.section, lanes, moved, agents, float(number.mean())
            by_shelf = one.by_shelf.percent if one.by_shelf and not cells else None
            rows.append(Improvement(*facts, *figures, by_shelf, one.is_better))
            cells.append(str(change))
        cells += [str(one.by_shelf)] if one.by_shelf else []
        table.append((title, lanes, str(moved), *cells))
        if one.is_better:
            _write(folder, plan, one.plan, title, config)
    write_csv(folder / ROWS, Improvement._fields, rows)
    say(folder / ROWS, *format_table(table))
    found = {}  # what the searches found over the racks that they moved
    for section in studies.SECTIONS:
        if section != "lanes" and (folder / section).exists():
            columns = RunDirectory.open(folder / section).archive.columns
            moves = (drivable(columns["repaired"]) & ~drivable(plan.layout)).sum(axis=(1, 2))
            found[studies.SECTIONS[section][0]] = moves, columns["objective"]
    hers = studies.mean_throughput(plan, config.searched, range(4)).mean()
    figure = draw_racks_moved(found, config.searched.agents, float(hers))
    Place(folder / "racks_moved.png", False).draw(figure, crop=True)
    _report(folder, plan, [one for one in judged if one.is_better], config)
    worse = [studies.SECTIONS[one.section][0] for one in judged if not one.is_better]
    if worse:
        say(f"nothing better was found by {', '.join(worse)}: no plan is written for that")
    return Table(rows, {"folder": str(folder), "settings": asdict(config)})


def _report(folder: Path, plan: Plan, better: Sequence[Any], config: Any) -> None:
    """Make the page on the plan and what is better, where its package is installed."""
    if not better:
        return
    from qdenv.ops.pages import report
    from qdenv.study.improve import JUDGES, SECTIONS

    fleet = config.fleet
    plans = [one.plan._replace(name=SECTIONS[one.section][0]) for one in better]
    options: Any = {"timesteps": fleet.timesteps, "planner": fleet.planner, "seeds": [*JUDGES]}
    options["stop"] = fleet.stop_when_congested
    try:
        report([plan, *plans], fleet.agents, folder / REPORT, **options)
    except InputError as error:  # the plans are written: a page that cannot be is no reason to fail
        say(f"{REPORT}: {error}")


def _write(folder: Path, plan: Plan, after: Plan, title: str, config: Any) -> None:
    """Write a better plan, its guidance, and the picture of before and after."""
    from qdenv.study.improve import map_usage
    from qdenv.view.change import draw_change  # imports matplotlib

    domain, costs, name = plan.domain, after.costs, title.replace(" ", "_")
    target = folder / f"{name}{config.ending}"
    written = [target]
    if costs is not None and not holds(config.ending, "weights"):
        written.append(folder / f"{name}_guidance.json")
        Layout(after.layout, domain, costs=costs).save(written[1])
        costs = None
    Layout(after.layout, domain, plan.facts.details, costs=costs).save(target)
    usages = map_usage(plan, config.fleet), map_usage(after, config.fleet)
    say(*written)
    figure = draw_change(plan, after, usages, (plan.name, title))
    Place(folder / f"{name}.png", False).draw(figure, crop=True)
