"""A user's own domain: a garden whose objective is the number of flowers. No stage knows it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.domains.base import Domain, EvaluationConfig, Simulator
from qdenv.grid import of_tiles
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.train.config import RunConfig
from qdenv.types import Adjacency, Array, Count, Measure, Rules

TILES = ".*#"  # path, flower, hedge


class Visit(NamedTuple):
    """One stroll: a random share of the flowers is seen."""

    seen: Array  # float32
    cells: Array  # float32 [H, W]


def rules(rows: int, cols: int, hedges: int) -> Rules:
    return Rules(
        tiles=TILES,
        counts=(Count("#", hedges, hedges),),
        adjacency=(Adjacency("*", "."),),
        connected=".*",
        allowed=np.ones((rows, cols, len(TILES)), bool),
        change_cost=np.ones((rows, cols), np.float32),
    )


def stroll(flowers: Array, key: Array) -> Visit:
    seen = (jax.random.uniform(key, flowers.shape) < 0.5) * flowers
    return Visit(seen.sum(dtype=jnp.float32), seen.astype(jnp.float32))


GARDEN = Domain(
    name="garden",
    tiles=TILES,
    generated=TILES,
    seed_block=("*#",),
    margin=(0, 0),
    frame=lambda tiles: tiles,
    rules=rules,
    simulator=lambda config: Simulator(lambda layout: of_tiles(layout, "*", TILES), stroll),
    objective=lambda layout, runs: runs.seen.mean(),
    price=lambda layout: jnp.ones(layout.shape, jnp.float32),
    measures=(
        Measure("paths", 0, 30, 10, lambda layout, runs: (layout == 0).sum().astype(jnp.float32)),
        Measure(
            "flowers on top",
            0,
            6,
            6,
            lambda layout, runs: (layout[0] == 1).sum().astype(jnp.float32),
        ),
    ),
)

CONFIG = RunConfig(
    evaluation=EvaluationConfig(
        domain="garden",
        rows=5,
        cols=6,
        steps=5,
        kernel_sizes=(3, 1),
        hidden=4,
        shelves=3,
        simulations=3,
    ),
    algorithm=CmaMaeConfig(emitters=2, batch=4, sigma0=0.5),
    evaluations=48,
    checkpoint_every=2,
)
