"""The warehouse: shelves, endpoints beside them, workstations along the left and right border.

Even: every workstation is drawn alike. Uneven: those on the left border five times likelier
(appendix B.1).
"""

import jax.numpy as jnp
import numpy as np

from qdenv.domains import designs
from qdenv.domains.base import Domain
from qdenv.domains.fleet import fleet_simulator
from qdenv.generate.decode import inside_frame, put_in_frame
from qdenv.grid import parse
from qdenv.score import layout as score
from qdenv.score.traffic import mean_throughput
from qdenv.simulate.mapf.tasks import favour_left, tile_goal
from qdenv.types import Adjacency, Array, Count, InputError, Measure, Rules, TaskRule

TILES = ".@ew"
GENERATED = ".@e"
MARGIN = (0, 2)
STATION_SPACING = 3  # a workstation in rows 1, 4, 7, ..., never in the last row


def border(rows: int, cols: int) -> np.ndarray:
    """Draw the fixed frame around empty tiles (int8 [H, W]): workstations in the outer columns.

    Raises:
        InputError: there is no room for a workstation or for anything between the borders.
    """
    if rows < 3 or cols <= 2 * MARGIN[1]:
        raise InputError(
            f"a warehouse of {rows} x {cols} is too small: it needs at least 3 rows and 5 columns"
        )
    picture = np.zeros((rows, cols), np.int8)
    picture[1 : rows - 1 : STATION_SPACING, [0, -1]] = TILES.index("w")
    return picture


def frame(tiles: Array) -> Array:
    """Add two fixed columns on each side: workstations outside, a free lane inside."""
    rows, cols = tiles.shape
    return put_in_frame(tiles, border(rows, cols + 2 * MARGIN[1]), MARGIN)


def design(rows: int, cols: int) -> np.ndarray:
    """Draw the hand-made warehouse of `rows` x `cols`, frame included (int8 [rows, cols])."""
    picture = border(rows, cols)
    inside_frame(picture, MARGIN)[:] = parse(
        designs.shelf_blocks(rows, cols - 2 * MARGIN[1]), TILES
    )
    return picture


def rules(rows: int, cols: int, shelves: int) -> Rules:
    """State the constraints of appendix B.1: connected, served, exactly `shelves`, fixed border."""
    allowed = np.zeros((rows, cols, len(TILES)), bool)
    allowed[..., [TILES.index(symbol) for symbol in GENERATED]] = True
    outside = np.ones((rows, cols), bool)
    inside_frame(outside, MARGIN)[:] = False
    allowed[outside] = np.eye(len(TILES), dtype=bool)[border(rows, cols)[outside]]
    return Rules(
        tiles=TILES,
        counts=(Count("@", shelves, shelves),),
        adjacency=(Adjacency("@", "e"), Adjacency("e", "@")),
        connected=".ew",
        allowed=allowed,
        change_cost=np.ones((rows, cols), np.float32),
    )


def warehouse(name: str, left: float) -> Domain:
    """Make a warehouse whose left workstations are `left` times likelier than the others."""
    cycle = (tile_goal("e", TILES), favour_left(tile_goal("w", TILES), left))
    tasks = TaskRule(TILES, ".ew", cycle)
    return Domain(
        name=name,
        tiles=TILES,
        generated=GENERATED,
        seed_block=("ee", "@@", "ee"),
        margin=MARGIN,
        frame=frame,
        rules=rules,
        simulator=fleet_simulator(tasks),
        objective=lambda layout, runs: mean_throughput(runs),
        price=lambda layout: jnp.ones(layout.shape, jnp.float32),
        measures=(
            Measure(
                "connected shelf components",
                140,
                240,
                100,
                lambda layout, runs: score.components(layout, "@", TILES),
            ),
            Measure(
                "environment entropy",
                0,
                1,
                100,
                lambda layout, runs: score.entropy(inside_frame(layout, MARGIN), len(GENERATED)),
            ),
        ),
        design=design,
        tasks=tasks,
    )


WAREHOUSE_EVEN = warehouse("warehouse-even", 1.0)
WAREHOUSE_UNEVEN = warehouse("warehouse-uneven", 5.0)
