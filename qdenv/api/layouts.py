"""Functions about layouts, which are files, arrays with a domain, or what another one returned."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from qdenv.api.results import Broken, Facts, Layout, Table
from qdenv.domains.base import DOMAINS, Domain, find_domain
from qdenv.repair.settings import Polish
from qdenv.study.plans import Plan
from qdenv.study.plans import read_plan as read_file
from qdenv.types import InputError, RepairStatus, Rules

if TYPE_CHECKING:
    from qdenv.simulate.mapf.environment import Environment, Observe

# Path of a layout file, a `Plan`, a `Layout`, or int [H, W] with ``domain=`` beside it.
Source: TypeAlias = "str | Path | Plan | Layout | np.ndarray | Sequence[Sequence[int]]"


def read_plan(layout: Source, domain: str | None = None) -> Plan:
    """Read a layout, whatever form it has.

    Args:
        layout: path of a file, a `Plan`, a `Layout`, or an int array [H, W] of tiles.
        domain: whose layout; arrays do not say it, the others do.

    Raises:
        InputError: it is no layout, or of another domain.
    """
    if isinstance(layout, str | Path):
        return read_file(layout, domain)
    if isinstance(layout, Plan | Layout):
        if domain not in (None, layout.domain.name):
            raise InputError(f"this layout is of {layout.domain.name}: leave domain out")
        name = layout.name if isinstance(layout, Plan) else "layout"
        return Plan(name, layout.layout, layout.domain, assumed=False)
    if domain is None:
        names = ", ".join(repr(name) for name in DOMAINS.names())
        raise InputError(f"an array does not say whose layout it is: give domain, one of {names}")
    found, tiles = find_domain(domain), np.asarray(layout)
    if tiles.ndim != 2 or tiles.dtype.kind not in "iu" or not tiles.size:
        raise InputError("a layout is an array of whole numbers with rows and columns")
    if tiles.min() < 0 or tiles.max() >= len(found.tiles):
        raise InputError(f"tiles of {domain} are 0 to {len(found.tiles) - 1} ({found.tiles!r})")
    return Plan("layout", tiles.astype(np.int8), found, assumed=False)


def simulate(
    layout: Source,
    agents: int = 200,
    domain: str | None = None,
    timesteps: int = 1000,
    seeds: int | str | Sequence[int] = 10,
    effort: str = "high",
    check: bool = False,
    planner: str = "",
) -> Facts:
    """Simulate a fleet on a layout.

    Args:
        layout: see `read_plan`.
        agents: number of agents.
        domain: whose tasks they do; what the file says unless given.
        timesteps: horizon T.
        seeds: how many runs, or a list of their seeds.
        effort: "low" for a quick look, "high" for numbers to report.
        check: audit every trajectory.
        planner: name of another registered planner.

    Returns:
        what `qdenv simulate --json` writes: ``mean_throughput`` in tasks per timestep, and more.

    Raises:
        InputError: a name is unknown, or the fleet cannot work on this layout.
    """
    from qdenv.study.traffic import simulate_layout

    plan = read_plan(layout, domain)
    given = (plan.domain.name, agents, timesteps, _seeds(seeds), effort, check, planner)
    return Facts({"layout": plan.name, **simulate_layout(plan.layout, *given)})


def _seeds(seeds: int | str | Sequence[int]) -> int | str:
    """Write a sequence of seeds as a list also where it holds but one."""
    if isinstance(seeds, int | str):
        return seeds
    return ",".join(str(int(seed)) for seed in seeds) + ","


def compare(
    layouts: Sequence[Source],
    agents: int | Sequence[int] = 200,
    domain: str | None = None,
    timesteps: int = 1000,
    seeds: int | str | Sequence[int] = 10,
    effort: str = "high",
    planner: str = "",
) -> Table:
    """Put layouts side by side: the same agents, the same seeds.

    Args:
        layouts: see `read_plan`; all of one domain.
        agents: one number, or several. The others are those of `simulate`.
        domain: whose tasks the agents do.
        timesteps: horizon T.
        seeds: how many runs, or a list of their seeds.
        effort: "low" or "high".
        planner: name of another registered planner.

    Returns:
        a `study.table.Row` for each layout and number of agents.

    Raises:
        InputError: no layout is given, they are of several domains, or a fleet cannot work there.
    """
    from qdenv.simulate.mapf.settings import FleetConfig
    from qdenv.study import sweep
    from qdenv.study.options import find_planner, parse_seeds

    plans = [read_plan(layout, domain) for layout in layouts]
    kinds = {plan.domain.name: plan.domain for plan in plans}
    if len(kinds) != 1:
        said = " and ".join(kinds) or "no domain at all"
        raise InputError(f"these are layouts of {said}: put one domain side by side")
    config = FleetConfig(timesteps=timesteps, planner=find_planner(effort, planner))
    counts = (agents,) if isinstance(agents, int) else tuple(agents)
    (only,) = kinds.values()
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
    **numbers: int,
) -> Layout:
    """Repair a layout: the closest one that obeys every rule of its domain.

    Args:
        layout: see `read_plan`.
        domain: whose rules.
        seed: other seeds may give other, equally good layouts.
        polish: "none", "quick" or "full", how hard to try.
        **numbers: exact numbers of tiles (shelves=240); as many as the layout has unless given.

    Returns:
        the layout, with status, cost, lower bound and CPU seconds among its facts.

    Raises:
        InputError: the domain has no rules, they contradict each other, or nothing was found.
    """
    from qdenv.repair.bounds import impossible
    from qdenv.repair.recipe import repair as repair_layout
    from qdenv.repair.settings import RepairConfig

    plan = read_plan(layout, domain)
    fitted = plan.domain.fitted(plan.layout, numbers)
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


def check(layout: Source, domain: str | None = None, **numbers: int) -> list[Broken]:
    """Name every rule that a layout breaks, and a cell; empty where it obeys them all.

    Args:
        layout: see `read_plan`.
        domain: whose rules.
        **numbers: exact numbers of tiles to demand; as many as the layout has unless given.

    Raises:
        InputError: the domain has no rules.
    """
    from qdenv.repair.audit import audit

    plan = read_plan(layout, domain)
    broken = audit(plan.layout, _rules_of(plan.domain.fitted(plan.layout, numbers)))
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
        from qdenv.plots.layouts import save_layout

        save_layout(path, plan.layout, plan.domain.tiles)
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
