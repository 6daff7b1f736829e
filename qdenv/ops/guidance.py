"""Find guidance, the costs of moves, for an existing floor."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from pathlib import Path
from shlex import quote
from typing import Annotated, Any, Unpack, get_args

import numpy as np
from tyro.conf import arg

from qdenv.generators import Base
from qdenv.guidance import unscaled_costs
from qdenv.io.files import reserve
from qdenv.ops import options as args
from qdenv.ops.output import Table, format_table, say
from qdenv.progress import Bar
from qdenv.ranges import PositiveFloat, PositiveInt, check_range
from qdenv.run.directory import RunDirectory
from qdenv.run.executors import Execution
from qdenv.simulation.mapf.settings import FleetConfig, describe_planner
from qdenv.study import table as studies
from qdenv.study.plans import Plan
from qdenv.study.plans import guide as guide_plan
from qdenv.types import InputError

FILE, PICTURE, ROWS = "guidance.json", "guidance.png", "before_after.csv"  # in the run's folder
_SHARES = (0.5, 0.75, 1.0, 1.25)  # of the number of agents, for which before and after are shown


def guide(
    layout: args.Source,
    agents: Annotated[PositiveInt | None, arg(aliases=("--robots",))] = None,
    model: args.Run | None = None,
    path: args.Folder = None,
    progress: bool = True,
    execution: Annotated[Execution, arg(name="")] = Execution(),  # noqa: B008 (frozen)
    **search: Unpack[args.GuideOptions],
) -> Table:
    """Find costs of moves with which a fleet finishes more tasks on an unchanged floor.

    The run's folder gets the costs (guidance.json), a picture of them, and a table of the
    throughput before and after, for several numbers of agents. A search that begins at these costs
    (--guidance) varies each of them. PIBT plans unless a planner or an effort is named.

    Args:
        layout: layout file.
        agents: number of agents (robots); by default that of the plan or its size, else 200.
        model: run of the method smooth or update, which draws the costs, without a search.
        path: folder of the run; by default a new one under runs/.
        progress: show a progress bar.
        execution: where simulations run; the result is the same everywhere.
        **search: see `GuideOptions`.

    Returns:
        a `study.table.Row` before and after, for each number of agents.

    Raises:
        InputError: the fleet cannot work on this layout, or the folder holds a run already.

    Examples:
        ``qdenv guide plan.txt --robots 60 --minutes 5``
    """
    given: dict[str, Any] = dict(search)
    minutes, base, method = (given.pop(one, None) for one in ("minutes", "guidance", "method"))
    check_range("minutes", minutes, PositiveFloat | None)
    names = "evaluations", "simulations", "seed"
    numbers = {name: given.pop(name) for name in names if name in given}
    if model is not None and (numbers or minutes or base is not None or method):
        raise InputError(f"--model {model} draws the costs: leave out what a search needs")
    if given.get("planner") is None and given.get("effort") is None:
        given["planner"] = args.PibtOptions.usual
    options = args.Fleet(given, args.RunOptions)
    plan = options.read_plan(layout)
    named = isinstance(base, str) and base in get_args(Base)
    named = named or (base is None and (plan.costs is None or method in ("smooth", "update")))
    method = method or ("smooth" if named else "costs")
    if not named and method != "costs":
        known = ", ".join(get_args(Base))
        raise InputError(f"guidance {base}: the method {method} begins at one of {known}")
    name = args.name_of(layout)
    agents, timesteps, note = options.usual(plan, agents)
    fresh = Path("runs") / f"guide-{plan.name}-{datetime.now():%Y%m%d-%H%M%S}"
    if path is not None:
        RunDirectory(Path(path)).demand_new()
    fleet = options.config(agents, timesteps)
    # These import the simulator and both compilers: refusals are faster without them.
    from qdenv.run import loop
    from qdenv.study import guides

    start = None
    if not named:
        guided = guide_plan(plan, base)
        start, base = guides.start_at(guided), guided.guidance
    with studies.about(name):
        if base is None and model is None:
            base = guides.best_base(plan, fleet)
            say(f"begins at {base}, the best of {', '.join(get_args(Base))}")
        config = guides.guide_config(plan, fleet, method, base or "none", **numbers)
    planner = describe_planner(fleet.planner)
    say(*filter(None, [note]), f"{agents} agents, {timesteps} timesteps; planner: {planner}")
    path = reserve(fresh, folder=True) if path is None else Path(path)
    if model is not None:
        costs, judged = guides.find_guidance(args.open_run(model), plan, fleet)
        path.mkdir(parents=True, exist_ok=True)
        return _show_guidance(plan, costs, fleet, path, {"model": str(model), "judged": judged})
    say(f"{config.evaluations} evaluations into {path}")
    run = loop.train(config, path, progress, execution, minutes or np.inf, start)
    return finish_guide(run, plan.name)


def finish_guide(run: RunDirectory, name: str) -> Table:
    """Choose among what a search of costs found, and write and show it."""
    from qdenv.domains.base import make_domain
    from qdenv.study import guides

    config = run.config.evaluation
    costs, judged = guides.find_guidance(run)
    plan = Plan(name, run.best.layout, make_domain(config.domain), assumed=False)
    total, done = run.config.evaluations, run.read_metrics()[-1].evaluations
    if done < total:
        say(f"{done} of {total} evaluations are done: `qdenv resume {quote(str(run))}`")
    return _show_guidance(plan, costs, config.domain.fleet, run.path, {"judged": judged})


def _show_guidance(
    plan: Plan, costs: np.ndarray, fleet: FleetConfig, path: Path, facts: dict[str, Any]
) -> Table:
    """Write costs (int32 [5, H, W]), draw them, and simulate the plan with and without them."""
    from qdenv.io.layouts import write_layout
    from qdenv.study.recordings import MOST_SHOWN, count_moves, record_fleet
    from qdenv.view.guidance import draw_guidance  # imports matplotlib
    from qdenv.view.style import save_figure

    domain, free = plan.domain, plan.domain.drivable(plan.layout)
    unscaled = unscaled_costs(costs, free)
    guided = plan._replace(costs=unscaled)
    details = {"domain": domain.name, "agents": fleet.agents}
    write_layout(path / FILE, plan.layout, domain.tiles, domain.meanings, unscaled, **details)
    recorded = replace(fleet, timesteps=min(fleet.timesteps, MOST_SHOWN // fleet.agents))
    moves = count_moves(record_fleet(guided, recorded)[0].positions, plan.layout.shape)
    title = f"{plan.name}, {fleet.agents} agents"
    save_figure(draw_guidance(free, unscaled, moves, title), path / PICTURE)
    most = int(free.sum())
    counts = sorted({min(max(round(share * fleet.agents), 1), most) for share in _SHARES})
    trial = studies.Trial(domain.simulator.tasks, fleet, counts, range(10))
    floors = {"before": plan._replace(costs=None).floor, "after": guided.floor}
    with Bar("simulating before and after") as bar:
        rows = studies.compare(floors, trial, progress=bar)
    changes = studies.differences(rows)
    half = len(counts)
    table: list[tuple[str, ...]] = [("agents", "before", "after", "change (95 %)")]
    for before, after, change in zip(rows[:half], rows[half:], changes[half:], strict=True):
        means = [f"{row.mean_of_all:.3f} +- {row.error_of_all:.3f}" for row in (before, after)]
        table.append((str(before.agents), *means, str(change)))
    studies.write_rows(path / ROWS, rows)
    say(f"{path / FILE}, {PICTURE}, {ROWS}", *format_table(table))
    return Table(rows, facts | {"guidance": str(path / FILE)})
