"""What the annealer's kernels read and write: the rules as tables, a layout under way."""

from typing import NamedTuple

import numpy as np

from qdenv.repair.kernels import ALWAYS
from qdenv.repair.moves import DRIVES, FAMILY, NEEDS, WORD
from qdenv.repair.topology import join, ring_parts
from qdenv.types import InputError, Rules

MOST_KINDS = 20  # three bits each in one 64-bit tally


class Board(NamedTuple):
    """The rules and the input of one repair; `kernels` explains the arrays."""

    home: np.ndarray
    price: np.ndarray
    allowed: np.ndarray
    free: np.ndarray
    calm: np.ndarray
    kinds: np.ndarray
    cast: np.ndarray
    limits: np.ndarray
    walk: np.ndarray
    parts: np.ndarray
    linked: bool
    aisle: int


class State(NamedTuple):
    """One layout under way, with everything its energy needs; `kernels` explains the arrays."""

    tile: np.ndarray
    drive: np.ndarray
    near: np.ndarray
    counts: np.ndarray
    blocked: np.ndarray
    cover: np.ndarray
    mark: np.ndarray
    queue: np.ndarray
    sides: np.ndarray
    move: np.ndarray
    changed: np.ndarray
    place: np.ndarray
    best: np.ndarray
    cost: float
    broken: int


def group_roles(rules: Rules) -> list[list[int]]:
    """Group tiles that no adjacency, connectivity or placement rule tells apart.

    Tiles of one role differ in counts and in price only: three kinds of station are one role.
    """
    free = rules.allowed.sum(-1) > 1
    groups: dict[tuple, list[int]] = {}
    for kind, tile in enumerate(rules.tiles):
        near = tuple((tile in rule.tiles, tile in rule.needs) for rule in rules.adjacency)
        places = rules.allowed[..., kind][free].tobytes()
        groups.setdefault((tile in rules.connected, near, places), []).append(kind)
    return list(groups.values())


def _tabulate_kinds(rules: Rules, roles: list[list[int]]) -> np.ndarray:
    """Tabulate the facts about tiles (int64 [K + 1, columns]); the last row is the wall."""
    tiles, demands = rules.tiles, [[] for _ in rules.tiles]
    for rule in rules.adjacency:
        tally = sum(7 << 3 * tiles.index(tile) for tile in rule.needs)
        for tile in rule.tiles:
            demands[tiles.index(tile)].append(tally)
    width = max([1, *map(len, demands)])
    table = []
    for kind, tile in enumerate(tiles):
        role = next(index for index, members in enumerate(roles) if kind in members)
        family = sum((tile in bound.tiles) << place for place, bound in enumerate(rules.counts))
        needs = demands[kind] + [ALWAYS] * (width - len(demands[kind]))
        table.append([tile in rules.connected, 1 << 3 * kind, role, family, *needs])
    return np.array([*table, [0, 0, -1, 0] + [ALWAYS] * width], np.int64)


def compile_board(layout: np.ndarray, rules: Rules) -> Board:
    """Compile `rules` and the input `layout` (int8 [H, W]) for the kernels.

    Raises:
        InputError: there are more kinds of tile than a tally of neighbours can tell apart.
    """
    if len(rules.tiles) > MOST_KINDS:
        raise InputError(
            f"the repair knows at most {MOST_KINDS} kinds of tile, these rules have "
            f"{len(rules.tiles)}: merge tiles that obey the same rules"
        )
    kinds, stride, roles = len(rules.tiles), layout.shape[1] + 2, group_roles(rules)
    cast = [[len(members), *members] + [-1] * (kinds - len(members)) for members in roles]
    highs = [layout.size if bound.high is None else bound.high for bound in rules.counts]
    bits = (rules.allowed * (1 << np.arange(kinds))).sum(-1).astype(np.int64)
    table, allowed = _tabulate_kinds(rules, roles), np.pad(bits, 1).ravel()
    return Board(
        home=np.pad(layout.astype(np.int8), 1, constant_values=kinds).ravel(),
        price=np.pad(np.asarray(rules.change_cost, np.float64), 1).ravel(),
        allowed=allowed,
        free=np.flatnonzero(np.pad(rules.allowed.sum(-1) > 1, 1)),
        calm=_calm_tiles(allowed, table),
        kinds=table,
        cast=np.array(cast, np.int64),
        limits=np.array(
            [(bound.low, high) for bound, high in zip(rules.counts, highs, strict=True)], np.int64
        ).reshape(-1, 2),
        walk=np.array([-stride, 1 - stride, 1, stride + 1, stride, stride - 1, -1, -stride - 1]),
        parts=ring_parts(),
        linked=bool(rules.connected),
        aisle=rules.aisle,
    )


