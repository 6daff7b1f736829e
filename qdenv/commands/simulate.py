"""The command simulate: one layout, one number of robots; where it jams, and whether more fit."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import tyro

from qdenv.commands import output
from qdenv.commands.choices import FleetOptions, Options
from qdenv.commands.waiting import waiting
from qdenv.grid import of_tiles
from qdenv.simulate.mapf.fleet import FleetConfig
from qdenv.study import sweep as studies
from qdenv.study.jams import throughput_over_time, worst_cells
from qdenv.study.plans import Plan, read_plan
from qdenv.study.traffic import (
    Study,
    Wanted,
    describe_planner,
    examine,
    facts_of,
    fleet_tasks,
    parse_seeds,
)
from qdenv.types import InputError

Picture = Annotated[Path | None, tyro.conf.arg(metavar="[FILE]")]


def simulate(
    layout: tyro.conf.Positional[Path],
    agents: int = 200,
    options: Options = FleetOptions(),  # noqa: B008 (frozen)
    audit: bool = True,
    verdict: bool = True,
    plot: Picture = None,
    json_file: output.JsonFile = None,
) -> None:
    """Simulate a fleet on a layout: throughput, where it jams, whether more robots would help.

    Args:
        layout: layout file.
        agents: number of robots.
        options: who drives.
        audit: check every trajectory against the rules of movement.
        verdict: simulate a few runs with fewer and with more robots, too, to say whether this
            number flows, is near capacity, past its peak or congested.
        plot: picture of where robots wait, drive and work, and of throughput over time.
        json_file: where to write the numbers; - for standard output.
    """
    picture = None
    if plot is not None:
        named = None if plot == Path("auto") else plot
        default = f"{layout.stem}_traffic.png"
        picture = output.place(named, default, output.PICTURES, [layout])
    output.place(json_file, "facts.json", inputs=[layout])
    per_hour = options.steps_per_hour
    plan = read_plan(layout, options.domain)
    tasks = plan.domain.simulator.tasks
    seeds = parse_seeds(options.seeds)
    with studies.about(str(layout)), waiting("simulating") as bar:
        tasks = fleet_tasks(plan.layout, tasks, agents)
        config = FleetConfig(agents, options.timesteps, planner=options.planner_settings)
        maps = audit or picture is not None
        study = examine(plan.layout, tasks, config, seeds, Wanted(audit, maps, verdict), bar)
    settings = {"effort": options.effort, "seeds": seeds, "audit": audit}
    settings["seconds_per_step"] = options.seconds_per_step
    facts = {
        "layout": str(layout),
        "domain": plan.domain.name,
        "planner": describe_planner(config.planner),
        "agents": agents,
        "timesteps": options.timesteps,
        **facts_of(study, plan.layout),
    }
    if per_hour:
        facts["tasks_per_hour"] = facts["mean_of_all"] * per_hour
    output.write_facts(json_file, "simulate", facts, **settings)
    print(describe_fleet(plan, agents, options, len(seeds)))
    print_numbers(facts, per_hour)
    if study.maps is not None:
        print_jams(facts, plan)
    if study.verdict is not None:
        print(f"verdict      {study.verdict.word}: {study.verdict.reason}")
    if picture is not None:
        draw(picture.path, plan, study, facts)
        print(picture)
    print("\n".join(facts["broken"]), end="\n" if facts["broken"] else "")


def describe_fleet(plan: Plan, agents: int | str, options: FleetOptions, runs: int) -> str:
    """Say in one line what is simulated, as all studies do."""
    planner = f"planner {options.planner}" if options.planner else f"{options.effort} effort"
    return f"{agents} agents, {options.timesteps} timesteps, {runs} seeds, {planner}, {plan.whose}"
