"""Guidance: the published floors and graphs, ours beside them.

    python -m experiments.guidance table     Table 3 of Zhang et al. 2024 from the files at hand
    python -m experiments.guidance search    costs searched for these floors, by seeds

Zhang, Jiang, Bhatt, Nikolaidis and Li 2024, "Guidance graph optimization for lifelong multi-agent
path finding", https://arxiv.org/abs/2402.01446. The floors and graphs of its authors are read from
the folder that QDENV_STUDY_DATA names; they are not part of this repository.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp

from qdenv.domains.base import DOMAINS, Domain, DomainConfig
from qdenv.domains.fleet import THROUGHPUT, fleet_simulator, throughput
from qdenv.registry import Entry
from qdenv.simulate.mapf.goals import tile_goal
from qdenv.simulate.mapf.settings import FleetConfig
from qdenv.types import Measure, TaskRule, Tile

TILES = ".@ew"
_MEANINGS = {
    ".": Tile("empty"),
    "@": Tile("obstacle", obstacle=True),
    "e": Tile("endpoint"),
    "w": Tile("workstation"),
}


@dataclass(frozen=True)
class FloorConfig(DomainConfig):
    """A published floor, on which agents visit the tiles of `cycle` in turn."""

    fleet: FleetConfig = field(default_factory=FleetConfig)  # type: ignore[misc]
    cycle: str = "we"  # as published: first a workstation; "." where every free cell is a goal


def floor(config: FloorConfig) -> Domain:
    """Make the domain of published floors, which nobody repairs."""

    def cells(layout: jax.Array, runs: Any) -> jax.Array:
        return (layout != TILES.index("@")).sum().astype(jnp.float32)

    goals = tuple(tile_goal(kind, TILES) for kind in config.cycle)
    return Domain(
        config=config,
        tiles=TILES,
        generated=TILES,
        seed_block=(".",),
        margin=(0, 0),
        frame=lambda tiles: tiles,
        rules=None,
        simulator=fleet_simulator(TaskRule(TILES, ".ew", goals), config.fleet),
        objective=throughput,
        objective_name=THROUGHPUT,
        measures=(Measure("free cells", 0, config.rows * config.cols, 1, cells),),
        meanings=_MEANINGS,
    )


@dataclass(frozen=True)
class OpenFloorConfig(FloorConfig):
    """A published floor where every free cell is a goal."""

    cycle: str = "."


DOMAINS.register("published-floor", Entry(FloorConfig, floor))
DOMAINS.register("published-open-floor", Entry(OpenFloorConfig, floor))
