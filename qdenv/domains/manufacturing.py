"""Manufacturing: agents visit three kinds of station in turn and stay at each (appendix B.2)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from qdenv import score
from qdenv.domains import designs
from qdenv.domains.base import Domain, DomainConfig, KnownSize, environment_entropy
from qdenv.domains.fleet import THROUGHPUT, fleet_simulator, throughput
from qdenv.grid import of_tiles, parse
from qdenv.lazy import jax, jnp
from qdenv.ranges import Stay
from qdenv.registry import Entry
from qdenv.simulation.mapf.goals import GoalOdds, beside_goal
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.types import Adjacency, Count, Measure, Rules, TaskRule, Tile, Traffic

TILES = ".012e"
_STATIONS = "012"
_MEANINGS: dict[str, Tile] = {
    ".": Tile("floor", "robots drive past the stations"),
    "0": Tile("station 0", "the first of three kinds; needs an endpoint beside it", True),
    "1": Tile("station 1", "the second kind, where robots go next", True),
    "2": Tile("station 2", "the third kind, the last of a task", True),
    "e": Tile("endpoint", "robots stay here while served; needs a station beside it"),
}
_STATION_WEIGHT = 5.0  # p_i of a generated station in the similarity (appendix C.2.1)


@dataclass(frozen=True)
class ManufacturingConfig(DomainConfig):
    """Settings of a factory."""

    # agents, horizon and planner
    fleet: FleetConfig = field(default_factory=FleetConfig)  # type: ignore[misc]
    stays: tuple[Stay, Stay, Stay] = (2, 5, 10)  # timesteps served beside each kind of station
    # how robots choose among the endpoints beside stations of the next kind: all alike (appendix
    # B.2), or as often as such stations stand beside them (the published code)
    goal_odds: GoalOdds = "endpoints"


def rules(rows: int, cols: int) -> Rules:
    """State the constraints of appendix B.2."""
    return Rules(
        tiles=TILES,
        counts=tuple(Count(station, 1) for station in _STATIONS),
        adjacency=(Adjacency(_STATIONS, "e"), Adjacency("e", _STATIONS)),
        connected=".e",
        allowed=np.ones((rows, cols, len(TILES)), bool),
        change_cost=np.ones((rows, cols), np.float32),
    )


def manufacturing(config: ManufacturingConfig) -> Domain:
    """Make a factory of one size."""
    shape = (config.rows, config.cols)

    def workstations(layout: jax.Array, runs: Traffic) -> jax.Array:
        return score.count(layout, _STATIONS, TILES)

    cycle = tuple(
        beside_goal("e", station, stay, TILES, config.goal_odds)
        for station, stay in zip(_STATIONS, config.stays, strict=True)
    )
    return Domain(
        config=config,
        generated=TILES,
        tiles=TILES,
        seed_block=("eeee", "0221", "eeee"),
        rules=lambda: rules(*shape),
        simulator=fleet_simulator(TaskRule(TILES, ".e", cycle), config.fleet),
        objective=throughput,
        objective_name=THROUGHPUT,
        task_settings=("stays", "goal_odds"),
        similarity_weights=lambda layout: jnp.where(
            of_tiles(layout, _STATIONS, TILES), 1.0, 1.0 / _STATION_WEIGHT
        ),
        measures=(
            Measure("workstations", 0, 600, 100, workstations, "area"),
            environment_entropy(len(TILES)),
        ),
        # As many stations of each kind as agents stay there, so that none is a bottleneck.
        human=lambda: parse(designs.stations(*shape, config.stays), TILES),
        meanings=_MEANINGS,
        known={(101, 102): KnownSize(steps=200, timesteps=5000, agents=1800)},  # S_eval
    )


MANUFACTURING = Entry(ManufacturingConfig, manufacturing)
