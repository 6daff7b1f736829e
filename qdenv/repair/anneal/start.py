"""Where annealing starts: the rules and the input as tables, a layout projected into one piece."""

import numpy as np

from qdenv.repair.anneal.connectivity import tabulate_ring_pieces
from qdenv.repair.anneal.joining import join_pieces
from qdenv.repair.anneal.state import (
    ALWAYS,
    MAX_KINDS,
    NO_TILE,
    Board,
    Column,
    State,
    no_search,
)
from qdenv.repair.facts import Facts
from qdenv.types import InputError


def _tabulate_tiles(facts: Facts) -> np.ndarray:
    """Tabulate the facts about tiles (int64 [K + 1, columns]); the last row is the wall."""
    tiles, width = facts.rules.tiles, max(1, int(facts.demands.max()))
    table = []
    for kind in range(len(tiles)):
        bounds = sum(int(counts) << q for q, counts in enumerate(facts.counting[:, kind]))
        needs = [sum(7 << 3 * tiles.index(other) for other in need) for need in facts.needs[kind]]
        needs += [ALWAYS] * (width - len(needs))
        table.append([facts.driving[kind], 1 << 3 * kind, facts.role_of[kind], bounds, *needs])
    return np.array([*table, [0, 0, -1, 0] + [ALWAYS] * width], np.int64)


def compile_board(layout: np.ndarray, facts: Facts) -> Board:
    """Compile the rules and the input `layout` (int8 [H, W]) for the kernels.

    Raises:
        InputError: there are more kinds of tile than a tally of neighbours can tell apart.
    """
    rules, kinds, stride = facts.rules, len(facts.rules.tiles), layout.shape[1] + 2
    if kinds > MAX_KINDS:
        raise InputError(
            f"the repair knows at most {MAX_KINDS} kinds of tile, these rules have "
            f"{kinds}: merge tiles that obey the same rules"
        )
    members = [[len(role), *role] + [NO_TILE] * (kinds - len(role)) for role in facts.roles]
    allowed = np.pad((rules.allowed * (1 << np.arange(kinds))).sum(-1).astype(np.int64), 1).ravel()
    return Board(
        layout=pad_layout(layout, kinds),
        change_cost=np.pad(np.asarray(rules.change_cost, np.float64), 1).ravel(),
        allowed=allowed,
        free=np.flatnonzero(np.pad(facts.free, 1)),
        open_tile=_default_open_tiles(allowed, facts),
        tile_table=_tabulate_tiles(facts),
        role_members=np.array(members, np.int64),
        count_bounds=facts.count_bounds,
        offsets=np.array([-stride, 1 - stride, 1, stride + 1, stride, stride - 1, -1, -stride - 1]),
        ring_pieces=tabulate_ring_pieces(),
        stride=stride,
        connected=bool(rules.connected),
        aisle=rules.aisle,
    )


def pad_layout(layout: np.ndarray, wall: int) -> np.ndarray:
    """Put a ring of walls around a layout (int8 [H, W] -> int8 [N])."""
    return np.pad(layout.astype(np.int8), 1, constant_values=wall).ravel()


def unpad_layout(layout: np.ndarray, stride: int) -> np.ndarray:
    """Take the ring of walls away again (int8 [N] -> int8 [H, W])."""
    return layout.reshape(-1, stride)[1:-1, 1:-1].copy()


def _default_open_tiles(allowed: np.ndarray, facts: Facts) -> np.ndarray:
    """Choose each cell's allowed driving tile with the fewest demands, or `NO_TILE` (int8 [N])."""
    open_tile = np.full(allowed.size, NO_TILE, np.int8)
    for kind in sorted(np.flatnonzero(facts.driving), key=lambda kind: -facts.demands[kind]):
        open_tile[allowed >> kind & 1 == 1] = kind
    return open_tile


def project(board: Board, start: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Pad a layout, make every tile an allowed one and the driving area one piece (int8 [N]).

    Args:
        board: the rules and the input.
        start: int8 [H, W].
        rng: draws the cell whose piece the others are joined to.
    """
    kinds, drives = board.tile_table.shape[0] - 1, board.tile_table[:, Column.DRIVES]
    candidate = pad_layout(start, kinds)
    wall = candidate == kinds
    # Open a cell with its input tile where that drives: it costs nothing.
    layout = board.layout
    kept = (board.allowed >> layout & 1 == 1) & (drives[layout] == 1)
    opened = np.where(kept, layout, board.open_tile)
    may = board.allowed[:, None] >> np.arange(kinds) & 1
    kept = wall | (board.allowed >> candidate & 1 == 1)
    fallback = np.where(opened >= 0, opened, may.argmax(1))
    candidate = np.where(kept, candidate, fallback).astype(np.int8)
    if not board.connected or not (opened >= 0).any():
        return candidate
    may_shut = may * (1 - drives[:kinds])
    shut = np.where(may_shut.any(1), may_shut.argmax(1), NO_TILE)
    # Start at a cell that always drives, else at one that does, else at one that may.
    roots = np.flatnonzero((shut < 0) & ~wall)
    roots = roots if roots.size else np.flatnonzero(drives[candidate] == 1)
    roots = roots if roots.size else np.flatnonzero(opened >= 0)
    joined = join_pieces(candidate, drives, opened, roots[rng.integers(roots.size)], board.stride)
    cut_off = (drives[candidate] == 1) & ~joined & (shut >= 0)
    return np.where(cut_off, shut, candidate).astype(np.int8)


def _sum_squares(mask: np.ndarray, side: int) -> np.ndarray:
    """Count `mask` in the side x side square that starts at each cell; nothing lies beyond."""
    padded = np.pad(mask.astype(np.int64), ((0, side - 1), (0, side - 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (side, side))
    return windows.sum((-1, -2))


def initial_state(board: Board, candidate: np.ndarray) -> State:
    """Start a `State` at a projected layout (int8 [N])."""
    size, stride, aisle = candidate.size, board.stride, board.aisle
    rows, driving = board.tile_table[candidate], board.tile_table[candidate, Column.DRIVES]
    units = rows[:, Column.UNIT]
    tally = ALWAYS + sum(np.roll(units, step) for step in (1, -1, stride, -stride))
    counts = (rows[:, Column.BOUNDS, None] >> np.arange(len(board.count_bounds)) & 1).sum(0)
    low, high = board.count_bounds.T
    broken = ((tally[:, None] & rows[:, Column.NEEDS :]) == 0).sum()
    broken += np.maximum(low - counts, counts - high).clip(0).sum()
    closed = aisle**2 - _sum_squares(driving.reshape(-1, stride), aisle)
    # Squares that reach back over a cell: the same sum on the grid turned round.
    cover = _sum_squares((closed == 0)[::-1, ::-1], aisle)[::-1, ::-1].ravel()
    broken += ((driving == 1) & (cover == 0)).sum()
    differs = candidate != board.layout
    changed, place = np.zeros(1 + size, np.int64), np.zeros(size, np.int64)
    changed[: 1 + differs.sum()] = [differs.sum(), *np.flatnonzero(differs)]
    place[differs] = 1 + np.arange(differs.sum())
    return State(
        candidate=candidate.copy(),
        driving=driving.astype(np.int8),
        tally=tally,
        counts=counts.astype(np.int64),
        closed=closed.ravel(),
        cover=cover.copy(),
        changed=changed,
        place=place,
        best=np.zeros(size, np.int8),
        search=no_search(size),
        cost=float((board.change_cost * differs).sum()),
        broken=int(broken),
    )
