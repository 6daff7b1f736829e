"""What an agent must avoid: where others are at each timestep, and which way they leave."""

from typing import NamedTuple

import numpy as np

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.site import DOWN, LEFT, RIGHT, UP

MOVE_BITS = 5  # somebody is here, and leaves right, left, down, up: one bit each
HERE = 1
LAST_STAMP = (1 << (31 - MOVE_BITS)) - 1


class Reservations(NamedTuple):
    """Reserved cells of one search; w timesteps, N cells."""

    # int32 [w + 1, N], the bits of a cell and above them the stamp of the search that they belong
    # to: bits of other searches do not count
    entry: np.ndarray
    number: np.ndarray  # int64 [1], the stamp


def make_reservations(window: int, cells: int) -> Reservations:
    """Make room for reservations."""
    return Reservations(np.zeros((window + 1, cells), np.int32), np.zeros(1, np.int64))


@kernel
def forget_reservations(table: Reservations) -> None:
    """Begin with no reservations."""
    if table.number[0] >= LAST_STAMP:
        table.entry[:] = 0
        table.number[0] = 0
    table.number[0] += 1


@formula
def reserve(table: Reservations, t: int, cell: int, bits: int) -> None:
    """Reserve a cell at a timestep."""
    old, stamp = table.entry[t, cell], table.number[0]
    table.entry[t, cell] = old | bits if old >> MOVE_BITS == stamp else (stamp << MOVE_BITS) | bits


@formula
def bits_at(table: Reservations, t: int, cell: int) -> int:
    """Read the bits of a cell at a timestep."""
    entry = table.entry[t, cell]
    return entry & ((1 << MOVE_BITS) - 1) if entry >> MOVE_BITS == table.number[0] else 0


@formula
def leaving(step: int, width: int) -> int:
    """Say as a bit which way a step leads; 0 for waiting."""
    return (
        ((step == 1) << RIGHT)
        | ((step == -1) << LEFT)
        | ((step == width) << DOWN)
        | ((step == -width) << UP)
    )


@formula
def opposite(move: int) -> int:
    """Find the move that leads back."""
    return 1 + ((move - 1) ^ 1)
