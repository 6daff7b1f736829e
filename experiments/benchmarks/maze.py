"""Benchmark of the maze: CPU seconds per evaluated maze, longest paths, one small search batch.

An untrained agent runs to the horizon nearly always: its rows are the most that an evaluation can
cost. The shipped agent with its LSTM padded to `units` decides as it always does and costs what a
trained agent of that size costs. All times are CPU seconds of the process; run with one thread to
compare (see `THREADS`).
"""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from qdenv.agent.convert import pad_units
from qdenv.agent.evaluate import (
    default_horizon,
    random_layout,
    random_mazes,
    run_alone,
    run_batch,
    success_rates,
)
from qdenv.io.files import write_json
from qdenv.simulate.maze.policy import Weights, draw_weights, load_weights, units_of
from qdenv.simulate.maze.world import longest_path

THREADS = "XLA_FLAGS='--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1'"


def run(
    units: int = 256,
    mazes: int = 12,
    repeats: int = 3,
    large: bool = True,
    seed: int = 0,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> dict[str, Any]:
    """Time the evaluation of random mazes of 90 walls.

    Args:
        units: LSTM units of the agent with drawn weights, 7 actions as published.
        mazes: 16x16 mazes per batch.
        repeats: timed calls; the best counts, the spread is reported.
        large: time a 64x64 maze with 100 episodes too.
        seed: of the mazes and weights.
        json_file: where to write the result.
    """
    drawn = draw_weights(jax.random.key(seed), units, 7)
    shipped = jax.tree.map(jnp.asarray, load_weights())
    padded = pad_units(shipped, units)
    batch = jnp.asarray(random_mazes(seed, mazes, 16, 16, 90))
    result: dict[str, Any] = {
        "units": units,
        "single_thread": THREADS,
        "backend": jax.default_backend(),
        "untrained_batch": _per_maze(run_batch, drawn, batch, repeats),
        "untrained_one_by_one": _per_maze(_in_line, drawn, batch, repeats),
        "trained_batch": _per_maze(run_batch, padded, batch, repeats),
        "trained_one_by_one": _per_maze(_in_line, padded, batch, repeats),
        "shipped_units": units_of(shipped),
        "shipped_batch": _per_maze(run_batch, shipped, batch, repeats),
        "shipped_one_by_one": _per_maze(_in_line, shipped, batch, repeats),
        "success": {walls: _success(shipped, seed + walls, walls) for walls in (60, 90)},
        "longest_path": _timed(jax.jit(jax.vmap(longest_path)), (batch,), repeats, mazes),
    }
    if large:
        maze = jnp.asarray(random_layout(np.random.default_rng(seed), 64, 64, 1440))
        horizon = default_horizon(maze)
        key = jax.random.key(seed)
        alone = jax.jit(lambda weights, maze: run_alone(weights, maze, key, 100, horizon))
        result["untrained_large"] = _timed(alone, (drawn, maze), 1, 1)
        result["trained_large"] = _timed(alone, (padded, maze), 1, 1)
        result["shipped_large"] = _timed(alone, (shipped, maze), 1, 1)
    print(json.dumps(result, indent=1))
    if json_file:
        write_json(json_file, result)
    return result


def _in_line(weights: Weights, layouts: jax.Array, key: jax.Array, runs: int, horizon: int) -> Any:
    """Evaluate one maze after the other, each until its last episode ends."""
    keys = jax.random.split(key, layouts.shape[0])
    return jax.lax.map(
        lambda item: run_alone(weights, item[0], item[1], runs, horizon), (layouts, keys)
    )


def _success(weights: Weights, seed: int, walls: int) -> dict[str, float]:
    """Measure the agent on 100 random 16x16 mazes of so many walls, 50 episodes each."""
    rates = success_rates(weights, random_mazes(seed, 100, 16, 16, walls))
    return {
        "mean": round(float(rates.mean()), 4),
        "standard_error": round(float(rates.std(ddof=1) / 10), 4),
        "worst_maze": round(float(rates.min()), 2),
    }


def _per_maze(
    evaluate: Callable, weights: Weights, batch: jax.Array, repeats: int
) -> dict[str, float]:
    call = jax.jit(lambda weights, batch: evaluate(weights, batch, jax.random.key(1), 50, 648))
    return _timed(call, (weights, batch), repeats, batch.shape[0])


def _timed(call: Callable, arguments: tuple, repeats: int, items: int) -> dict[str, float]:
    """Time a compiled call: best and worst CPU seconds per item, and the first call's."""
    times = []
    for _ in range(repeats + 1):
        began = time.process_time()
        jax.block_until_ready(call(*arguments))
        times.append(time.process_time() - began)
    first, *rest = times
    return {
        "cpu_seconds": round(min(rest) / items, 6),
        "worst": round(max(rest) / items, 6),
        "first_call": round(first, 3),
    }
