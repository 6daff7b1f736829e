"""Functions about layouts, which are files, arrays with a domain, or what another one returned."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from qdenv.api.plans import Source, read_plan
from qdenv.api.results import Broken, Facts, Layout, Table
from qdenv.domains.base import Domain
from qdenv.repair.settings import Polish
from qdenv.types import InputError, RepairStatus, Rules

if TYPE_CHECKING:
    from qdenv.simulate.mapf.environment import Environment, Observe
    from qdenv.study.options import Driving


def simulate(
    layout: Source,
    agents: int | None = None,
    domain: str | None = None,
    timesteps: int | None = None,
    seeds: int | str | Sequence[int] = 10,
    check: bool = False,
    **driving: Unpack[Driving],
) -> Facts:
    """Simulate a fleet on a layout.

    Args:
        layout: see `read_plan`.
        agents: number of agents; 200, or what is known of the layout's size, unless given.
        domain: whose tasks they do; what the file says unless given.
        timesteps: horizon T; 1000, or likewise, unless given.
        seeds: how many runs, or a list of their seeds.
        check: audit every trajectory.
        **driving: ``effort`` of the negotiated planner: "low" for a quick look, "high", for
            numbers to report, unless given; ``planner``, a registered name or settings like
            ``PbsConfig(rule="plain")``; ``stop=False`` to go on after congestion.

    Returns:
        what `qdenv simulate --json` writes: ``mean_throughput`` in tasks per timestep, and more.

    Raises:
        InputError: a name is unknown, or the fleet cannot work on this layout.
    """
    from qdenv.study.traffic import simulate_layout

    plan = read_plan(layout, domain)
    given = (plan.domain.name, agents, timesteps, _seeds(seeds), check)
    return Facts({"layout": plan.name, **simulate_layout(plan.layout, *given, **driving)})


def _seeds(seeds: int | str | Sequence[int]) -> int | str:
    """Write a sequence of seeds as a list also where it holds but one."""
    if isinstance(seeds, int | str):
        return seeds
    return ",".join(str(int(seed)) for seed in seeds) + ","


def compare(
    layouts: Sequence[Source],
    agents: int | Sequence[int] | None = None,
    domain: str | None = None,
    timesteps: int | None = None,
    seeds: int | str | Sequence[int] = 10,
    **driving: Unpack[Driving],
) -> Table:
    """Put layouts side by side: the same agents, the same seeds.

    Args:
        layouts: see `read_plan`; all of one domain.
        agents: one number, or several; as in `simulate` unless given.
        domain: whose tasks the agents do.
        timesteps: horizon T; as in `simulate` unless given.
        seeds: how many runs, or a list of their seeds.
        **driving: effort, planner and stop, as in `simulate`.

    Returns:
        a `study.table.Row` for each layout and number of agents.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.
    """
    from qdenv.study import sweep
    from qdenv.study.options import make_fleet, parse_seeds, usual_fleet

    plans = [read_plan(layout, domain) for layout in layouts]
    kinds = {plan.domain.name: plan.domain for plan in plans}
    if len(kinds) != 1:
        said = " and ".join(kinds) or "no domain at all"
        raise InputError(f"these are layouts of {said}: put one domain side by side")
    (only,) = kinds.values()
    stated = (agents,) if isinstance(agents, int) else tuple(agents or ())
    drawn = [plan.layout for plan in plans]
    usual = usual_fleet(only, drawn, max(stated, default=None), timesteps)
    counts = stated or (usual.agents,)
    config = make_fleet(max(counts), usual.timesteps, **driving)
    trial = sweep.Trial(only.simulator.tasks, config, counts, parse_seeds(_seeds(seeds)))
    names = [
        plan.name if [one.name for one in plans].count(plan.name) == 1 else f"{plan.name} {place}"
        for place, plan in enumerate(plans, start=1)
    ]
    tiles = {name: plan.layout for name, plan in zip(names, plans, strict=True)}
    return Table(sweep.compare(tiles, trial))


def repair(
    layout: Source,
    domain: str | None = None,
    seed: int = 0,
    polish: Polish = "full",
    keep: str | Path | None = None,
    **numbers: int,
) -> Layout:
    """Repair a layout: the closest one that obeys every rule of its domain.

    Args:
        layout: see `read_plan`.
        domain: whose rules.
        seed: other seeds may give other, equally good layouts.
        polish: "none", "quick" or "full", how hard to try.
        keep: a drawing of the layout's shape: ``?`` may change, ``!`` stays, a tile must be this.
        **numbers: exact numbers of tiles (shelves=240); as many as the layout has unless given.

    Returns:
        the layout, with status, cost, lower bound and CPU seconds among its facts.

    Raises:
        InputError: the domain has no rules, they contradict each other, or nothing was found.
    """
    from qdenv.repair.recipe import repair_layout
    from qdenv.repair.rules import impossible
    from qdenv.repair.settings import RepairConfig

    plan = read_plan(layout, domain)
    fitted = plan.fitted(numbers, keep)
    rules = _rules_of(fitted)
    if reason := impossible(rules):
        raise InputError(f"no repair exists: {reason}")
    result = repair_layout(plan.layout, rules, seed, RepairConfig(polish=polish))
    if result.status >= RepairStatus.IMPOSSIBLE:
        raise InputError("no feasible layout was found: try another seed")
    facts = {
        "status": RepairStatus(int(result.status)).name.lower(),
        "hamming": float(result.cost),
        "lower_bound": float(result.lower_bound),
        "cpu_seconds": round(float(result.seconds), 3),
    }
    return Layout(np.asarray(result.layout), fitted, facts)


def check(
    layout: Source, domain: str | None = None, keep: str | Path | None = None, **numbers: int
) -> list[Broken]:
    """Name every rule that a layout breaks, and a cell; empty where it obeys them all.

    Args:
        layout: see `read_plan`.
        domain: whose rules.
        keep: a drawing of what is meant to be as it is, as in `repair`.
        **numbers: exact numbers of tiles to demand; as many as the layout has unless given.

    Raises:
        InputError: the domain has no rules.
    """
    from qdenv.repair.audit import audit

    plan = read_plan(layout, domain)
    broken = audit(plan.layout, _rules_of(plan.fitted(numbers, keep)))
    return [Broken(one.message, *map(int, one.cell)) for one in broken]


def render(layout: Source, path: str | Path | None = None, domain: str | None = None) -> Layout:
    """Draw a layout: in the notebook, and into a file where one is named.

    Args:
        layout: see `read_plan`.
        path: a .png, .svg or .pdf to write.
        domain: whose tiles.

    Raises:
        InputError: it is no layout, or the place cannot be written to.
    """
    plan = read_plan(layout, domain)
    if path is not None:
        # Only here: matplotlib takes half a second to import.
        from qdenv.view.layouts import save_layout

        save_layout(path, plan.layout, plan.domain.tiles, plan.domain.names)
    return Layout(plan.layout, plan.domain)


def make_environment(
    layout: Source,
    agents: int = 50,
    timesteps: int = 1000,
    domain: str | None = None,
    observe: Observe | None = None,
) -> Environment:
    """Make a stepwise environment for learners: one action for every robot.

    Args:
        layout: see `read_plan`.
        agents: number of robots.
        timesteps: steps until `Timestep.last`.
        domain: whose tasks they do.
        observe: traceable function of the state; positions, goals and services unless given.

    Raises:
        InputError: no fleet drives in this domain, or not on this layout.
    """
    from qdenv.simulate.mapf.environment import Environment, observe_plainly

    plan = read_plan(layout, domain)
    tasks = plan.domain.simulator.tasks
    if tasks is None:
        raise InputError(f"no fleet drives in {plan.domain.name}")
    return Environment(plan.layout, tasks, agents, timesteps, observe or observe_plainly)


def _rules_of(domain: Domain) -> Rules:
    if domain.rules is None:
        raise InputError(f"layouts of {domain.name} have no rules")
    rules: Any = domain.rules()
    return rules
