"""Guidance: published floors and graphs as their authors drove them, and ours beside them.

    QDENV_STUDY_DATA=FOLDER python -m experiments.guidance --cases warehouse empty
    QDENV_STUDY_DATA=FOLDER python -m experiments.guidance --cases warehouse --agents 100:600:100
    QDENV_STUDY_DATA=FOLDER python -m experiments.guidance --cases empty --search 800 2000 --seeds 5
    python -m experiments.guidance --cases calm --agents 500,640

Zhang, Jiang, Bhatt, Nikolaidis and Li 2024, "Guidance graph optimization for lifelong multi-agent
path finding", https://arxiv.org/abs/2402.01446, Table 3: T = 1000, PIBT plans every timestep anew,
priority-based search ten timesteps every five. The floors and graphs are its authors' and no part
of this repository: they are read from `guidance` in the folder that QDENV_STUDY_DATA names. The
case `calm` is a floor of the first zoo. Costs that were found by the search of `qdenv guide` are in
results/guidance/CASE-SEED.json; further ones are made there by --search, whose runs are in
runs/guidance, where an interrupted one goes on.
"""

import itertools
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp

from experiments.pieces import table
from experiments.program import run_program
from experiments.runs import whole_run
from qdenv.domains.base import DOMAINS, Domain, DomainConfig
from qdenv.domains.fleet import THROUGHPUT, fleet_simulator, throughput
from qdenv.generators import Base
from qdenv.guidance import unscaled_costs
from qdenv.io.layouts import write_layout
from qdenv.ranges import PositiveInt
from qdenv.registry import Entry
from qdenv.simulation.mapf.goals import tile_goal
from qdenv.simulation.mapf.settings import FleetConfig, PbsConfig, PibtConfig
from qdenv.study.guides import best_base, find_guidance, guide_config, start_at
from qdenv.study.options import parse_counts
from qdenv.study.plans import Plan, guide, read_plan
from qdenv.study.table import Row, Trial, compare, write_rows
from qdenv.types import InputError, Measure, TaskRule, Tile, look_up

TILES = ".@ew"
_MEANINGS = {
    ".": Tile("empty"),
    "@": Tile("obstacle", obstacle=True),
    "e": Tile("endpoint"),
    "w": Tile("workstation"),
}


@dataclass(frozen=True)
class FloorConfig(DomainConfig):
    """A published floor, on which agents visit workstations and endpoints in turn."""

    fleet: FleetConfig = field(default_factory=FleetConfig)  # type: ignore[misc]


def floor(config: FloorConfig) -> Domain:
    """Make the domain of published warehouses, which nobody repairs."""

    def cells(layout: jax.Array, runs: Any) -> jax.Array:
        return (layout != TILES.index("@")).sum().astype(jnp.float32)

    goals = tile_goal("w", TILES), tile_goal("e", TILES)  # as published: a workstation first
    return Domain(
        config=config,
        tiles=TILES,
        generated=TILES,
        seed_block=(".",),
        rules=None,
        simulator=fleet_simulator(TaskRule(TILES, ".ew", goals), config.fleet),
        objective=throughput,
        objective_name=THROUGHPUT,
        measures=(Measure("free cells", 0, config.rows * config.cols, 1, cells),),
        meanings=_MEANINGS,
    )


# Fleets as published: what is planned when, by whom.
PIBT = FleetConfig(400, 1000, 1, 1, PibtConfig(), stop_when_congested=False)
SWAPPING = replace(PIBT, planner=PibtConfig(swap=True))
SEARCH = FleetConfig(220, 1000, 10, 5, PbsConfig())
FOUND = Path(__file__).parent / "results" / "guidance"


class Case(NamedTuple):
    """A row of the published table."""

    domain: str
    floor: str  # name of a published file, or path of another
    fleet: FleetConfig
    # throughput by guidance; "graph" is the published one, whose file is the floor's
    published: dict[str, float]


_WAREHOUSE = "pibt_warehouse-33x36_w_mode_cma-es_400_agents_four-way-move"
_EMPTY = "pibt_empty-48-48_cma-es_1000_agents_four-way-move"
_RANDOM = "pibt_random_cma-es_32x32_400_agents_four-way-move"
_KIVA = "kiva_33x36_human_cma-es_opt_220_agents"
CASES = {
    "random": Case("map", _RANDOM, SWAPPING, {"none": 5.52, "crisscross": 6.84, "graph": 7.78}),
    "warehouse": Case(
        "published-floor", _WAREHOUSE, PIBT, {"none": 5.22, "crisscross": 6.65, "graph": 7.64}
    ),
    "warehouse-150": Case("published-floor", _WAREHOUSE, replace(PIBT, agents=150), {"none": 3.75}),
    "empty": Case(
        "map",
        _EMPTY,
        replace(PIBT, agents=1000),
        {"none": 19.48, "crisscross": 23.84, "graph": 24.04},
    ),
    "warehouse-pbs": Case("published-floor", _KIVA, SEARCH, {"crisscross": 5.59, "graph": 6.58}),
    # As `qdenv guide calm.json --robots 640 --planner pibt --timesteps 1000` drives.
    "calm": Case(
        "warehouse-even", f"{FOUND}/calm-0.json", FleetConfig(640, 1000, planner=PibtConfig()), {}
    ),
}


