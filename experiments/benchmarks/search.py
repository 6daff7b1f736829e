"""Benchmarks of the search alone: CMA-MAE beside pyribs, and DSAGE's surrogate."""

import importlib.util
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

import qdenv
from experiments.benchmarks.common import Row, Stopwatch, best_of, save, show
from qdenv.generators import DirectConfig
from qdenv.ranges import PositiveInt
from qdenv.run.config import archive_axes
from qdenv.run.experiment import problem_of
from qdenv.search.cma_mae import CmaMaeConfig, cma_mae
from qdenv.search.dsage import search_surrogate
from qdenv.search.model import Model
from qdenv.search.settings import DsageConfig
from qdenv.study.options import find_surrogate
from qdenv.surrogates.surrogate import Ring, Samples

GRID = (qdenv.Measure("x", -1, 1, 100), qdenv.Measure("y", -1, 1, 100))
MAZE = (qdenv.Measure("walls", 0, 256, 256), qdenv.Measure("path length", 0, 648, 162))
PYRIBS_NAMES = {"full": "cma_es", "iso": "cma_es", "sep": "sep_cma_es", "lm_ma": "lm_ma_es"}
# Name, parameters, emitters, batch, strategy, iterations of pyribs (0: it would take minutes).
CASES = (
    ("paper", 2_051, 5, 10, "iso", 5),
    ("paper", 2_051, 5, 10, "sep", 50),
    ("kernels 3,3,3", 11_011, 5, 10, "iso", 0),
    ("kernels 3,3,3", 11_011, 5, 10, "sep", 50),
    ("sphere", 100, 15, 36, "full", 100),
    ("sphere", 100, 15, 36, "iso", 100),
    ("sphere", 100, 15, 36, "sep", 100),
    ("sphere", 100, 15, 36, "lm_ma", 100),
)


def search(iterations: PositiveInt = 100, only: str = "", json: Path | None = None) -> Row:
    """Time ask and tell of CMA-MAE (100 x 100 cells) and a large insertion, beside pyribs.

    Evaluation and compilation are left out. pyribs is timed if it is installed.

    Args:
        iterations: number of timed iterations of qdenv.
        only: the cases whose name or strategy contains this, without the insertion.
        json: file of the result.
    """
    pyribs = importlib.util.find_spec("ribs") is not None

    def rows() -> Iterator[Row]:
        for name, dim, emitters, batch, strategy, pyribs_iterations in CASES:
            if only not in f"{name} {strategy}":
                continue
            case = dim, emitters, batch, strategy
            timing = {"pyribs_cpu_ms": None, "pyribs_wall_ms": None}
            timing = time_search(*case, iterations).per(iterations) | timing
            if pyribs and pyribs_iterations:
                timing |= time_pyribs(*case, pyribs_iterations).per(pyribs_iterations, "pyribs_")
            yield {"search": f"{name}, {strategy}, {emitters} x {batch} x {dim:,}", **timing}

    tables = {"searches": show("CMA-MAE, per iteration", rows())}
    if not only:
        tables["insertion"] = show("1,000 solutions into 41,472 cells", time_insertion(pyribs))
    return save(json, **tables)


def evaluate(solutions: Any, numbers: Any) -> tuple[Any, Any]:
    """Evaluate with numpy or jax.numpy: a bowl; the measures are scaled means of both halves."""
    objective = 1 - numbers.square(solutions - 0.1).mean(axis=1)
    half = solutions.shape[1] // 2
    means = [solutions[:, :half].mean(axis=1), solutions[:, half:].mean(axis=1)]
    return objective, numbers.stack(means, axis=1) * half**0.5


def time_search(dim: int, emitters: int, batch: int, strategy: Any, iterations: int) -> Stopwatch:
    """Time ask and tell as two jitted calls per iteration, the state donated to both."""
    config = CmaMaeConfig(emitters, batch, strategy=strategy)
    algorithm = cma_mae(config, qdenv.Problem(dim, GRID))
    ask = jax.jit(algorithm.ask, donate_argnums=0)
    tell = jax.jit(algorithm.tell, donate_argnums=0)

    @jax.jit
    def score(solutions: Any) -> Any:
        objective, measures = evaluate(solutions, jnp)
        return qdenv.Score(objective, objective, measures, jnp.ones(len(solutions), bool))

    state = algorithm.init(jax.random.key(0))
    for iteration in range(iterations + 3):
        if iteration in (0, 3):  # the first three compile
            watch = Stopwatch()
        with watch:
            solutions, state = jax.block_until_ready(ask(state))
        scores = jax.block_until_ready(score(solutions))
        with watch:
            state = jax.block_until_ready(tell(state, solutions, scores, {}))
    return watch


def pyribs_archive(dim: int, axes: tuple, **options: Any) -> Any:
    """Make an archive of pyribs in float32."""
    from ribs.archives import GridArchive

    dims, ranges = [axis.cells for axis in axes], [(axis.low, axis.high) for axis in axes]
    return GridArchive(solution_dim=dim, dims=dims, ranges=ranges, dtype=np.float32, **options)


def time_pyribs(dim: int, emitters: int, batch: int, strategy: str, iterations: int) -> Stopwatch:
    """Time ask and tell of a pyribs scheduler with the same settings."""
    from ribs.emitters import EvolutionStrategyEmitter
    from ribs.schedulers import Scheduler

    archive = pyribs_archive(dim, GRID, learning_rate=0.01, threshold_min=0.0)
    options = {"x0": np.zeros(dim), "sigma0": 0.2, "ranker": "imp", "selection_rule": "mu"}
    options |= {"es": PYRIBS_NAMES[strategy], "restart_rule": "no_improvement"}
    group = [
        EvolutionStrategyEmitter(archive, batch_size=batch, seed=seed, **options)
        for seed in range(emitters)
    ]
    scheduler = Scheduler(archive, group, result_archive=pyribs_archive(dim, GRID))
    scheduler.tell(*evaluate(scheduler.ask(), np))  # numba compiles here
    with Stopwatch() as watch:
        for _ in range(iterations):
            scheduler.tell(*evaluate(scheduler.ask(), np))
    return watch


