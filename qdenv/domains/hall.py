"""A hall: shelves, endpoints beside them, stations and walls where a plan has them.

Generators draw floor, shelves and endpoints; walls and stations stay where they are. The paper's
warehouse is this domain with a formula that says where its stations are (`warehouse`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from annotated_types import Interval

from qdenv import score
from qdenv.domains.base import Domain, DomainConfig
from qdenv.domains.fleet import THROUGHPUT, fleet_simulator, throughput
from qdenv.generators import Rows
from qdenv.lazy import jax
from qdenv.ranges import NonNegativeFloat, NonNegativeInt, PositiveInt, Stay, TaskRate, check_range
from qdenv.registry import Entry
from qdenv.simulation.mapf.goals import BY_SHELF, share_shelves, station_goal, tile_goal, weigh
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.types import Adjacency, Count, Goal, InputError, Measure, Rules, TaskRule, Tile, Traffic

# How much likelier one goal is than another: sums of 32 bits hold no others.
Odds = Annotated[float, Interval(ge=1e-6, le=1e6)]
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


@dataclass(frozen=True, kw_only=True)
class BuiltConfig(DomainConfig):
    """What a hall that is to be built demands beside its numbers of tiles."""

    aisle: PositiveInt = 1  # least width of aisles in cells
    # rows and columns of the smallest rack, as 2x6, along either axis; by default any shape
    rack: str = ""
    # most successive rows, or columns, that hold shelves, before a straight aisle must come; 0 for
    # any number
    cross_aisle: NonNegativeInt = 0
    # whether each rack has an aisle on both sides: every shelf lies in a straight run of one or two
    # shelves with floor at both ends
    both_sides: bool = False


@dataclass(frozen=True)
class HallConfig(BuiltConfig):
    """Settings of a hall."""

    # agents, horizon and planner
    fleet: FleetConfig = field(default_factory=FleetConfig)  # type: ignore[misc]
    # number of shelves, at least; for a plan also a range like 1000:1200
    shelves: NonNegativeInt = 240
    spare_shelves: NonNegativeInt = 0  # how many more there may be; by default none
    pick: Stay = 0  # timesteps that a robot stays at an endpoint
    drop: str = "0"  # timesteps at a station: 5 for all, or by symbol, as w=5,i=20
    # shares of the tasks by the symbol of stations, as i=1,o=3; by default all stations are alike
    shares: str = ""
    # tasks that arrive per timestep, two to an order; with 0 they never run out
    task_rate: TaskRate = 0.0
    # No option of its own: a file or zones become this map.
    # rows of numbers, one a cell: how likely an endpoint there is drawn as a goal. They belong to
    # places: shelves may move, demand does not. Or "shelves": all of these are alike, however many
    # endpoints serve one. Empty where all endpoints are alike
    demand: Rows = ()

    def __post_init__(self) -> None:
        """Raise InputError if times or shares are of unknown stations, or out of range."""
        super().__post_init__()
        for time in _by_station(self.drop, "drop").values():
            check_range("drop", int(time) if time.is_integer() else time, Stay)
        shares = [share for share in _by_station(self.shares, "shares").values() if share]
        if self.shares and not shares:
            raise InputError("shares must be above 0 for one kind of station or more")
        check_range("shares", tuple(shares), tuple[Odds, ...])


def _by_station(text: str, name: str) -> dict[str, float]:
    """Read numbers by the signs of stations: 5 for all, or i=20,o=5; the others have none."""
    if not text:
        return {}
    pairs = [part.partition("=") for part in text.split(",")] if "=" in text else []
    pairs = pairs or [(sign, "=", text) for sign in _STATIONS]
    try:
        numbers = {sign.strip(): float(number) for sign, _, number in pairs}
    except ValueError:
        numbers = {}
    if len(numbers) < len(pairs) or not {*numbers} <= {*_STATIONS}:
        signs = " ".join(_STATIONS)
        raise InputError(f"{name} {text!r}: write one number, or i=20,o=5, of the stations {signs}")
    for number in numbers.values():
        check_range(name, number, NonNegativeFloat)
    return numbers


def storage(config: Any, tiles: str, endpoints: Goal, stations: Goal, rate: float = 0.0) -> Domain:
    """Make the domain of shelves, and `endpoints` that robots carry goods from, to `stations`.

    Its alphabet `tiles` begins with `GENERATED`; of the other tiles robots drive on all but walls,
    and none has a place of its own. `config` is a `BuiltConfig` with `fleet` and `shelves`; `rate`
    as in `TaskRule`.
    """
    drivable = "".join(tile for tile in tiles if tile not in _OBSTACLES)
    shape, kinds = (config.rows, config.cols), len(GENERATED)
    sides = re.fullmatch(r"([1-9]\d{0,2})x([1-9]\d{0,2})", str(config.rack))
    if config.rack and not sides:
        raise InputError(f"rack {config.rack!r}: give rows and columns like 2x6")
    rack = (int(sides[1]), int(sides[2])) if sides else None

    def rules() -> Rules:
        plain = Rules(
            tiles=tiles,
            counts=(Count("@", config.shelves, config.shelves),),
            adjacency=(Adjacency("@", "e"), Adjacency("e", "@")),
            connected=drivable,
            allowed=np.tile(np.arange(len(tiles)) < kinds, (*shape, 1)),
            change_cost=np.ones(shape, np.float32),
        )
        return plain.buildable(config.aisle, rack, "@", config.cross_aisle, config.both_sides)

    def components(layout: jax.Array, runs: Traffic) -> jax.Array:
        return score.components(layout, "@", tiles)

    def entropy(layout: jax.Array, runs: Traffic) -> jax.Array:
        # Of the area that is drawn: patterns with walls and stations are no design.
        return score.entropy(layout, kinds, partial=True)

    cycle = (endpoints._replace(name="endpoint"), stations._replace(name="workstation"))
    return Domain(
        config=config,
        tiles=tiles,
        generated=GENERATED,
        seed_block=("ee", "@@", "ee"),
        rules=rules,
        simulator=fleet_simulator(TaskRule(tiles, drivable, cycle, rate), config.fleet),
        objective=throughput,
        objective_name=THROUGHPUT,
        measures=(
            Measure("connected shelf components", 0, config.shelves, 100, components, "shelves"),
            Measure("environment entropy", 0, 1, 100, entropy),
        ),
        counted={"shelves": "@"},
        rule_settings=tuple(BuiltConfig.__annotations__),
    )


def hall(config: HallConfig) -> Domain:
    """Make a hall of one size, whose walls and stations are those of `config.keep`."""
    shape = config.rows, config.cols
    endpoints = tile_goal("e", _TILES, config.pick)
    if config.demand == BY_SHELF:
        endpoints = share_shelves(endpoints, "@", _TILES)
    else:
        endpoints = weigh(endpoints, config.demand, shape)
    times = {sign: int(time) for sign, time in _by_station(config.drop, "drop").items()}
    stations = station_goal(_STATIONS, _TILES, times, _by_station(config.shares, "shares"))
    domain = storage(config, _TILES, endpoints, stations, config.task_rate)

    def rules() -> Rules:
        base = domain.rules()  # type: ignore[misc]
        most = config.shelves + config.spare_shelves
        return base._replace(counts=(Count("@", config.shelves, most), Count(_STATIONS, 1)))

    return replace(
        domain,
        rules=rules,
        stays=_TILES[len(GENERATED) :],
        meanings=_MEANINGS,
        task_settings=("pick", "drop", "shares", "task_rate", "demand"),
    )


HALL = Entry(HallConfig, hall)
