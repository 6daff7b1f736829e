"""Operations on one fleet: simulated on a layout, with where it jams; a run from a file checked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, Unpack

import numpy as np
from tyro.conf import Positional, arg

from qdenv.io.trajectories import read_run, write_paths
from qdenv.ops import options as args
from qdenv.ops.output import PICTURES, Result, Table, format_table, place, say
from qdenv.progress import Bar
from qdenv.simulation.mapf.settings import describe_planner
from qdenv.study import table as studies
from qdenv.study.options import fleet_tasks
from qdenv.study.plans import Plan
from qdenv.study.recordings import MOST_SHOWN, record_fleet
from qdenv.types import InputError
from qdenv.view import SCREEN, parse_width

if TYPE_CHECKING:  # imports the simulator
    from qdenv.study.traffic import Study

_SHOWN = 10  # broken rules that are printed
_NOTABLE = 0.05  # share of time in which an agent waits on a cell; below it is no news


def simulate(
    layout: args.Source,
    agents: args.Agents = None,
    audit: args.OnCommandLine = False,
    verdict: args.OnCommandLine = False,
    plot: args.Picture = None,
    width: args.Width = None,
    paths: args.Out = None,
    **fleet: Unpack[args.FleetOptions],
) -> Result:
    """Simulate a fleet on a layout: its throughput, where it jams, whether more agents would help.

    Args:
        layout: layout file.
        agents: number of agents (robots); by default that of the plan or its size, else 200.
        audit: check every trajectory against the rules of movement.
        verdict: simulate a few runs with fewer and with more agents as well, to find whether this
            number flows, is near capacity, past its peak or congested.
        plot: picture of where agents wait, drive and finish tasks, and of throughput over time.
        width: width of the picture in inches; by default what suits it.
        paths: file to write, of where every robot is at every timestep of the first seed's run:
            .csv, or .json for PlanViz.
        **fleet: see `FleetOptions`.

    Returns:
        ``mean_throughput`` of the runs that do not congest, in tasks per timestep, None if all do;
        counts of runs and agents; with `audit` and `verdict` what these find.

    Raises:
        InputError: a name is unknown, or the fleet cannot work on this layout.

    Examples:
        ``qdenv simulate plan.txt --robots 60 --plot``
    """
    inches = parse_width(width or SCREEN)
    if width and not plot:
        raise InputError(f"--width {inches:g} is the picture's: add --plot")
    options = args.Fleet(fleet)
    plan, name = options.read_plan(layout), args.name_of(layout)
    inputs = [layout, *options.inputs]
    picture = place(plot, f"{plan.name}_traffic.png", PICTURES, inputs)
    agents, timesteps, note = options.usual(plan, agents)
    tracks = place(paths, f"{plan.name}_paths.csv", (".csv", ".json"), inputs)
    if tracks and agents * timesteps > MOST_SHOWN:
        most = MOST_SHOWN // agents
        raise InputError(f"--paths: of {agents} robots at most {most} timesteps are written")
    with studies.about(name):
        config = options.config(agents, timesteps)
        fleet_tasks(plan.layout, plan.domain.simulator.tasks, agents)
    # This imports the simulator: refusals are faster without it.
    from qdenv.study.traffic import examine, facts_of

    about: dict[str, Any] = {"domain": plan.domain.name, "agents": agents, "layout": name}
    about |= {"planner": describe_planner(config.planner), "timesteps": timesteps}
    about["stop"] = options.stop

    def facts_with(study: Study) -> dict[str, Any]:
        facts = facts_of(study, plan.layout) | about
        if options.per_hour:
            facts["tasks_per_hour"] = facts["mean_of_all"] * options.per_hour
        return facts

    def log_runs(study: Study) -> None:  # before the runs that the verdict takes
        head = filter(None, [options.describe(str(agents), timesteps, [plan]), note])
        say(*head, *_numbers(facts_with(study)))

    # An audit records every step anyway: maps then cost nothing more.
    maps = audit or picture is not None
    with studies.about(name), Bar("simulating") as bar:
        study = examine(plan, config, options.seeds, audit, maps, verdict, bar, log_runs)
    facts, judgement = facts_with(study), ""
    if "verdict" in facts:
        judgement = f": {facts['verdict']}, {facts['verdict_reason']}"
        say(f"verdict      {facts['verdict']}: {facts['verdict_reason']}")
    say(*_jams(facts, plan))
    if tracks:
        motion, _ = record_fleet(plan, config, options.seeds[0])
        cells = motion.positions, motion.goals, motion.finished
        write_paths(tracks.path, *cells, plan.layout.shape[1])
        say(tracks)
    if picture:
        from qdenv.view.style import format_name  # imports matplotlib
        from qdenv.view.traffic import draw_traffic, make_scene

        title = f"{format_name(plan.name)}, {agents} agents{judgement}"
        picture.draw(draw_traffic(make_scene(plan, study, options.stop), title, inches))
    return Result(facts | {"settings": options.settings(timesteps, [plan])})


def _numbers(facts: Mapping[str, Any]) -> list[str]:
    """Describe the throughput of the runs and their mean, and what the runs took."""
    lines = []
    for run in facts["runs"]:
        jam = f", congested at {run['congested_at']}" if run["congested"] else ""
        lines.append(f"seed {run['seed']}: {run['throughput']:.3f} tasks per timestep{jam}")
    error = facts["standard_error"]
    band = f" +- {error:.3f} (standard error)" if np.isfinite(error) else ""
    hour = f", {facts['tasks_per_hour']:,.0f} tasks per hour" if "tasks_per_hour" in facts else ""
    lines.append(f"throughput   {facts['mean_of_all']:.3f}{band} tasks per timestep{hour}")
    if "idle_share" in facts:
        lines.append(
            f"orders       robots have none for {facts['idle_share']:.0%} of their time; "
            f"one waits {facts['order_wait']:.1f} timesteps for a robot"
        )
    smooth, rate = facts["mean_throughput"], facts["success_rate"]
    if rate < 1:
        others = "" if smooth is None else f"; the others move {smooth:.3f}"
        after = others if facts["stop"] else ", and went on"
        lines.append(f"congested    {1 - rate:.0%} of the runs{after}")
    checked = "every trajectory valid, " if facts["valid"] else ""
    took = f"{checked}{facts['cpu_seconds_per_run']:.2f} CPU s per run"
    lines.append(f"computed     {took}, compiled in {facts['compile_seconds']:.1f} s")
    return lines + facts["broken"]


def _jams(facts: Mapping[str, Any], plan: Plan) -> list[str]:
    """Describe how much agents wait and travel, and the worst cells."""
    steps, lines = facts["steps_per_task"], []
    if steps is not None:
        lines.append(f"travelled    {steps:.1f} steps per task")
    if "worst_cells" not in facts:
        return lines
    # Half of the waiting on few of all cells that agents can reach is a jam at one place.
    free = plan.domain.drivable(plan.layout).sum()
    half = facts["cells_with_half_of_waiting"]
    where = f", half of it on {half} of {free} free cells" if half else ""
    lines.append(f"waiting      {facts['waiting_share']:.1%} of the agents' time{where}")
    spots = [one for one in facts["worst_cells"] if one["waiting"] >= _NOTABLE]
    if not spots:
        return [*lines, f"no jam: no cell holds a waiting agent {_NOTABLE:.0%} of the time"]
    names = [plan.domain.names.get(tile, repr(tile)) for tile in plan.domain.tiles]
    table = [("rank", "row", "column", "tile", "of all waiting", "an agent waits", "per visit")]
    for rank, spot in enumerate(spots, 1):
        share, waiting = f"{spot['share']:.2%}", f"{spot['waiting']:.0%} of time"
        cell = (str(rank), str(spot["row"]), str(spot["column"]), names[spot["tile"]])
        table.append((*cell, share, waiting, f"{spot['wait_per_visit']:3.1f} steps"))
    head = "the cells with the most waiting; rows and columns are counted from 0 at the top left:"
    return [*lines, head, *format_table(table)]


class BrokenRule(NamedTuple):
    """A rule of movement, or of tasks, that a run broke."""

    message: str  # with its timestep, where it has one


def audit_run(
    run: Annotated[Path, Positional, arg(metavar="FILE")],
    layout: Annotated[Any, arg(constructor=Path)],
    domain: args.DomainName = None,
) -> Table:
    """Check any program's run of a fleet against the rules of movement (exit code 0 or 1).

    Robots stay on the floor, take one step at a time, share no cell and never swap cells; if the
    file has their goals, these are checked and the finished tasks counted.

    Args:
        run: file of the run: JSON of the League of Robot Runners, or lines of timestep, robot, row
            and column.
        layout: file of the layout on which the robots drove.
        domain: domain of the layout; by default what the file states, or its tiles suggest; a .map
            is of the domain map.

    Returns:
        a `BrokenRule` for each broken rule of movement, at its first breach, and for each
            task that was not finished as stated; empty for a valid run.

    Raises:
        InputError: a file cannot be read, or no fleet drives in this domain.

    Examples:
        ``qdenv audit-run run.csv --layout plan.txt``
    """
    if domain is None and Path(args.name_of(layout)).suffix.lower() == ".map":
        domain = "map"
    plan, driven = args.read_plan(layout, domain), read_run(run)
    tasks = plan.domain.simulator.tasks
    if tasks is None:
        raise InputError(f"{args.name_of(layout)}: no fleet drives in {plan.domain.name}")
    from qdenv.simulation.mapf.audit import check_run  # imports the simulator

    broken, finished = check_run(plan.layout, tasks, driven)
    times, robots = driven.cells.shape[:2]
    count = f"{finished} tasks finished" if driven.errands else "goals unknown"
    say(f"{run}: {robots} robots, {times - 1} timesteps, {count}, {plan.whose}")
    say(*broken[:_SHOWN])
    say("every rule of movement is obeyed" if not broken else f"{len(broken)} rules broken")
    facts = {
        "valid": not broken,
        "broken": broken,
        "robots": robots,
        "timesteps": times - 1,
        "finished_tasks": finished if driven.errands else None,
        "throughput": finished / max(times - 1, 1) if driven.errands else None,
        "settings": {"run": run, "layout": args.name_of(layout), "domain": plan.domain.name},
    }
    return Table([BrokenRule(one) for one in broken], facts, exit_code=1 if broken else 0)