def published(name: str) -> Path:
    """Return the path of a published floor or graph."""
    folder = os.environ.get("QDENV_STUDY_DATA")
    if folder is None:
        raise InputError("QDENV_STUDY_DATA does not name the folder of published floors")
    return Path(folder) / "guidance" / f"{name}.json"


def read_floor(case: Case) -> Plan:
    """Read the floor of a case, without costs."""
    path = Path(case.floor)
    plan = read_plan(path if path.exists() else published(case.floor), case.domain)
    return plan._replace(costs=None)


def find_costs(name: str, seed: int, simulations: tuple[int, int]) -> None:
    """Find costs for the floor of a case, one simulation an evaluation, and write them.

    A search of smooth factors comes first, then one of the cost of each move that begins there.
    """
    case: Case = look_up(CASES, name, "case")
    plan = read_floor(case)
    free = plan.domain.drivable(plan.layout)
    folder, base, start = Path("runs/guidance"), best_base(plan, case.fleet), None
    for method, number in zip(("smooth", "costs"), simulations, strict=True):
        if number:
            config = guide_config(plan, case.fleet, method, base, number, 1, seed)
            run = whole_run(config, folder / f"{name}-{method}-{seed}", report=print, start=start)
            costs, judged = find_guidance(run)
            guided = plan._replace(costs=unscaled_costs(costs, free))
            base, start = str(run), start_at(guided)
    facts = {"domain": case.domain, "agents": case.fleet.agents, "simulations": sum(simulations)}
    write_layout(
        FOUND / f"{name}-{seed}.json",
        plan.layout,
        plan.domain.tiles,
        plan.domain.meanings,
        guided.costs,
        **facts | {"judged": max(judged.values())},
    )


def measure(name: str, agents: tuple[int, ...], seeds: int) -> list[Row]:
    """Simulate a case under each guidance; the rows are named CASE/GUIDANCE."""
    case: Case = look_up(CASES, name, "case")
    plan = read_floor(case)
    guidances: dict[str, Any] = {base: base for base in get_args(Base)}
    if "graph" in case.published:
        guidances["graph"] = published(case.floor)
    found = {path.stem.rpartition("-"): path for path in sorted(FOUND.glob("*.json"))}
    guidances |= {f"ours {key[2]}": path for key, path in found.items() if key[0] == name}
    floors = {f"{name}/{one}": guide(plan, where).floor for one, where in guidances.items()}
    counts = agents or (case.fleet.agents,)
    trial = Trial(plan.domain.simulator.tasks, case.fleet, counts, range(seeds))
    return compare(floors, trial, on_row=lambda row: print(row.layout, row.agents, flush=True))


def main(
    cases: tuple[str, ...] = ("warehouse", "warehouse-150", "empty", "random"),
    agents: str | None = None,
    seeds: PositiveInt = 10,
    out: Path = Path("runs/guidance.csv"),
    search: tuple[int, int] = (0, 0),
) -> None:
    """Simulate floors without guidance, with the published one and with ours.

    Args:
        cases: random, warehouse, warehouse-150, empty, warehouse-pbs, calm (first zoo).
        agents: numbers of agents: 200, or 150,200, or 50:400:50; as published unless given.
        seeds: number of runs of each, or of searches.
        out: table to write.
        search: simulations of two searches for each case and seed, in place of the table: of
            smooth factors of costs, and of the cost of each move from there on.
    """
    DOMAINS.register("published-floor", Entry(FloorConfig, floor))
    if any(search):
        for name, seed in itertools.product(cases, range(seeds)):
            if (saved := FOUND / f"{name}-{seed}.json").exists():
                print(f"{saved}: is there already")
            else:
                find_costs(name, seed, search)
        return
    rows = [row for name in cases for row in measure(name, parse_counts(agents), seeds)]
    head = ("case", "guidance", "agents", "success", "tasks / timestep", "published", "CPU s / run")
    lines = []
    for row in rows:
        name, guidance = row.layout.split("/")
        usual = row.agents == CASES[name].fleet.agents
        theirs = CASES[name].published.get(guidance, "") if usual else ""
        moved = f"{row.throughput:.3f} ± {row.standard_error:.3f}"
        # A jam is judged by windows of several timesteps.
        success = f"{row.success_rate:.0%}" if CASES[name].fleet.horizon > 1 else ""
        numbers = success, moved, theirs, f"{row.cpu_seconds_per_run:.3f}"
        lines.append((name, guidance, row.agents, *numbers))
    print("\n".join(table(head, lines)))
    write_rows(out, rows)


if __name__ == "__main__":
    run_program(main, "python -m experiments.guidance")
