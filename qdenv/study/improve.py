"""A better plan than one's own: lanes on it, some of its racks moved, racks in rows, a new floor.

Four searches, each an ordinary run. What they found is judged with seeds that none of them has
seen, beside the plan itself.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv import devices
from qdenv.domains.base import Domain, make_domain
from qdenv.generators import GENERATORS, DirectConfig, RacksConfig
from qdenv.grid import draw
from qdenv.guidance import unscaled_costs
from qdenv.lazy import jax
from qdenv.progress import Progress, silent
from qdenv.ranges import NonNegativeInt, PositiveFloat, PositiveInt, Ranged
from qdenv.repairs.audit import audit
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.settings import RepairConfig
from qdenv.run.config import RunConfig
from qdenv.run.directory import RunDirectory
from qdenv.search.settings import CmaEsConfig, RearrangeConfig
from qdenv.settings import EvaluationConfig
from qdenv.shipped import PREFIX, named, names
from qdenv.simulation.mapf.goals import BY_SHELF
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.stats import Difference, paired_difference
from qdenv.study.engine import run_seeds
from qdenv.study.guides import best_base, guide_config
from qdenv.study.plans import Plan, guide, with_tasks
from qdenv.types import RepairStatus

# Folder of a search -> what people call it, and its share of the time; the rest is for judging.
SECTIONS = {
    "lanes": ("lanes only", 0.1),
    "racks": ("some racks", 0.15),
    "rows": ("racks in rows", 0.3),
    "floor": ("a new floor", 0.3),
}
CROWD = 1.25  # times the number of robots, at which no result may be worse either
_SEARCHED = 1.125  # times it, in the simulations of a search: halfway
_TIMESTEPS = 300  # of a simulation in a search, at most: jams form within that time
_SIMULATIONS = 1  # of a layout in an evaluation: what looks good is evaluated again and again
# A rearranged layout breaks few rules: a fourteenth of the usual annealing mends it, in 12 ms on
# 30 x 40 cells where 400 moves per cell take 30, and changes as little.
_MENDING = RepairConfig(moves_per_cell=100)
_MOST_CELLS = 100  # of an archive
# Seeds that choose among candidates, and those that judge the chosen. Searches draw theirs from
# their own keys, and costs of moves are chosen with those from 1,000,000 on.
_PILOTS, JUDGES = range(2_000_000, 2_000_004), range(2_000_004, 2_000_016)
_CANDIDATES = 4  # layouts of a search that are looked at again: the best one was lucky, too


@dataclass(frozen=True)
class ImproveConfig(Ranged):
    """What decides the result of an improvement, beside the plan."""

    # the plan's domain: what must stay, which rules hold, which robots judge and for how long
    domain: Any
    ending: str = ".json"  # of the plan's file
    moves: PositiveInt = 20  # racks that "some racks" moves at most
    # of each search; as many as the minutes allow where None
    evaluations: PositiveInt | None = None
    minutes: PositiveFloat | None = None  # of all searches and judging together
    seed: NonNegativeInt = 0  # of the searches

    @property
    def fleet(self) -> FleetConfig:
        """The simulations that judge."""
        return self.domain.fleet

    @property
    def searched(self) -> FleetConfig:
        """The simulations of a search: shorter, and a little more crowded.

        The planner is the one that judges.
        """
        return replace(
            self.fleet,
            agents=round(_SEARCHED * self.fleet.agents),
            timesteps=min(self.fleet.timesteps, _TIMESTEPS),
        )


class Judged(NamedTuple):
    """The best plan of a section beside one's own, at the number of robots and `CROWD` times it."""

    section: str  # a name of `SECTIONS`
    plan: Plan  # with the costs of moves that were found, if there are some
    throughput: np.ndarray  # float [2, seeds], tasks per timestep
    changes: tuple[Difference, Difference]  # against the plan, with the same seeds
    # the first of them where all shelves are alike; None but for halls without stated demand
    by_shelf: Difference | None = None

    @property
    def is_better(self) -> bool:
        """Return True if both 95 % intervals lie above the plan."""
        return all(change.low > 0 for change in self.changes)


