"""Map: a floor as it is, like those of the MovingAI benchmarks; every free cell may be a goal."""

from __future__ import annotations

from dataclasses import dataclass, field

from qdenv import score
from qdenv.domains.base import Domain, DomainConfig, environment_entropy
from qdenv.domains.fleet import THROUGHPUT, fleet_simulator, throughput
from qdenv.generators import Rows
from qdenv.lazy import jax
from qdenv.ranges import TaskRate
from qdenv.registry import Entry
from qdenv.simulation.mapf.goals import tile_goal, weigh
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.types import Measure, TaskRule, Tile, Traffic

_TILES = ".#"
_MEANINGS = {
    # Maps of the League of Robot Runners, and of warehouses, have stations and endpoints, too.
    ".": Tile("free", "robots drive here, and any such cell may be a goal", also="ewio"),
    "#": Tile("obstacle", "robots go around it", True, also="@"),
}


@dataclass(frozen=True)
class MapConfig(DomainConfig):
    """Settings of a map."""

    fleet: FleetConfig = field(default_factory=FleetConfig)  # type: ignore[misc]
    # tasks that arrive per timestep; they never run out where it is 0
    task_rate: TaskRate = 0.0
    # rows of numbers, one a cell: how likely it is drawn as a goal; empty where all are alike
    demand: Rows = ()


def make_map(config: MapConfig) -> Domain:
    """Make a map of one size, which nothing repairs."""

    def free(layout: jax.Array, runs: Traffic) -> jax.Array:
        return score.count(layout, ".", _TILES)

    # Robots go from one goal to the next, as in the League of Robot Runners.
    goal, area = tile_goal(".", _TILES)._replace(name="free cell"), config.rows * config.cols
    cycle = (weigh(goal, config.demand, (config.rows, config.cols)),)
    return Domain(
        tiles=_TILES,
        generated=_TILES,
        seed_block=(".",),
        rules=None,
        simulator=fleet_simulator(TaskRule(_TILES, ".", cycle, config.task_rate), config.fleet),
        objective=throughput,
        measures=(
            Measure("free cells", 0, area, min(area, 100), free, "area"),
            environment_entropy(len(_TILES)),
        ),
        objective_name=THROUGHPUT,
        meanings=_MEANINGS,
        task_settings=("task_rate", "demand"),
        config=config,
    )


MAP = Entry(MapConfig, make_map)
