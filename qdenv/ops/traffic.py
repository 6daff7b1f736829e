"""Operations on fleets: one on a layout, where it jams; tables of several numbers of agents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from qdenv.ops import options as args
from qdenv.ops.output import PICTURES, Result, format_table, place, say
from qdenv.progress import Bar
from qdenv.simulate.mapf.settings import describe_planner
from qdenv.study import table as studies
from qdenv.study.options import fleet_tasks, usual_fleet
from qdenv.study.plans import Plan
from qdenv.types import InputError
from qdenv.view import SCREEN

if TYPE_CHECKING:  # imports the simulator
    from qdenv.study.traffic import Study


def simulate_layout(
    layout: args.Source,
    agents: args.Agents = None,
    audit: args.OnCommandLine = False,
    verdict: args.OnCommandLine = False,
    plot: args.Picture = None,
    width: args.Width = None,
    **fleet: Unpack[args.FleetOptions],
) -> Result:
    """Simulate a fleet on a layout: its throughput, where it jams, whether more agents would help.

    Args:
        layout: layout file.
        agents: number of agents (robots); 200, or what is known of the layout's size, unless given.
        audit: check every trajectory against the rules of movement.
        verdict: simulate a few runs with fewer and with more agents as well, to find whether this
            number flows, is near capacity, past its peak or congested.
        plot: picture of where agents wait, drive and finish tasks, and of throughput over time.
        width: of the picture in inches; what suits it unless given.
        **fleet: see `FleetOptions`.

    Returns:
        ``mean_throughput`` in tasks per timestep, and more: what `--json` writes.

    Raises:
        InputError: a name is unknown, or the fleet cannot work on this layout.
    """
    if width and not plot:
        raise InputError(f"--width {width:g} is the picture's: add --plot")
    options = args.Fleet(fleet)
    plan, name = options.read_plan(layout), args.name_of(layout)
    picture = place(plot, f"{plan.name}_traffic.png", PICTURES, [layout])
    agents, timesteps, note = usual_fleet(plan.domain, [plan.layout], agents, options.timesteps)
    with studies.about(name):
        fleet_tasks(plan.layout, plan.domain.simulator.tasks, agents)
        config = options.config(agents, timesteps)
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

    # Whoever audits records every step anyway: maps of it cost nothing more.
    maps = audit or picture is not None
    with studies.about(name), Bar("simulating") as bar:
        study = examine(plan, config, options.seeds, audit, maps, verdict, bar, log_runs)
    facts, judgement = facts_with(study), ""
    if "verdict" in facts:
        judgement = f": {facts['verdict']}, {facts['verdict_reason']}"
        say(f"verdict      {facts['verdict']}: {facts['verdict_reason']}")
    say(*_jams(facts, plan))
    if picture:
        from qdenv.view.style import format_name  # imports matplotlib
        from qdenv.view.traffic import draw_traffic, make_scene

        title = f"{format_name(plan.name)}, {agents} agents{judgement}"
        scene = make_scene(plan, study, options.stop)
        picture.draw(draw_traffic(scene, title, width or SCREEN))
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
    if not facts["worst_cells"]:
        return lines
    names = [plan.domain.names.get(tile, repr(tile)) for tile in plan.domain.tiles]
    table = [("rank", "row", "column", "tile", "of all waiting", "an agent waits", "per visit")]
    for rank, spot in enumerate(facts["worst_cells"], 1):
        share, waiting = f"{spot['share']:.2%}", f"{spot['waiting']:.0%} of time"
        cell = (str(rank), str(spot["row"]), str(spot["column"]), names[spot["tile"]])
        table.append((*cell, share, waiting, f"{spot['wait_per_visit']:3.1f} steps"))
    head = "the cells with the most waiting; rows and columns are counted from 0 at the top left:"
    return [*lines, head, *format_table(table)]