def zoo_floors(
    domain: Domain, seed: int, progress: Progress = silent
) -> Iterator[tuple[str, np.ndarray]]:
    """Grow shipped generators into a domain, its own or those of its tiles, and repair the floors.

    Yields names and layouts (int8 [H, W]); what cannot be repaired is left out.
    """
    rules = domain.rules() if domain.rules else None
    every = {home: RunDirectory.open(f"{PREFIX}{home}").config.evaluation for home in names()}
    alike = [
        home
        for home, config in every.items()
        if make_domain(config.domain).generated == domain.generated
    ]
    if rules is None or not alike:
        return
    home = domain.name if domain.name in alike else alike[0]
    config, generators = every[home], named(home).collection.generators
    trained = make_domain(config.domain).shape
    longer = max(ours / theirs for ours, theirs in zip(domain.shape, trained, strict=True))
    steps = round(config.generator.steps * max(longer, 1))
    grow = GENERATORS.make(config.generator, domain.canvas).grow
    runs = [RunDirectory.open(f"{PREFIX}{home}/{one.name}") for one in generators]
    solutions = np.stack([run.best.solution for run in runs])
    drawn = jax.jit(lambda some: jax.vmap(domain.frame)(grow(some, steps)))(solutions)
    for done, (one, layout) in enumerate(zip(generators, np.asarray(drawn), strict=True)):
        progress("growing generators of the zoo", done / len(generators), one.name)
        mended = repair_layout(layout, rules, seed, RepairConfig(polish="none"))
        if mended.status < RepairStatus.IMPOSSIBLE:
            yield f"{PREFIX}{home}/{one.name}", np.asarray(mended.layout)


def search_config(
    section: str, plan: Plan, start: np.ndarray, config: ImproveConfig, evaluations: int
) -> RunConfig:
    """Configure the search of a section: of costs of moves on the plan's own floor, or of floors.

    Floors lie around the layout `start` (int8 [H, W]); the archive's axis is the number of its
    racks that are moved.
    """
    if section == "lanes":
        base = best_base(plan, config.searched)
        return guide_config(plan, config.searched, "smooth", base, evaluations, 1, config.seed)
    domain, around = plan.domain, tuple(draw(start, plan.domain.tiles))
    settings = replace(domain.config, fleet=config.searched, around=around)
    axis = make_domain(settings).measures[0]
    most, cells = axis.high, _MOST_CELLS
    if section == "racks" and config.moves < axis.cells:
        most = cells = config.moves + 1
    generator: Any = DirectConfig()
    algorithm: Any = RearrangeConfig()
    if section == "rows":
        # The full covariance of twelve numbers is affordable, chance needs a large population.
        generator, algorithm = RacksConfig(), CmaEsConfig(batch=32, sigma0=1.0, strategy="full")
    return RunConfig(
        evaluation=EvaluationConfig(settings, generator, _SIMULATIONS, alpha=0.0, repair=_MENDING),
        algorithm=algorithm,
        evaluations=evaluations,
        archive=((axis.low, float(most), min(cells, axis.cells)),),
        seed=config.seed,
    )


def count_evaluations(plan: Plan, config: ImproveConfig, section: str) -> int:
    """Return how many evaluations a search is given: those stated, or what its minutes allow."""
    if config.evaluations:
        return config.evaluations
    assert config.minutes is not None
    domain, fleet = plan.fitted(), config.searched
    seconds = run_seeds(plan.floor, domain.simulator.tasks, fleet, range(2)).cpu_seconds / 2
    if section != "lanes":
        before = time.thread_time()
        holed = np.where(np.arange(plan.layout.size) % 97 == 0, 0, plan.layout.reshape(-1))
        if domain.rules:
            repair_layout(holed.reshape(plan.layout.shape), domain.rules(), 0, _MENDING)
        seconds = _SIMULATIONS * seconds + time.thread_time() - before
    share = SECTIONS[section][1] * 60 * config.minutes * devices.threads()
    return max(round(share / max(seconds, 1e-3)), 1)


def mean_throughput(plan: Plan, fleet: FleetConfig, seeds: Sequence[int]) -> np.ndarray:
    """Simulate a plan, float [seeds]: tasks per timestep; congested runs count as they ended."""
    done = run_seeds(plan.floor, plan.domain.simulator.tasks, fleet, seeds)
    return np.array([float(run.throughput) for run in done.runs])


