"""Benchmark of DSAGE's surrogate: seconds of an inner iteration and of a step of learning, memory.

One process measures one size, so that its peak of memory is its own.
"""

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Annotated, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from qdenv.generate import DirectConfig
from qdenv.io.files import write_json
from qdenv.pipeline import make_pipeline
from qdenv.presets import find_preset
from qdenv.run.problem import archive_axes, problem_of
from qdenv.search.base import Problem
from qdenv.search.settings import DsageConfig
from qdenv.search.surrogate_samples import aspect_of, drawing_of
from qdenv.search.surrogate_search import search_surrogate
from qdenv.surrogate.samples import Ring, Samples
from qdenv.surrogate.settings import PUBLISHED, SurrogateConfig
from qdenv.surrogate.surrogate import Aspect, Fitted, Surrogate, make_surrogate, stages_of
from qdenv.types import Score

SIZES = {"small": SurrogateConfig(), "published": PUBLISHED}


@dataclass(frozen=True)
class Options:
    """What to measure, and what to reckon an outer loop with."""

    # of the surrogate; small are the defaults, for CPUs
    size: Literal["small", "published"] = "small"
    preset: str = "warehouse-even"  # whose layouts and archive
    timed: int = 4  # inner iterations, and steps of learning, per repeat
    repeats: int = 3  # the median of which is said
    inner_iterations: int = 10_000  # of an outer loop
    epochs: int = 20  # of an outer loop
    samples: int = 20_000  # that an outer loop learns


class Spent(NamedTuple):
    """Seconds."""

    wall: float  # of one iteration or step, by the clock
    cpu: float  # the same, of all threads
    compile: float  # CPU seconds of the compilation before them


def run(
    options: Annotated[Options, tyro.conf.arg(name="")],
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Time the two loops of DSAGE's outer loop on random layouts; nothing is evaluated truly.

    Args:
        options: what to measure.
        json_file: where to write the result.

    Raises:
        InputError: no preset has this name.
    """
    problem = searched(options.preset)
    aspect = aspect_of(problem, drawing_of(problem, "dsage"))
    config = replace(SIZES[options.size], samples=64 * options.timed, epochs=1, minibatch=64)
    surrogate = make_surrogate(config, aspect)
    fitted = jax.jit(surrogate.init)(jax.random.key(0))
    result: dict[str, Any] = {
        "device": jax.devices()[0].device_kind,
        **vars(options),
        "shape": aspect.shape,
        "parameters": {name: weights(fitted, name) for name in stages_of(aspect)},
        "inner_iteration": time_inner(options, problem, surrogate, fitted)._asdict(),
        "step": {
            name: time_step(options, name, aspect, surrogate, fitted)._asdict()
            for name in stages_of(aspect)
        },
    }
    result |= {"outer_loop": reckon(options, result), "peak_bytes": peak_bytes()}
    show(result)
    if json_file:
        write_json(json_file, result)
    return result


def searched(preset: str) -> Problem:
    """Say what DSAGE searches with the layouts of a preset."""
    config = find_preset(preset)
    pipeline = make_pipeline(replace(config.evaluation, generator=DirectConfig()))
    return problem_of(pipeline, archive_axes(pipeline.domain.measures, config.archive))


def time_inner(options: Options, problem: Problem, surrogate: Surrogate, fitted: Fitted) -> Spent:
    """Time an inner iteration, inside its loop: 50 solutions are mutated, predicted, inserted."""
    drawing = drawing_of(problem, "dsage")
    config = DsageConfig(inner_iterations=options.timed)

    def search(fitted: Fitted, key: jax.Array) -> Any:
        def predict(solutions: jax.Array) -> Score:
            return surrogate.predict(fitted, drawing.draw(solutions.astype(jnp.float32))).score

        return search_surrogate(config, problem, drawing.choices, predict, key)

    return spent(search, (fitted, jax.random.key(1)), options)


def time_step(
    options: Options, name: str, aspect: Aspect, surrogate: Surrogate, fitted: Fitted
) -> Spent:
    """Time a step of learning of one network, inside its loop: a minibatch of 64."""
    rng, count = np.random.default_rng(0), 64 * options.timed
    maps = rng.integers(0, aspect.kinds, (count, *aspect.shape)).astype(np.int8)
    usage = rng.random(maps.shape).astype(np.float32)
    numbers = rng.normal(size=(count, surrogate.heads)).astype(np.float32)
    ring = Ring.empty(count, aspect.shape, surrogate.heads).add(
        Samples(
            *map(jnp.asarray, (maps, maps, usage / usage.sum(axis=(1, 2), keepdims=True), numbers))
        ),
        jnp.ones(count, bool),
    )

    def learn(fitted: Fitted, ring: Ring, key: jax.Array) -> Any:
        return surrogate.fit_part(fitted, ring, key, name, 0, 1)[0].learners[name]

    return spent(learn, (fitted, ring, jax.random.key(2)), options)


def spent(work: Callable[..., Any], arguments: tuple, options: Options) -> Spent:
    """Compile a loop of `timed` rounds, run it once, and take the median of its repeats."""
    began = time.process_time()
    loop = jax.jit(work).lower(*arguments).compile()
    compiled = time.process_time() - began
    jax.block_until_ready(loop(*arguments))
    walls, cpus = [], []
    for _ in range(options.repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        jax.block_until_ready(loop(*arguments))
        walls.append((time.perf_counter() - wall) / options.timed)
        cpus.append((time.process_time() - cpu) / options.timed)
    return Spent(median(walls), median(cpus), compiled)


def weights(fitted: Fitted, name: str) -> int:
    """Count the parameters of one network."""
    leaves = jax.tree.leaves(fitted.learners[name].variables["params"])
    return sum(leaf.size for leaf in leaves)


def reckon(options: Options, result: dict[str, Any]) -> dict[str, float]:
    """Reckon the seconds of an outer loop: all inner iterations, all steps of all networks."""
    steps = options.epochs * -(-options.samples // 64)
    return {
        clock: options.inner_iterations * result["inner_iteration"][clock]
        + steps * sum(step[clock] for step in result["step"].values())
        for clock in ("wall", "cpu")
    }


def peak_bytes() -> int:
    """Tell the peak of an accelerator's memory, or of the process on a CPU."""
    stats = jax.devices()[0].memory_stats() or {}
    usual = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    return int(stats.get("peak_bytes_in_use", usual))


def show(result: dict[str, Any]) -> None:
    """Print the numbers as a table."""
    total = sum(result["parameters"].values())
    rows = {"inner iteration": result["inner_iteration"]}
    rows |= {f"step of {name}": step for name, step in result["step"].items()}
    print(f"{result['size']}, {result['preset']}, {result['device']}: {total:,} parameters")
    print(f"{'':18s}{'wall ms':>10s}{'CPU ms':>10s}{'compile CPU s':>15s}")
    for name, row in rows.items():
        line = f"{1e3 * row['wall']:10.1f}{1e3 * row['cpu']:10.1f}{row['compile']:15.1f}"
        print(f"{name:18s}{line}")
    outer = result["outer_loop"]
    print(
        f"outer loop of {result['inner_iterations']:,} inner iterations and {result['epochs']} "
        f"epochs of {result['samples']:,} samples: {outer['wall'] / 3600:.2f} h, "
        f"{outer['cpu'] / 3600:.2f} CPU hours; peak {result['peak_bytes'] / 2**30:.2f} GiB"
    )
