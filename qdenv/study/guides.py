"""Guidance for an existing floor: the search of its costs, and what was found."""

from dataclasses import replace
from typing import Any, get_args

import numpy as np

from qdenv.domains.base import make_domain
from qdenv.generators import Base, CostsConfig, UpdateConfig
from qdenv.grid import draw
from qdenv.guidance import existing_moves
from qdenv.run.config import RunConfig
from qdenv.run.directory import RunDirectory
from qdenv.run.evaluate import Search
from qdenv.run.experiment import build_experiment
from qdenv.run.loop import Publisher
from qdenv.search.base import growing
from qdenv.search.settings import CmaEsConfig
from qdenv.settings import EvaluationConfig
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.study.elites import make_costs_drawer
from qdenv.study.engine import run_seeds
from qdenv.study.options import fleet_tasks
from qdenv.study.plans import Plan, guide
from qdenv.study.table import Trial, compare
from qdenv.types import Floor, InputError, look_up

JUDGES = tuple(range(1_000_000, 1_000_010))  # seeds by which what was found is compared
# Made for thousands of numbers, at linear cost (Nomura and Ono 2022, "Fast moving natural evolution
# strategy for high-dimensional problems", https://arxiv.org/abs/2201.11422). After 1,200
# evaluations on the hand-made warehouse its mean moves 8.06, those of isotropic and of separable
# CMA-ES 7.94 (one search each).
_ALGORITHM = CmaEsConfig(batch=40, sigma0=0.1, strategy="CR_FM_NES")
_FAR = 0.3  # sigma0 of single costs that no search has found before


def guide_config(
    plan: Plan,
    fleet: FleetConfig,
    method: str,
    base: str,
    evaluations: int = 2000,
    simulations: int = 1,
    seed: int = 0,
) -> RunConfig:
    """Configure the search of costs for a plan: all its tiles must stay.

    `method` is "smooth", which searches factors of costs that vary smoothly over the floor,
    "costs", which searches the costs themselves, or "update", which searches the weights of an
    update model. `base` names the guidance where it begins: one of `Base` is known to the
    generator, any other is given by `start_at`. Raises InputError if no fleet can work there.
    """
    named = base in get_args(Base)
    known: Any = base if named else "none"
    fleet_tasks(plan.layout, plan.domain.simulator.tasks, fleet.agents)
    domain = plan.fitted()
    rows = tuple(draw(domain.drivable(plan.layout).astype(np.int8), "#."))
    generators: dict[str, Any] = {
        "smooth": CostsConfig(rows, known, smooth=True),
        "costs": CostsConfig(rows, known),
        "update": UpdateConfig(base=known),
    }
    settings = replace(domain.config, fleet=fleet, keep=tuple(draw(plan.layout, domain.tiles)))
    generator = look_up(generators, method, "method")
    # The measures of an existing floor are fixed: one cell holds them all.
    axes = [(0.0, float(domain.limit_of(axis) or axis.high), 1) for axis in domain.measures]
    far = named and method == "costs"
    return RunConfig(
        evaluation=EvaluationConfig(settings, generator, simulations, alpha=0.0),
        algorithm=replace(_ALGORITHM, sigma0=_FAR) if far else _ALGORITHM,
        evaluations=evaluations,
        archive=tuple(axes),
        seed=seed,
        start="" if named else base,
    )


def best_base(plan: Plan, fleet: FleetConfig) -> str:
    """Return the name of the guidance, among those where a search can begin, that moves most."""
    floors = {base: guide(plan, base).floor for base in get_args(Base)}
    trial = Trial(plan.domain.simulator.tasks, fleet, [fleet.agents], JUDGES[:3])
    return max(compare(floors, trial), key=lambda row: row.mean_of_all).layout


def start_at(plan: Plan) -> np.ndarray:
    """Return the solution of the generator `costs` (float [P]) that gives a plan its costs.

    Like all costs that it draws they are at most ten times the mean: dearer moves, and those
    that are not allowed, begin there.
    """
    moves = existing_moves(plan.domain.drivable(plan.layout))
    costs = np.ones(moves.shape) if plan.costs is None else plan.costs
    usual = costs[moves & np.isfinite(costs)].mean()
    return np.log(np.minimum(costs[moves] / usual, 10)).astype(np.float32)


def read_solutions(run: RunDirectory) -> dict[str, np.ndarray]:
    """Read what a search of costs found: the best evaluation, and the mean of its distribution.

    With runs of chance the best evaluation was lucky, too; the mean is the average of many.
    """
    config = run.config
    experiment = build_experiment(config, run.read_start())
    algorithm = growing(experiment.algorithm)
    publisher = Publisher(run, experiment, algorithm, experiment.settings(config))
    _, search = publisher.load(Search.begin(algorithm, experiment.search_key))
    mean = np.asarray(search.state.emitters.strategy.mean)[0]
    return {"mean": mean, "best": run.best.solution}


def find_guidance(
    run: RunDirectory, plan: Plan | None = None, fleet: FleetConfig | None = None
) -> tuple[np.ndarray, dict[str, float]]:
    """Draw the best costs that a search found (int32 [5, H, W]), and how they were judged.

    They are for its own floor, or for a `plan` on which a `fleet` drives. Raises InputError if the
    costs of each cell were searched there, which no other floor can have.
    """
    config, model = run.config.evaluation, run.config.evaluation.generator
    if plan is None:
        domain, layout = make_domain(config.domain), run.best.layout
    elif isinstance(model, UpdateConfig) or (isinstance(model, CostsConfig) and model.smooth):
        domain = make_domain(replace(plan.fitted().config, fleet=fleet))
        layout = plan.layout
    else:
        raise InputError(f"{run}: no costs for other floors: guide by the method smooth or update")
    drawer, tasks = make_costs_drawer(config, domain), domain.simulator.tasks
    assert drawer is not None
    costs, judged = {}, {}
    for name, solution in read_solutions(run).items():
        costs[name] = drawer(solution[None], layout[None])[0]
        done = run_seeds(Floor(layout, costs[name]), tasks, domain.config.fleet, JUDGES)
        judged[name] = float(np.mean([one.throughput for one in done.runs]))
    return costs[max(judged, key=judged.__getitem__)], judged