def map_usage(plan: Plan, fleet: FleetConfig) -> np.ndarray:
    """Simulate a plan once: the share of time in which a robot is on each cell, float [H, W]."""
    (run,) = run_seeds(plan.floor, plan.domain.simulator.tasks, fleet, _PILOTS[:1]).runs
    return fleet.agents * np.asarray(run.usage)


def list_candidates(plan: Plan, folder: Path, section: str, lanes: np.ndarray | None) -> list[Plan]:
    """List what a search found, each layout without lanes and with several kinds of them.

    `lanes` are costs of moves found for the plan, int32 [5, H, W]; None if the planner knows none.
    """
    layouts = [plan.layout] if section == "lanes" else best_layouts(folder / section)
    found = []
    for layout in layouts:
        bare = plan._replace(layout=layout, costs=None, guidance="none")
        found += [bare] * (section != "lanes")
        if lanes is not None:  # they vary smoothly, so other floors can have them
            found.append(guide(bare, "crisscross"))
            costs = unscaled_costs(lanes, plan.domain.drivable(layout))
            found.append(bare._replace(costs=costs, guidance="searched"))
    return found


def best_layouts(run: Path) -> list[np.ndarray]:
    """Read the layouts (int8 [H, W]) that looked best in a search."""
    archive = RunDirectory.open(run).archive
    order = np.argsort(-archive.columns["objective"], kind="stable")[:_CANDIDATES]
    return [archive.columns["repaired"][row] for row in order]


def judge(
    plan: Plan,
    found: Mapping[str, Sequence[Plan]],
    config: ImproveConfig,
    progress: Progress = silent,
) -> list[Judged]:
    """Choose the best of the plans that each section found, and compare it with one's own.

    Few simulations choose, others judge: the best of many was lucky, too. Raises RuntimeError if
    a result breaks a rule or moves a rack that must stay, which would be a bug.
    """
    fleets = [
        replace(config.fleet, agents=round(share * config.fleet.agents)) for share in (1.0, CROWD)
    ]

    def drive(plan: Plan, seeds: Sequence[int]) -> np.ndarray:
        return np.array([mean_throughput(plan, fleet, seeds) for fleet in fleets])

    chosen: dict[str, tuple[float, Plan]] = {}
    candidates = [(section, one) for section, plans in found.items() for one in plans]
    progress("judging", 0.0, plan.name)
    hers = drive(plan, _PILOTS).mean(axis=1)
    for number, (section, one) in enumerate(candidates, 1):
        progress("judging", number / (len(candidates) + 1), SECTIONS[section][0])
        gain = drive(one, _PILOTS).mean(axis=1) / np.maximum(hers, 1e-9)
        # Rank by the gain at the stated number of robots, less any loss in the crowd.
        worth = gain[0] + min(gain[1] - 1, 0)
        if section not in chosen or worth > chosen[section][0]:
            chosen[section] = worth, one
    hers, judged, alike = drive(plan, JUDGES), [], None
    if not getattr(plan.domain.config, "demand", ".") and BY_SHELF[0] in plan.domain.counted:
        alike = with_tasks(plan, {"demand": BY_SHELF[0]})
        usual = mean_throughput(alike, fleets[0], JUDGES)
    for number, (section, (_, one)) in enumerate(chosen.items()):
        progress("judging the chosen", number / len(chosen), SECTIONS[section][0])
        ours = drive(one, JUDGES)
        first, second = (paired_difference(*pair) for pair in zip(ours, hers, strict=True))
        by_shelf = None
        if alike is not None:
            # More endpoints near the stations shorten ways, as if people ordered other goods.
            other = one._replace(domain=alike.domain)
            by_shelf = paired_difference(mean_throughput(other, fleets[0], JUDGES), usual)
        moved = section == "lanes" and not np.array_equal(one.layout, plan.layout)
        rules = plan.domain.rules() if plan.domain.rules and section != "lanes" else None
        if broken := ["a rack moved"] * moved + (audit(one.layout, rules) if rules else []):
            raise RuntimeError(f"{SECTIONS[section][0]}: {broken[0]}")
        judged.append(Judged(section, one, ours, (first, second), by_shelf))
    return judged