def _calm_tiles(allowed: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """Choose each cell's allowed driving tile with the fewest demands, or -1 (int8 [N])."""
    choice = np.full(allowed.size, -1, np.int8)
    demands = (kinds[:, NEEDS:] != ALWAYS).sum(1)
    for kind in sorted(np.flatnonzero(kinds[:, DRIVES]), key=lambda kind: -demands[kind]):
        choice[allowed >> kind & 1 == 1] = kind
    return choice


def settle(board: Board, layout: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Pad `layout`, make every tile an allowed one and the driving area one piece (int8 [N])."""
    kinds, drives = board.kinds.shape[0] - 1, board.kinds[:, DRIVES]
    tile = np.pad(layout.astype(np.int8), 1, constant_values=kinds).ravel()
    wall, may = tile == kinds, board.allowed >> board.home & 1 == 1
    opened = np.where(may & (drives[board.home] == 1), board.home, board.calm)
    every = board.allowed[:, None] >> np.arange(kinds) & 1
    kept = wall | (board.allowed >> tile & 1 == 1)
    tile = np.where(kept, tile, np.where(opened >= 0, opened, every.argmax(1))).astype(np.int8)
    if not board.linked or not (opened >= 0).any():
        return tile
    shut = np.where(
        (every & (drives[:kinds] == 0)).any(1), (every * (1 - drives[:kinds])).argmax(1), -1
    )
    roots = np.flatnonzero((shut < 0) & ~wall)
    roots = roots if roots.size else np.flatnonzero(drives[tile] == 1)
    roots = roots if roots.size else np.flatnonzero(opened >= 0)
    joined = join(tile, drives, opened, roots[rng.integers(roots.size)], board.walk[4])
    return np.where((drives[tile] == 1) & ~joined & (shut >= 0), shut, tile).astype(np.int8)


def _squares(mask: np.ndarray, width: int) -> np.ndarray:
    """Count `mask` in the width x width square that starts at each cell; nothing lies beyond."""
    padded = np.pad(mask.astype(np.int64), ((0, width - 1), (0, width - 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, (width, width))
    return windows.sum((-1, -2))


def begin(board: Board, tile: np.ndarray) -> State:
    """Start a `State` at `tile` (int8 [N], settled)."""
    size, stride, shape = tile.size, board.walk[4], (-1, board.walk[4])
    facts, drive = board.kinds[tile], board.kinds[tile, DRIVES].astype(np.int8)
    near = ALWAYS + sum(np.roll(facts[:, WORD], step) for step in (1, -1, stride, -stride))
    families = facts[:, FAMILY, None] >> np.arange(len(board.limits)) & 1
    counts = families.sum(0)
    broken = ((near[:, None] & facts[:, NEEDS:]) == 0).sum()
    broken += np.maximum(board.limits[:, 0] - counts, counts - board.limits[:, 1]).clip(0).sum()
    blocked = board.aisle**2 - _squares(drive.reshape(shape), board.aisle)
    cover = _squares((blocked == 0)[::-1, ::-1], board.aisle)[::-1, ::-1].ravel()
    broken += ((drive == 1) & (cover == 0)).sum()
    differs = np.flatnonzero(tile != board.home)
    changed, place = np.zeros(1 + size, np.int64), np.zeros(size, np.int64)
    changed[: 1 + differs.size] = [differs.size, *differs]
    place[differs] = 1 + np.arange(differs.size)
    return State(
        tile=tile.copy(),
        drive=drive,
        near=near,
        counts=counts.astype(np.int64),
        blocked=blocked.ravel(),
        cover=cover.copy(),
        mark=np.zeros(size + 1, np.int64),
        queue=np.zeros((4, size), np.int64),
        sides=np.zeros((3, 4), np.int64),
        move=np.zeros((5, 3), np.int64),
        changed=changed,
        place=place,
        best=np.zeros(size, np.int8),
        cost=float((board.price * (tile != board.home)).sum()),
        broken=int(broken),
    )
