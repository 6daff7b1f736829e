"""Manufacturing: agents visit three kinds of station in turn and stay at each (appendix B.2)."""

import jax.numpy as jnp
import numpy as np

from qdenv.domains import designs
from qdenv.domains.base import Domain
from qdenv.domains.fleet import fleet_simulator
from qdenv.grid import of_tiles, parse
from qdenv.score import layout as score
from qdenv.score.traffic import mean_throughput
from qdenv.simulate.mapf.tasks import beside_goal
from qdenv.types import Adjacency, Array, Count, Measure, Rules, TaskRule

TILES = ".012e"
STATIONS = "012"
STAYS = {"0": 2, "1": 5, "2": 10}  # timesteps served beside each kind of station
STATION_PRICE = 5.0  # p_i of a generated station in the similarity (appendix C.2.1)


def rules(rows: int, cols: int, shelves: int = 0) -> Rules:
    """State the constraints of appendix B.2; `shelves` has no meaning here."""
    del shelves
    return Rules(
        tiles=TILES,
        counts=tuple(Count(station, 1) for station in STATIONS),
        adjacency=(Adjacency(STATIONS, "e"), Adjacency("e", STATIONS)),
        connected=".e",
        allowed=np.ones((rows, cols, len(TILES)), bool),
        change_cost=np.ones((rows, cols), np.float32),
    )


def price(layout: Array) -> Array:
    """Weigh a generated station five times: p_i / max p (float32 [H, W])."""
    return jnp.where(of_tiles(layout, STATIONS, TILES), 1.0, 1.0 / STATION_PRICE)


TASKS = TaskRule(
    TILES, ".e", tuple(beside_goal("e", kind, stay, TILES) for kind, stay in STAYS.items())
)

MANUFACTURING = Domain(
    name="manufacturing",
    tiles=TILES,
    generated=TILES,
    seed_block=("eeee", "0221", "eeee"),
    margin=(0, 0),
    frame=lambda tiles: tiles,
    rules=rules,
    simulator=fleet_simulator(TASKS),
    objective=lambda layout, runs: mean_throughput(runs),
    price=price,
    measures=(
        Measure(
            "workstations", 0, 600, 100, lambda layout, runs: score.count(layout, STATIONS, TILES)
        ),
        Measure(
            "environment entropy", 0, 1, 100, lambda layout, runs: score.entropy(layout, len(TILES))
        ),
    ),
    # As many stations of each kind as agents stay there, so that none is a bottleneck.
    design=lambda rows, cols: parse(designs.stations(rows, cols, tuple(STAYS.values())), TILES),
    tasks=TASKS,
)