def time_insertion(pyribs: bool) -> Iterator[Row]:
    """Time adding 1,000 solutions of 100 parameters to the maze's 256 x 162 cells."""
    rng = np.random.default_rng(0)
    batch = (
        rng.normal(size=(1000, 100)).astype(np.float32),
        rng.normal(size=1000).astype(np.float32),
        rng.uniform(0, (256, 648), (1000, 2)).astype(np.float32),
    )
    insert = jax.jit(lambda archive, *rows: archive.insert(*rows)[0], donate_argnums=0)
    archive = insert(qdenv.GridArchive.empty(jnp.zeros(100), MAZE), *batch)
    with Stopwatch() as watch:
        for _ in range(50):
            archive = jax.block_until_ready(insert(archive, *batch))
    yield {"archive": "qdenv", **watch.per(50)}
    if pyribs:
        archive = pyribs_archive(100, MAZE)
        with Stopwatch() as watch:
            for _ in range(50):
                archive.add(*batch)
        yield {"archive": "pyribs", **watch.per(50)}


MINIBATCH = 64


def surrogate(
    size: Literal["small", "published"] = "small",
    preset: str = "warehouse-even",
    rounds: int = 4,
    repeats: PositiveInt = 3,
    inner_iterations: int = 10_000,
    epochs: int = 20,
    samples: int = 20_000,
    json: Path | None = None,
) -> Row:
    """Time DSAGE's two loops, inner iterations and training steps, on random layouts.

    Args:
        size: of the surrogate; small is the default of searches, for CPUs.
        preset: whose layouts and archive.
        rounds: number of inner iterations, and of training steps, per call.
        repeats: number of timed calls.
        inner_iterations: of the outer loop whose hours are estimated.
        epochs: of the outer loop.
        samples: of the outer loop.
        json: file of the result.
    """
    problem = search_problem(preset)
    count = MINIBATCH * rounds
    config = replace(find_surrogate(size, {}), samples=count, epochs=1, minibatch=MINIBATCH)
    model = Model(config, problem, "dsage")
    encoding, networks = model.encoding, model.surrogate
    fitted = jax.jit(networks.init)(jax.random.key(0))
    ring = random_samples(count, encoding, networks.heads)

    @jax.jit
    def iterate(fitted: Any) -> Any:
        inner, predict = DsageConfig(inner_iterations=rounds), partial(model.predict, fitted)
        return search_surrogate(inner, problem, encoding.choices, predict, jax.random.key(1))

    @partial(jax.jit, static_argnums=0)
    def train(name: str, fitted: Any, ring: Any) -> Any:
        return networks.fit_part(fitted, ring, jax.random.key(2), name, 0, 1)[0].learners[name]

    def rows() -> Iterator[Row]:
        timing = best_of(repeats, partial(iterate, fitted), rounds)
        yield {"loop": "inner iteration", "weights": None, **timing}
        for name, learner in fitted.learners.items():
            timing = best_of(repeats, partial(train, name, fitted, ring), rounds)
            weights = sum(leaf.size for leaf in jax.tree.leaves(learner.variables["params"]))
            yield {"loop": f"training step, {name}", "weights": weights, **timing}

    timings = show(f"{size} surrogate, {preset}, {encoding.shape}", rows())
    hours = outer_loop_hours(timings, inner_iterations, epochs, samples)
    title = f"outer loop: {inner_iterations:,} inner iterations, {epochs} x {samples:,} samples"
    return save(json, timings=timings, outer_loop=show(title, [hours]))


def search_problem(preset: str) -> Any:
    """Return what DSAGE searches with a preset's layouts; raise InputError if there is none."""
    config = qdenv.find_preset(preset)
    pipeline = qdenv.make_pipeline(replace(config.evaluation, generator=DirectConfig()))
    return problem_of(pipeline, archive_axes(pipeline.domain.measures, config.archive))


def random_samples(count: int, encoding: Any, heads: int) -> Any:
    """Fill a buffer with random layouts, maps of usage that sum to 1, and targets."""
    rng = np.random.default_rng(0)
    maps = rng.integers(0, encoding.kinds, (count, *encoding.shape)).astype(np.int8)
    usage = rng.random(maps.shape).astype(np.float32)
    usage /= usage.sum(axis=(1, 2), keepdims=True)
    targets = rng.normal(size=(count, heads)).astype(np.float32)
    samples = Samples(*map(jnp.asarray, (maps, maps, usage, targets)))
    return Ring.empty(count, encoding.shape, heads).add(samples, jnp.ones(count, bool))


def outer_loop_hours(timings: list[Row], inner_iterations: int, epochs: int, samples: int) -> Row:
    """Estimate the hours of an outer loop: all inner iterations, all steps of all networks."""
    inner, *steps = timings
    count = epochs * -(-samples // MINIBATCH)
    total = {
        clock: inner_iterations * inner[clock] + count * sum(step[clock] for step in steps)
        for clock in ("cpu_ms", "wall_ms")
    }
    return {"clock": "hours", "cpu": total["cpu_ms"] / 3.6e6, "wall": total["wall_ms"] / 3.6e6}
