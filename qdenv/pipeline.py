"""The chain on one screen: parameters, grow, repair, simulate, score.

A search's vmaps over layouts and simulations are here. `evaluate` is one traceable function with
the repair as a host callback; `PipelinedEvaluator` runs the same chain as jitted parts around
explicit repairs, so that one layout is repaired while another is simulated. Both give the same
numbers for the same key.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv import devices, mesh
from qdenv.domains.base import Domain, Simulator, make_domain
from qdenv.generators import GENERATORS, Generator
from qdenv.repairs.pool import RepairPool, repair_in_jit
from qdenv.score import similarity
from qdenv.settings import EvaluationConfig
from qdenv.types import Array, Evaluation, RepairStatus, Score


class Pipeline(NamedTuple):
    """The chain of one configuration; every function below is traceable."""

    domain: Domain  # what is generated, repaired and simulated
    solution_size: int  # parameters P of one solution
    choices: int  # where each parameter names a tile, how many there are; 0 for real numbers
    grow: Callable[[jax.Array], jax.Array]  # float32 [B, P] -> unrepaired layouts int8 [B, H, W]
    pool: RepairPool | None  # repairs layouts on the host; None where the domain repairs nothing
    repair_seed: int  # the layout's own content and this number decide its repair
    # (layouts [B, H, W], indices [B], key, their solutions [B, P] where the generator draws costs
    # of moves) -> runs with leading axes B, S
    simulate: Callable[..., Any]
    # (unrepaired, repaired, status, runs), each with leading axis B -> `Evaluation`
    score: Callable[[jax.Array, jax.Array, jax.Array, Any], Evaluation]
    # (solution float32 [P], repaired layout int8 [H, W], key) -> int32 [5, H, W], the costs of
    # moves that the generator draws; None where it draws none
    guide: Callable[[Any, Any, Any], Any] | None


def make_pipeline(config: EvaluationConfig, repair_seed: int = 0) -> Pipeline:
    """Build the chain from parameters to scores that `config` describes.

    Another `repair_seed` gives other repairs of about equal cost. Raises InputError if the canvas
    is too small.
    """
    domain = make_domain(config.domain)
    generator = GENERATORS.make(config.generator, domain.canvas)
    # A generator that draws no tiles leaves the floor as it is, whatever rules it obeys.
    repairs = getattr(config.generator, "draws", True)
    guide = None if generator.guide is None else partial(draw_costs, domain.simulator, generator)

    def grow(parameters: jax.Array) -> jax.Array:
        return jnp.asarray(jax.vmap(domain.frame)(generator.grow(parameters, generator.steps)))

    def simulate(
        layouts: jax.Array, indices: jax.Array, key: jax.Array, solutions: Any = None
    ) -> Any:
        keys = jax.vmap(lambda index: jax.random.fold_in(key, index))(indices)
        guided = None if guide is None else (guide, solutions)
        return simulate_layouts(domain.simulator, layouts, keys, config.simulations, guided)

    return Pipeline(
        domain=domain,
        solution_size=generator.size,
        choices=generator.choices,
        grow=grow,
        pool=RepairPool(domain.rules(), config.repair) if domain.rules and repairs else None,
        repair_seed=repair_seed,
        simulate=simulate,
        score=jax.vmap(partial(score_layout, domain, config.alpha)),
        guide=guide,
    )


def _grow_layouts(grow: Callable[[jax.Array], jax.Array], parameters: jax.Array) -> jax.Array:
    """Grow a population float32 [B, P], a share of it on each device (-> int8 [B, H, W])."""
    return grow(parameters) if devices.count() == 1 else mesh.map_items(grow, parameters)


def draw_costs(
    simulator: Simulator, generator: Generator, solution: Any, layout: Any, key: Any
) -> Any:
    """Draw the costs of moves of one layout (int32 [5, H, W]); `key` decides its simulations."""
    guide, count_moves = generator.guide, simulator.count_moves
    assert guide is not None and count_moves is not None

    def drive(costs: jax.Array, number: int) -> Any:
        return count_moves(simulator.prepare(layout, costs), jax.random.fold_in(key, number))

    return guide(solution, generator.steps, layout, drive)


def simulate_layouts(
    simulator: Simulator,
    layouts: jax.Array,
    keys: jax.Array,
    simulations: int,
    guided: tuple[Callable[..., Any], jax.Array] | None = None,
) -> Any:
    """Simulate layouts [B, H, W], each `simulations` times from its own key of `keys` [B].

    `guided` draws the costs of moves, `Pipeline.guide`, and holds its solutions [B, P].
    """
    runs = jax.vmap(lambda key: jax.random.split(key, simulations))(keys)

    def in_lanes(function: Callable, items: Any, lanes: int) -> Any:
        """Map over the leading axis, `lanes` items at a time side by side."""
        return jax.lax.map(function, items, batch_size=lanes if lanes > 1 else None)

    guide, solutions = guided or (None, None)
    items = layouts, solutions, keys if guide else None

    def share(items: tuple[Any, ...], runs: jax.Array) -> Any:
        lanes = runs.shape[1] if simulator.layout_at_once else 1
        if not simulator.on_host():
            lanes = devices.lanes(simulator.accelerator_lanes, lanes)

        def one(item: tuple[Any, ...]) -> Any:
            layout, solution, key, runs = item
            costs = [guide(solution, layout, key)] if guide else []
            tables = simulator.prepare(layout, *costs)
            return in_lanes(lambda run: simulator.run(tables, run), runs, lanes)

        return in_lanes(one, (*items, runs), lanes // runs.shape[1])

    if simulator.num_devices == 1:
        return share(items, runs)
    return mesh.map_runs(share, items, runs)


def score_layout(
    domain: Domain,
    alpha: float,
    unrepaired: jax.Array,
    repaired: jax.Array,
    status: jax.Array,
    runs: Any,
) -> Evaluation:
    """Score one layout: f_res, f_opt = f_res + alpha * similarity, measures (section 4).

    A layout without a feasible repair, or with a number that is not finite, gets zeros and
    ``success = False``: the search enters it nowhere.
    """
    alike = similarity(unrepaired, repaired, domain.similarity_weights(unrepaired))
    result = domain.objective(repaired, runs)
    values = [measure.value for measure in domain.measures if measure.value is not None]
    measures = jnp.stack([value(repaired, runs) for value in values])
    finite = jnp.isfinite(result) & jnp.isfinite(measures).all()
    success = (status < RepairStatus.IMPOSSIBLE) & finite
    result, measures = jnp.where(success, result, 0.0), jnp.where(success, measures, 0.0)
    objective = jnp.where(success, result + alpha * alike, 0.0)
    score = Score(objective, result, measures, success)
    return Evaluation(score, unrepaired, repaired, alike, status, runs)


def evaluate(pipeline: Pipeline, parameters: jax.Array, key: jax.Array) -> Evaluation:
    """Evaluate a population; traceable, with the repair as a host callback.

    `pipeline` is from `make_pipeline`, `parameters` are float32 [B, P]. Consumes `key`: item ``i``
    uses ``fold_in(key, i)``, so a shorter batch gives the same. Returns the evaluation, with a
    leading axis B; a layout that fails a stage has ``success = False``.
    """
    unrepaired = _grow_layouts(pipeline.grow, parameters)
    repaired, status = unrepaired, jnp.full(len(unrepaired), RepairStatus.OPTIMAL, jnp.int32)
    if pipeline.pool is not None:
        repair = repair_in_jit(pipeline.pool, unrepaired, pipeline.repair_seed)
        repaired, status = jnp.asarray(repair.layout), repair.status
    solutions = parameters if pipeline.guide else None
    runs = pipeline.simulate(repaired, jnp.arange(unrepaired.shape[0]), key, solutions)
    return pipeline.score(unrepaired, repaired, status, runs)


# Repaired layouts of a population (int8 [B, H, W]), how the repairs ended (int32 [B]), and the runs
# of the simulator, with leading axes B, S.
Outcomes = tuple[np.ndarray, np.ndarray, Any]
# Begins to repair and simulate unrepaired layouts int8 [B, H, W] from a key, and returns futures of
# the parts of the population, in order. Item ``i`` draws from ``fold_in(key, i)`` on any worker.
# Solutions float32 [B, P] follow where the pipeline is guided, else None.
LayoutEvaluator = Callable[[np.ndarray, Array, np.ndarray | None], Sequence[Future[Outcomes]]]


class PipelinedEvaluator:
    """Evaluate populations with repair and simulation overlapping, wherever they are done.

    `evaluate_layouts` repairs and simulates, like `run.evaluate.Threads`. Several
    populations may be under way at once.
    """

    def __init__(self, pipeline: Pipeline, evaluate_layouts: LayoutEvaluator) -> None:
        """Compile nothing yet."""
        self._evaluate_layouts = evaluate_layouts
        self._is_guided = pipeline.guide is not None
        self._grow = jax.jit(partial(_grow_layouts, pipeline.grow))
        self._score = jax.jit(pipeline.score)

    def begin(self, parameters: Array, key: Array) -> Callable[[], Evaluation]:
        """Begin what `evaluate` does; the function that is returned waits for the evaluation."""
        with mesh.turn:
            unrepaired = np.asarray(self._grow(parameters))
        solutions = np.asarray(parameters) if self._is_guided else None
        parts = self._evaluate_layouts(unrepaired, key, solutions)
        return lambda: self._score(unrepaired, *joined([part.result() for part in parts]))


def joined(parts: Sequence[Outcomes]) -> Outcomes:
    """Put the outcomes of parts of a population together, in order."""
    return jax.tree.map(lambda *part: np.concatenate(part), *parts)
