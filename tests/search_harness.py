"""A small search problem, and every algorithm compiled once for all tests that run it."""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from qdenv.search.base import Algorithm, Problem
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.search.registry import ALGORITHMS, make_algorithm
from qdenv.search.settings import DsageConfig, ScreenedConfig
from qdenv.surrogates.settings import SurrogateConfig
from qdenv.types import Encoding, Measure, Score

DIM = 12
GRID = (Measure("x", -1, 1, 8), Measure("y", -1, 1, 9))
QUICK = {"xla_backend_optimization_level": 0}  # these searches compile longer than they run
EXTRAS = {"layout": np.zeros((2, 3), np.int8), "runs": np.zeros(4, np.float32)}
# What algorithms that look at solutions see: 3 x 4 tiles of three kinds.
TILES = Encoding(
    draw=lambda solutions: solutions.astype(np.int8).reshape(-1, 3, 4),
    shape=(3, 4),
    kinds=3,
    choices=3,
    repairs=True,
    usage=True,
)
PROBLEM = Problem(DIM, GRID, EXTRAS, TILES)
TINY = SurrogateConfig(channels=4, blocks=1, epochs=1, minibatch=8, samples=64)
SMALL_DSAGE = DsageConfig(
    batch=8, initial=16, inner_iterations=4, inner_batch=8, downsample=(4, 3), surrogate=TINY
)
CONFIGS = (
    # The search around a plan moves tiles, not numbers: test_search_rearrange.
    {name: ALGORITHMS.config(name) for name in ALGORITHMS.names() if name != "rearrange"}
    | {
        "cma-mae-screened": ScreenedConfig(emitters=2, batch=6, screen=2, refit=2, surrogate=TINY),
        "dsage": SMALL_DSAGE,
    }
    | {
        f"cma-mae with {name}": CmaMaeConfig(emitters=2, batch=6, strategy=name)
        for name in ("full", "lm_ma", "SNES")
    }
)


class Compiled(NamedTuple):
    """An algorithm with jitted functions and the names of those that were traced."""

    algorithm: Algorithm
    init: Callable
    ask: Callable
    tell: Callable
    traced: list


def compile_search(config, problem, donated=0):
    algorithm, traced = make_algorithm(config, problem), []

    def jit(name, donate=()):
        def call(*args):
            traced.append(name)
            return getattr(algorithm, name)(*args)

        return jax.jit(call, donate_argnums=donate, compiler_options=QUICK)

    return Compiled(algorithm, jit("init"), jit("ask"), jit("tell", donated), traced)


@functools.cache
def compiled(config):
    return compile_search(config, PROBLEM)


def score_of(solutions, numbers=np):
    """Score the negative sphere around 0.3 over the first two parameters."""
    objective = 5 - numbers.square(solutions - 0.3).sum(axis=-1)
    success = numbers.ones(len(solutions), bool)
    return Score(objective, objective - 1, solutions[:, :2], success)


def extras_of(solutions, numbers=np):
    layouts = (numbers.abs(solutions[:, :6]) * 10).astype(np.int8).reshape(-1, 2, 3)
    tiles = numbers.abs(solutions).astype(np.int8).reshape(-1, 3, 4) % 3
    usage = (tiles + 1) / (tiles + 1).sum(axis=(1, 2), keepdims=True)
    told = {"repaired": tiles, "usage": usage.astype(np.float32)}
    return {"layout": layouts, "runs": solutions[:, :4], **told}


def iterate(search, state, change=lambda score: score):
    """Run one iteration with the evaluation on the host."""
    solutions, state = search.ask(state)
    solutions = np.array(solutions)
    return search.tell(state, solutions, change(score_of(solutions)), extras_of(solutions))


def assert_same(left, right):
    jax.tree.map(np.testing.assert_array_equal, left, right)


def on_host(tree):
    """Copy a state off the device: the original may be donated."""
    return jax.tree.map(lambda leaf: np.array(leaf), tree)
