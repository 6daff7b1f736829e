"""A hall: shelves, endpoints beside them, stations and walls where a plan has them.

Generators draw floor, shelves and endpoints; walls and stations stay where they are. The paper's
warehouse is this domain with a formula that says where its stations are (`warehouse`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from qdenv import score
from qdenv.domains.base import Domain, DomainConfig
from qdenv.domains.fleet import THROUGHPUT, fleet_simulator, throughput
from qdenv.lazy import jax
from qdenv.registry import Entry
from qdenv.simulate.mapf.goals import tile_goal
from qdenv.simulate.mapf.settings import FleetConfig
from qdenv.types import Adjacency, Count, Goal, Measure, Rules, TaskRule, Tile, Traffic

GENERATED = ".@e"
_OBSTACLES = "@#"
_TILES, _STATIONS = ".@ew#io", "wio"
_MEANINGS = {
    ".": Tile("floor", "robots drive here"),
    "@": Tile("shelf", "holds goods; needs an endpoint beside it", True),
    "e": Tile("endpoint", "robots pick goods here; needs a shelf beside it"),
    "w": Tile("workstation", "robots deliver here; stays where the plan has it"),
    "#": Tile("wall", "a wall, a column, a closed room, outside; stays", True, also=" "),
    "i": Tile("inbound station", "a workstation where goods come in; stays"),
    "o": Tile("outbound station", "a workstation where goods leave; stays"),
}


@dataclass(frozen=True)
class HallConfig(DomainConfig):
    """The numbers of a hall."""

    # agents, horizon and planner
    fleet: FleetConfig = field(default_factory=FleetConfig)  # type: ignore[misc]
    shelves: int = 240  # how many shelves there are, exactly


def storage(config: Any, tiles: str, stations: Goal) -> Domain:
    """Make the domain of shelves and endpoints that robots carry goods from, to `stations`.

    Its alphabet `tiles` begins with `GENERATED`; of the other tiles robots drive on all but walls,
    and none has a place of its own. `config` is a `HallConfig` or has its fields.
    """
    drivable = "".join(tile for tile in tiles if tile not in _OBSTACLES)
    shape, kinds = (config.rows, config.cols), len(GENERATED)

    def rules() -> Rules:
        return Rules(
            tiles=tiles,
            counts=(Count("@", config.shelves, config.shelves),),
            adjacency=(Adjacency("@", "e"), Adjacency("e", "@")),
            connected=drivable,
            allowed=np.tile(np.arange(len(tiles)) < kinds, (*shape, 1)),
            change_cost=np.ones(shape, np.float32),
        )

    def components(layout: jax.Array, runs: Traffic) -> jax.Array:
        return score.components(layout, "@", tiles)

    def entropy(layout: jax.Array, runs: Traffic) -> jax.Array:
        # Of the area that is drawn: patterns with walls and stations are no design.
        return score.entropy(layout, kinds, partial=True)

    cycle = (tile_goal("e", tiles)._replace(name="endpoint"), stations._replace(name="workstation"))
    return Domain(
        config=config,
        tiles=tiles,
        generated=GENERATED,
        seed_block=("ee", "@@", "ee"),
        margin=(0, 0),
        frame=lambda area: area,
        rules=rules,
        simulator=fleet_simulator(TaskRule(tiles, drivable, cycle), config.fleet),
        objective=throughput,
        objective_name=THROUGHPUT,
        measures=(
            Measure("connected shelf components", 0, config.shelves, 100, components, "shelves"),
            Measure("environment entropy", 0, 1, 100, entropy),
        ),
        counted={"shelves": "@"},
    )


def hall(config: HallConfig) -> Domain:
    """Make a hall of one size, whose walls and stations are those of `config.keep`."""
    domain = storage(config, _TILES, tile_goal(_STATIONS, _TILES))

    def rules() -> Rules:
        base = domain.rules()  # type: ignore[misc]
        return base._replace(counts=(*base.counts, Count(_STATIONS, 1)))

    stays = _TILES[len(GENERATED) :]
    return replace(domain, rules=rules, stays=stays, meanings=_MEANINGS)


HALL = Entry(HallConfig, hall)
