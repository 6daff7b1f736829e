"""The command simulate: one layout, one number of agents; where it jams, and whether more fit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qdenv.commands import output, words
from qdenv.commands.choices import FleetOptions, LayoutFile, Options
from qdenv.grid import of_tiles
from qdenv.progress import Bar
from qdenv.simulate.mapf.choosing import describe_planner
from qdenv.study import sweep as studies
from qdenv.study.options import fleet_tasks, parse_seeds, usual_fleet
from qdenv.study.plans import Plan, read_plan

if TYPE_CHECKING:  # imports the simulator
    from qdenv.study.traffic import Study


def simulate(
    layout: LayoutFile,
    agents: int | None = None,
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    audit: bool = True,
    verdict: bool = True,
    plot: words.Picture = None,
    width: words.Width = None,
    json_file: output.JsonFile = None,
) -> None:
    """Simulate a fleet on a layout: its throughput, where it jams, whether more agents would help.

    Args:
        layout: layout file.
        agents: number of agents (robots); 200, or what is known of the layout's size, unless given.
        options: who drives.
        audit: check every trajectory against the rules of movement.
        verdict: simulate a few runs with fewer and with more agents, too, to tell whether this
            number flows, is near capacity, past its peak or congested.
        plot: picture of where agents wait, drive and finish tasks, and of throughput over time.
        width: of the picture: column or page of a journal, or inches; 10 inches unless given.
        json_file: where to write the numbers; - is standard output.
    """
    size = words.inches(width, plot is not None)
    picture = words.place_picture(plot, f"{layout.stem}_traffic.png", [layout])
    per_hour, seeds = words.steps_per_hour(options), parse_seeds(options.seeds)
    plan = read_plan(layout, options.domain)
    usual = usual_fleet(plan.domain, [plan.layout], agents, options.timesteps)
    agents, options = usual.agents, replace(options, timesteps=usual.timesteps)
    with studies.about(str(layout)):
        tasks = fleet_tasks(plan.layout, plan.domain.simulator.tasks, agents)
        config = options.fleet(agents)
    # Imports the simulator, which takes longer than to refuse what cannot be simulated.
    from qdenv.study.traffic import Wanted, examine, facts_of

    wanted = Wanted(audit, maps=audit or picture is not None, verdict=verdict)
    about: dict[str, Any] = {"domain": plan.domain.name, "agents": agents, "layout": str(layout)}
    about |= {"planner": describe_planner(config.planner), "timesteps": options.timesteps}
    about["stop"] = options.stop

    def report(study: Study) -> dict[str, Any]:
        facts = facts_of(study, plan.layout) | about
        return facts | ({"tasks_per_hour": facts["mean_of_all"] * per_hour} if per_hour else {})

    with studies.about(str(layout)), Bar("simulating") as bar:

        def tell(study: Study) -> None:
            lines = [words.describe_study(str(agents), options, seeds, plan)]
            lines += [usual.said] * bool(usual.said)
            bar.print("\n".join(lines + describe_numbers(report(study))))

        study = examine(plan.layout, tasks, config, seeds, wanted, bar, tell)
    facts = report(study)
    if "verdict" in facts:
        print(f"verdict      {facts['verdict']}: {facts['verdict_reason']}")
    print_jams(facts, plan)
    if picture is not None:
        draw(picture.path, plan, study, facts, size)
        print(picture)
    output.write_facts(json_file, "simulate", facts, **words.settings_of(options, seeds))


def describe_numbers(facts: dict[str, Any]) -> list[str]:
    """Say the throughput of the runs and their mean, and what the runs took."""
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
    lines.append(
        f"computed     {checked}{facts['cpu_seconds_per_run']:.2f} CPU s per run, "
        f"compiled in {facts['compile_seconds']:.1f} s"
    )
    return lines + facts["broken"]


def print_jams(facts: dict[str, Any], plan: Plan) -> None:
    """Print how much agents wait and travel, and the worst cells."""
    steps = facts["steps_per_task"]
    if steps is not None:
        print(f"travelled    {steps:.1f} steps per task")
    if "worst_cells" not in facts:
        return
    tasks = plan.domain.simulator.tasks
    assert tasks is not None
    free = of_tiles(plan.layout, tasks.traversable, tasks.tiles).sum()
    half = facts["cells_with_half_of_waiting"]
    where = f", half of it on {half} of {free} free cells" if half else ""
    print(f"waiting      {facts['waiting_share']:.1%} of the agents' time{where}")
    if not facts["worst_cells"]:
        return
    names = [plan.domain.names.get(tile, repr(tile)) for tile in plan.domain.tiles]
    width = max(8, *(len(name) for name in names))
    print("the cells with the most waiting; rows and columns are counted from 0 at the top left:")
    print(f"rank  row  column  {'there is':{width}}  of all waiting  an agent waits  per visit")
    for rank, spot in enumerate(facts["worst_cells"], 1):
        print(
            f"{rank:4} {spot['row']:4}  {spot['column']:6}  {names[spot['tile']]:{width}}  "
            f"{spot['share']:14.2%}  {spot['waiting']:6.0%} of time  "
            f"{spot['wait_per_visit']:3.1f} steps"
        )


def draw(
    path: Path, plan: Plan, study: Study, facts: dict[str, Any], size: dict[str, float]
) -> None:
    """Draw the traffic of a study."""
    # Only here: matplotlib takes half a second to import.
    from qdenv.view.style import name_of, save_figure
    from qdenv.view.traffic import draw_traffic, scene_of

    verdict = f": {facts['verdict']}, {facts['verdict_reason']}" if "verdict" in facts else ""
    title = f"{name_of(plan.name)}, {facts['agents']} agents{verdict}"
    save_figure(draw_traffic(scene_of(plan, study, title, facts["stop"]), **size), path)
