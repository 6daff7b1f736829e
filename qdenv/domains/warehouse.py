"""The warehouse: shelves, endpoints beside them, workstations along the left and right border.

Even: every workstation is drawn alike. Uneven: those on the left border five times likelier
(appendix B.1).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from qdenv.domains import designs
from qdenv.domains.base import Domain, KnownSize, environment_entropy
from qdenv.domains.hall import GENERATED, BuiltConfig, Odds, storage
from qdenv.grid import inside_frame, parse
from qdenv.lazy import jax, jnp
from qdenv.ranges import NonNegativeInt
from qdenv.registry import Entry
from qdenv.simulation.mapf.goals import tile_goal
from qdenv.simulation.mapf.settings import FleetConfig
from qdenv.types import Array, InputError, Rules, Tile

_TILES = ".@ew"
_MEANINGS = {
    ".": Tile("floor", "robots drive here"),
    "@": Tile("shelf", "holds goods; needs an endpoint beside it", True, also="#"),
    "e": Tile("endpoint", "robots pick goods here; needs a shelf beside it"),
    "w": Tile("workstation", "robots deliver here; by itself in the outer columns only"),
}
_MARGIN = (0, 2)
_STATION_SPACING = 3  # a workstation in rows 1, 4, 7, ..., never in the last row


def _border(rows: int, cols: int) -> np.ndarray:
    """Draw the fixed frame around empty tiles (int8 [H, W]): workstations in the outer columns."""
    if rows < 3 or cols <= 2 * _MARGIN[1]:
        raise InputError(f"a warehouse of {rows} x {cols} is too small: give 3 rows and 5 columns")
    picture = np.zeros((rows, cols), np.int8)
    picture[1 : rows - 1 : _STATION_SPACING, [0, -1]] = _TILES.index("w")
    return picture


def frame(tiles: Array) -> jax.Array:
    """Add two fixed columns on each side: workstations outside, a free lane inside."""
    rows, cols = tiles.shape
    border = jnp.asarray(_border(rows, cols + 2 * _MARGIN[1]))
    return jax.lax.dynamic_update_slice(border, tiles.astype(jnp.int8), _MARGIN)


@dataclass(frozen=True)
class WarehouseConfig(BuiltConfig):
    """Settings of a warehouse whose workstations are all drawn alike."""

    # agents, horizon and planner
    fleet: FleetConfig = field(default_factory=FleetConfig)  # type: ignore[misc]
    shelves: NonNegativeInt = 240  # exact number of shelves, N_s in the paper
    # how much likelier a workstation on the left border is than one on the right
    left_odds: Odds = 1.0


@dataclass(frozen=True)
class UnevenWarehouseConfig(WarehouseConfig):
    """Settings of a warehouse whose left workstations are likelier (appendix B.1)."""

    # how much likelier a workstation on the left border is than one on the right
    left_odds: Odds = 5.0


def warehouse(config: WarehouseConfig) -> Domain:
    """Make a warehouse of one size: a hall whose stations and free lanes follow from its size."""
    stations, shape = tile_goal("w", _TILES), (config.rows, config.cols)

    def weight(layout: Array) -> Array:
        left = np.arange(layout.shape[1])[None] == 0
        odds = np.where(left, np.float32(config.left_odds), np.float32(1))
        return odds * stations.weight(layout)

    plain = storage(config, _TILES, tile_goal("e", _TILES), stations._replace(weight=weight))
    # S_eval of the paper (Table 1, and the numbers of agents that its throughputs were taken with).
    agents = 1000 if isinstance(config, UnevenWarehouseConfig) else 1400
    known = KnownSize(steps=200, timesteps=5000, agents=agents, numbers={"shelves": 2500})

    def rules() -> Rules:
        base: Rules = plain.rules()  # type: ignore[misc]
        outside = np.ones(shape, bool)
        inside_frame(outside, _MARGIN)[:] = False
        base.allowed[outside] = np.eye(len(_TILES), dtype=bool)[_border(*shape)[outside]]
        return base

    def human() -> np.ndarray:
        layout = _border(*shape)
        inside = inside_frame(layout, _MARGIN)
        inside[:] = parse(designs.shelf_blocks(*inside.shape), _TILES)
        return layout

    return replace(
        plain,
        margin=_MARGIN,
        frame=frame,
        rules=rules,
        measures=(
            plain.measures[0]._replace(low=140, high=240),
            environment_entropy(len(GENERATED), _MARGIN),
        ),
        human=human,
        meanings=_MEANINGS,
        known={(101, 102): known},
    )


EVEN = Entry(WarehouseConfig, warehouse)
UNEVEN = Entry(UnevenWarehouseConfig, warehouse)
