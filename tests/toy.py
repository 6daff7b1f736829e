"""A user's own domain: a garden whose objective is the number of flowers. No stage knows it."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qdenv.domains.base import DOMAINS, Domain, DomainConfig, Simulator
from qdenv.grid import of_tiles
from qdenv.nca import NcaConfig
from qdenv.pipeline import EvaluationConfig
from qdenv.registry import Entry
from qdenv.run.config import RunConfig
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.types import Adjacency, Count, Measure, Rules

TILES = ".*#"  # path, flower, hedge


@dataclass(frozen=True)
class GardenConfig(DomainConfig):
    """A garden's numbers."""

    rows: int = 5
    cols: int = 6
    hedges: int = 3  # exact number of hedges


class Visit(NamedTuple):
    """One stroll: a random share of the flowers is seen."""

    seen: jax.Array  # float32
    cells: jax.Array  # float32 [H, W]


def rules(config: GardenConfig) -> Rules:
    return Rules(
        tiles=TILES,
        counts=(Count("#", config.hedges, config.hedges),),
        adjacency=(Adjacency("*", "."),),
        connected=".*",
        allowed=np.ones((config.rows, config.cols, len(TILES)), bool),
        change_cost=np.ones((config.rows, config.cols), np.float32),
    )


def stroll(flowers: jax.Array, key: jax.Array) -> Visit:
    seen = (jax.random.uniform(key, flowers.shape) < 0.5) * flowers
    return Visit(seen.sum(dtype=jnp.float32), seen.astype(jnp.float32))


def paths(layout: jax.Array, runs: Visit) -> jax.Array:
    return (layout == 0).sum().astype(jnp.float32)


def flowers_on_top(layout: jax.Array, runs: Visit) -> jax.Array:
    return (layout[0] == 1).sum().astype(jnp.float32)


def garden(config: GardenConfig) -> Domain:
    return Domain(
        config=config,
        tiles=TILES,
        generated=TILES,
        seed_block=("*#",),
        rules=lambda: rules(config),
        simulator=Simulator(lambda layout: of_tiles(layout, "*", TILES), stroll),
        objective=lambda layout, runs: runs.seen.mean(),
        measures=(
            Measure("paths", 0, 30, 10, paths),
            Measure("flowers on top", 0, 6, 6, flowers_on_top),
        ),
        counted={"hedges": "#"},
    )


DOMAINS.register("garden", Entry(GardenConfig, garden))

CONFIG = RunConfig(
    evaluation=EvaluationConfig(
        domain=GardenConfig(),
        generator=NcaConfig(steps=5, kernel_sizes=(3, 1), hidden=4),
        simulations=3,
    ),
    algorithm=CmaMaeConfig(emitters=2, batch=4, sigma0=0.5),
    evaluations=48,
    checkpoint_every=2,
)


def same(left: dict, right: dict) -> bool:
    """Compare dictionaries of arrays bit for bit."""
    return left.keys() == right.keys() and all(
        left[name].tobytes() == right[name].tobytes() for name in left
    )


def files(folder: Path) -> dict[Path, bytes]:
    """Read all files in a folder and below."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
