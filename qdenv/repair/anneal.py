"""Fast feasible start: simulated annealing in which the driving area never falls apart.

Compiled with numba and free of the GIL. Cells live on a grid padded by one ring of walls, so that
no neighbour test needs a border case. All kernels stay in this file: numba's disk cache watches
only the file of the function it caches.
"""

from typing import NamedTuple

import numba
import numpy as np

from qdenv.types import Rules

BUDGET = 20000  # cells a connectivity search may visit before the move is refused
_U7, _U11, _U13, _U17, _U32 = (np.uint64(bits) for bits in (7, 11, 13, 17, 32))


def _compile(function):
    """Compile with a disk cache where there is a writable place for one."""
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # numba finds no writable cache folder
        return numba.njit(nogil=True)(function)


class Board(NamedTuple):
    """The rules and the input, compiled for the kernels; tile K is the wall around the grid."""

    stride: int
    ring: np.ndarray  # int64 [8], steps to the eight neighbours, clockwise from the top
    parts: np.ndarray  # int64 [256], pieces the open 4-neighbours of a ring pattern form
    free: np.ndarray  # int64 [F], cells that may change
    home: np.ndarray  # int64 [N], the input
    price: np.ndarray  # float64 [N]
    allowed: np.ndarray  # int64 [N], bit k: tile k may stand here
    driving: np.ndarray  # int64 [K+1], 1 for tiles of the connected group
    word: np.ndarray  # int64 [K+1], what a tile adds to its neighbours' tally (3 bits per tile)
    needs: np.ndarray  # int64 [K+1, R], tallies of which one must be present
    needed: np.ndarray  # int64 [K+1], how many of `needs` count
    member: np.ndarray  # int64 [K+1, Q], 1 where a tile counts in bound q
    low: np.ndarray  # int64 [Q]
    high: np.ndarray  # int64 [Q]
    role: np.ndarray  # int64 [K+1], tiles of one role are alike for adjacency and driving
    cast: np.ndarray  # int64 [roles, K], the tiles of each role
    size: np.ndarray  # int64 [roles]
    linked: int  # 1 where the driving area must be connected
    aisle: int


class State(NamedTuple):
    """One layout under way, with everything its energy needs."""

    tile: np.ndarray  # int64 [N]
    drive: np.ndarray  # int64 [N], driving[tile]
    near: np.ndarray  # int64 [N], tally of the 4-neighbours
    counts: np.ndarray  # int64 [Q]
    cost: np.ndarray  # float64 [1], price of all changed cells
    broken: np.ndarray  # int64 [1], broken demands
    blocked: np.ndarray  # int64 [N], closed cells in the aisle square that starts here
    cover: np.ndarray  # int64 [N], open aisle squares over the cell
    mark: np.ndarray  # int64 [N + 1], search stamps; the last entry is the clock
    queue: np.ndarray  # int64 [4, N]
    move: np.ndarray  # int64 [3, 3], proposed (cell, new tile, old tile)


def ring_parts() -> np.ndarray:
    """Count, for each 3x3 ring pattern, the pieces its open 4-neighbours form (int64 [256]).

    Bit b is ring place b, clockwise from the top; even places are 4-neighbours. Two neighbouring
    even places hang together when the corner between them is open. One piece: a simple point.
    """
    bits = np.array([[pattern >> place & 1 for place in range(8)] for pattern in range(256)])
    joined = [bits[:, p] & bits[:, p + 1] & bits[:, (p + 2) % 8] for p in (0, 2, 4, 6)]
    return np.where(bits.all(1), 1, bits[:, ::2].sum(1) - sum(joined)).astype(np.int64)


def _roles(rules: Rules) -> list[list[int]]:
    """Group tiles that no adjacency and no connectivity demand tells apart."""
    groups: dict[tuple, list[int]] = {}
    for kind, tile in enumerate(rules.tiles):
        signature = tuple((tile in rule.tiles, tile in rule.needs) for rule in rules.adjacency)
        groups.setdefault((tile in rules.connected, *signature), []).append(kind)
    return list(groups.values())


def compile_board(layout: np.ndarray, rules: Rules) -> Board:
    """Compile `rules` and the input `layout` (int8 [H, W]) for the kernels."""
    tiles, stride = rules.tiles, layout.shape[1] + 2
    kinds = len(tiles)
    roles = _roles(rules)
    role, cast = np.full(kinds + 1, -1), np.full((len(roles), kinds), -1)
    for index, members in enumerate(roles):
        role[members], cast[index, : len(members)] = index, members
    word = np.array([1 << 3 * kind for kind in range(kinds)] + [0], np.int64)
    demands = [[rule for rule in rules.adjacency if tile in rule.tiles] for tile in tiles]
    needs = np.zeros((kinds + 1, max([1, *map(len, demands)])), np.int64)
    for kind, own in enumerate(demands):
        for place, rule in enumerate(own):
            needs[kind, place] = sum(7 * int(word[tiles.index(tile)]) for tile in rule.needs)
    member = [[int(tile in bound.tiles) for bound in rules.counts] for tile in tiles]
    bits = (rules.allowed * (1 << np.arange(kinds))).sum(-1).astype(np.int64)
    pad = {"pad_width": 1, "constant_values": 0}
    free = np.pad(rules.allowed.sum(-1) > 1, **pad)
    return Board(
        stride=stride,
        ring=np.array([-stride, 1 - stride, 1, stride + 1, stride, stride - 1, -1, -stride - 1]),
        parts=ring_parts(),
        free=np.flatnonzero(free),
        home=np.pad(layout.astype(np.int64), 1, constant_values=kinds).ravel(),
        price=np.pad(rules.weights.astype(np.float64), **pad).ravel(),
        allowed=np.pad(bits, **pad).ravel(),
        driving=np.array([tile in rules.connected for tile in tiles] + [False], np.int64),
        word=word,
        needs=needs,
        needed=np.array([*map(len, demands), 0]),
        member=np.array([*member, [0] * len(rules.counts)], np.int64).reshape(kinds + 1, -1),
        low=np.array([bound.low for bound in rules.counts], np.int64),
        high=np.array(
            [layout.size if bound.high is None else bound.high for bound in rules.counts], np.int64
        ),
        role=role,
        cast=cast,
        size=np.array([len(members) for members in roles]),
        linked=int(bool(rules.connected)),
        aisle=rules.aisle,
    )


@_compile
def _draw(rng, bound):
    """Draw from 0 .. bound - 1 (xorshift, high bits)."""
    x = rng[0]
    x ^= x << _U13
    x ^= x >> _U7
    x ^= x << _U17
    rng[0] = x
    return np.int64(((x >> _U32) * np.uint64(bound)) >> _U32)


@_compile
def _lacks(board, state, cell):
    """Count the adjacency demands a cell breaks."""
    kind, tally, lacking = state.tile[cell], state.near[cell], 0
    for place in range(board.needed[kind]):
        lacking += (tally & board.needs[kind, place]) == 0
    return lacking


@_compile
def _excess(board, state, bound):
    """How far a count is outside its bounds."""
    count = state.counts[bound]
    return max(board.low[bound] - count, 0) + max(count - board.high[bound], 0)


@_compile
def _aisle_change(board, state, cell, closing):
    """Update the aisle squares over a cell that closes or opens; returns the change in broken."""
    width, broken = board.aisle, 0
    for up in range(width):
        for left in range(width):
            corner = cell - up * board.stride - left
            if corner < 0:
                continue
            before = state.blocked[corner] == 0
            state.blocked[corner] += 1 if closing else -1
            after = state.blocked[corner] == 0
            if before == after:
                continue
            for down in range(width):
                for right in range(width):
                    inside = corner + down * board.stride + right
                    broken -= state.drive[inside] == 1 and state.cover[inside] == 0
                    state.cover[inside] += 1 if after else -1
                    broken += state.drive[inside] == 1 and state.cover[inside] == 0
    return broken


@_compile
def _put(board, state, cell, new):
    """Set one cell and update the energy."""
    old, stride, broken = state.tile[cell], board.stride, 0
    for bound in range(board.low.size):
        step = board.member[new, bound] - board.member[old, bound]
        if step:
            broken -= _excess(board, state, bound)
            state.counts[bound] += step
            broken += _excess(board, state, bound)
    change = board.word[new] - board.word[old]
    broken -= _lacks(board, state, cell)
    for step in (1, -1, stride, -stride):
        broken -= _lacks(board, state, cell + step)
        state.near[cell + step] += change
        broken += _lacks(board, state, cell + step)
    state.tile[cell] = new
    broken += _lacks(board, state, cell)
    if board.aisle > 1 and board.driving[new] != board.driving[old]:
        broken -= state.drive[cell] == 1 and state.cover[cell] == 0
        state.drive[cell] = board.driving[new]
        broken += state.drive[cell] == 1 and state.cover[cell] == 0
        broken += _aisle_change(board, state, cell, board.driving[new] == 0)
    state.drive[cell] = board.driving[new]
    state.broken[0] += broken
    home = board.home[cell]
    state.cost[0] += board.price[cell] * ((new != home) * 1.0 - (old != home) * 1.0)


@_compile
def _may_open(board, state, cell):
    """Whether a closed cell touches the driving area."""
    near = state.drive[cell + 1] + state.drive[cell - 1]
    return near + state.drive[cell + board.stride] + state.drive[cell - board.stride] > 0


@_compile
def _may_close(board, state, cell):
    """Whether the driving area stays in one piece without this cell of it."""
    pattern = 0
    for place in range(8):
        pattern |= state.drive[cell + board.ring[place]] << place
    pieces = board.parts[pattern]
    return pieces == 1 or (pieces > 1 and _meet(board, state, cell, pattern))


@_compile
def _meet(board, state, cell, pattern):
    """Search from all open neighbours in lockstep until they meet or one is cut off.

    Lockstep makes the cost that of the smallest piece, or of the way round the obstacle.
    """
    mark, queue = state.mark, state.queue
    clock = mark[-1] + 4
    mark[-1] = clock
    heads, tails, group = [0, 0, 0, 0], [0, 0, 0, 0], [0, 1, 2, 3]
    groups, visited = 0, 0
    mark[cell] = -1
    for side in range(4):
        if pattern >> 2 * side & 1:
            start = cell + board.ring[2 * side]
            queue[side, 0], mark[start] = start, clock + side
            tails[side] = 1
            groups += 1
    while groups > 1:
        for side in range(4):
            if heads[side] == tails[side]:
                continue
            here = queue[side, heads[side]]
            heads[side] += 1
            visited += 1
            for step in (1, -1, board.stride, -board.stride):
                there = here + step
                if state.drive[there] == 0 or there == cell:
                    continue
                if mark[there] < clock:
                    mark[there] = clock + side
                    queue[side, tails[side]] = there
                    tails[side] += 1
                else:
                    other = group[mark[there] - clock]
                    if other != group[side]:
                        groups -= 1
                        for member in range(4):
                            if group[member] == other:
                                group[member] = group[side]
        if groups > 1:
            for one in range(4):
                waiting, started = 0, 0
                for side in range(4):
                    if group[side] == one:
                        waiting += tails[side] - heads[side]
                        started += tails[side]
                if started > 0 and waiting == 0:
                    return False
            if visited > BUDGET:
                return False
    return True


@_compile
def _member_for(board, rng, cell, role, old):
    """Pick a tile of `role` for a cell: its input tile if it fits, else any allowed one, or -1."""
    home = board.home[cell]
    if board.role[home] == role and home != old and board.allowed[cell] >> home & 1:
        return home
    kind = board.cast[role, _draw(rng, board.size[role])]
    return kind if board.allowed[cell] >> kind & 1 else -1


@_compile
def _other_tile(board, state, rng, cell, driving):
    """Pick a tile for a cell: often its input tile; `driving` 0 or 1 asks for a kind of area."""
    old, home = state.tile[cell], board.home[cell]
    fits = driving < 0 or board.driving[home] == driving
    if old != home and fits and board.allowed[cell] >> home & 1 and _draw(rng, 2):
        return home
    role = _draw(rng, board.size.size)
    if driving >= 0 and board.driving[board.cast[role, 0]] != driving:
        return -1
    if role == board.role[old] and (board.size[role] == 1 or _draw(rng, 4)):
        return -1
    return _member_for(board, rng, cell, role, old)


@_compile
def _partner(board, state, rng, cell, driving):
    """Find a free cell of the given area, near `cell` half the time; -1 after six misses."""
    near = _draw(rng, 2)
    for _ in range(6):
        other = board.free[_draw(rng, board.free.size)]
        if near:
            other = cell + (_draw(rng, 5) - 2) * board.stride + _draw(rng, 5) - 2
            if other < 0 or other >= state.tile.size:
                continue
        allowed = board.allowed[other]
        if other != cell and allowed & (allowed - 1) and state.drive[other] == driving:
            return other
    return -1


@_compile
def _propose(board, state, rng):
    """Draw up to three changes into `state.move`; returns how many."""
    move, changes = state.move, 1
    cell = board.free[_draw(rng, board.free.size)]
    new = _other_tile(board, state, rng, cell, -1)
    if new < 0 or new == state.tile[cell]:
        return 0
    move[0, 0], move[0, 1] = cell, new
    if board.driving[new] != state.drive[cell] and _draw(rng, 10) < 7:
        other = _partner(board, state, rng, cell, board.driving[new])
        if other >= 0:
            swap = _other_tile(board, state, rng, other, state.drive[cell])
            if swap >= 0:
                move[1, 0], move[1, 1] = other, swap
                changes = 2
    if _draw(rng, 3) == 0:
        side = cell + board.ring[2 * _draw(rng, 4)]
        allowed = board.allowed[side]
        if allowed & (allowed - 1) and state.drive[side] and (changes == 1 or side != move[1, 0]):
            tile = _other_tile(board, state, rng, side, 1)
            if tile >= 0 and tile != state.tile[side]:
                move[changes, 0], move[changes, 1] = side, tile
                changes += 1
    return changes


@_compile
def _stays_linked(board, state, changes):
    """Whether the applied changes keep the driving area in one piece, opening before closing."""
    move, good = state.move, True
    for index in range(changes):
        state.drive[move[index, 0]] = board.driving[move[index, 2]]
    for opening in (1, 0):
        for index in range(changes):
            cell = move[index, 0]
            after = board.driving[move[index, 1]]
            if after == board.driving[move[index, 2]] or after != opening or not good:
                continue
            good = _may_open(board, state, cell) if opening else _may_close(board, state, cell)
            state.drive[cell] = after
    for index in range(changes):
        state.drive[move[index, 0]] = board.driving[move[index, 1]]
    return good


@_compile
def _step(board, state, rng, heat, pull):
    """Propose one move and accept or undo it."""
    changes = _propose(board, state, rng)
    if changes == 0:
        return False
    move, moved = state.move, False
    before = state.cost[0] + pull * state.broken[0]
    for index in range(changes):
        cell, new = move[index, 0], move[index, 1]
        move[index, 2] = state.tile[cell]
        moved |= board.driving[new] != state.drive[cell]
        _put(board, state, cell, new)
    rise = state.cost[0] + pull * state.broken[0] - before
    accept = rise <= 0 or _draw(rng, 1 << 30) < np.exp(-rise / heat) * (1 << 30)
    if accept and moved and board.linked:
        accept = _stays_linked(board, state, changes)
    if not accept:
        for index in range(changes - 1, -1, -1):
            _put(board, state, move[index, 0], move[index, 2])
    return accept


@_compile
def cool(board, state, rng, moves, heats, pulls, best):
    """Anneal for a fixed number of moves; returns the price of the best feasible layout.

    Heat falls geometrically, the price of a broken demand rises linearly. `best` (int64 [N])
    receives the cheapest layout that broke nothing; the price is infinite when there was none.
    """
    lowest, heat, pull = np.inf, heats[0], pulls[0]
    for index in range(moves):
        if index & 1023 == 0:
            done = index / moves
            heat = heats[0] * (heats[1] / heats[0]) ** done
            pull = pulls[0] + (pulls[1] - pulls[0]) * done
        if state.broken[0] == 0 and state.cost[0] < lowest:
            lowest = state.cost[0]
            best[:] = state.tile
        _step(board, state, rng, heat, pull)
    if state.broken[0] == 0 and state.cost[0] < lowest:
        lowest = state.cost[0]
        best[:] = state.tile
    return lowest


@_compile
def join(board, tile, open_tile, root):
    """Open the cheapest paths that join every driving cell to `root`, in place.

    A 0-1 search whose front restarts from each part it reaches. `open_tile` (int64 [N]) is what
    to put on an opened cell, -1 where it must stay closed.
    """
    size = tile.size
    far = np.full(size, 1 << 30)
    came = np.full(size, -1)
    deque = np.empty(8 * size + 8, np.int64)
    head = tail = 4 * size
    joined = np.zeros(size, np.bool_)
    if board.driving[tile[root]] == 0:
        tile[root] = open_tile[root]
    far[root], deque[tail], joined[root] = 0, root, True
    tail += 1
    while head < tail:
        here = deque[head]
        head += 1
        if far[here] > 0 and board.driving[tile[here]] and not joined[here]:
            back = here
            while back >= 0 and not joined[back]:
                joined[back], far[back] = True, 0
                if board.driving[tile[back]] == 0:
                    tile[back] = open_tile[back]
                if head > 0:
                    head -= 1
                    deque[head] = back
                back = came[back]
            continue
        for step in (1, -1, board.stride, -board.stride):
            there = here + step
            closed = board.driving[tile[there]] == 0
            if closed and open_tile[there] < 0:
                continue
            price = far[here] + closed
            if price < far[there]:
                far[there], came[there] = price, here
                if not closed and far[here] == 0:
                    joined[there] = True
                if closed and tail < deque.size:
                    deque[tail] = there
                    tail += 1
                elif not closed and head > 0:
                    head -= 1
                    deque[head] = there
    return joined


def _windows(mask: np.ndarray, width: int) -> np.ndarray:
    """Sum `mask` over the width x width squares that start at each cell, False beyond the edge."""
    padded = np.pad(mask.astype(np.int64), ((0, width - 1), (0, width - 1)))
    view = np.lib.stride_tricks.sliding_window_view(padded, (width, width))
    return view.sum((-1, -2))


def _open_tiles(board: Board) -> np.ndarray:
    """Choose what to put on a cell that opens: its input tile, else the least demanding one."""
    kinds = board.role.size - 1
    choice = np.full(board.home.size, -1)
    order = sorted(np.flatnonzero(board.driving[:kinds]), key=lambda kind: -board.needed[kind])
    for kind in order:
        choice[board.allowed >> kind & 1 == 1] = kind
    kept = (board.driving[board.home] == 1) & (board.allowed >> board.home & 1 == 1)
    return np.where(kept, board.home, choice)


def _settle(board: Board, tile: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Make every tile an allowed one and the driving area one piece."""
    opened, kinds = _open_tiles(board), board.role.size - 1
    first = np.argmax(board.allowed[:, None] >> np.arange(kinds) & 1, axis=1)
    wall = board.home == kinds
    fits = board.allowed >> tile & 1 == 1
    tile = np.where(fits | wall, tile, np.where(opened >= 0, opened, first))
    if not board.linked or not (opened >= 0).any():
        return tile
    closable = (board.allowed & ~int((1 << np.arange(kinds))[board.driving[:kinds] == 1].sum())) > 0
    must = np.flatnonzero(~closable & ~wall)
    candidates = must if must.size else np.flatnonzero(board.driving[tile] == 1)
    candidates = candidates if candidates.size else np.flatnonzero(opened >= 0)
    joined = join(board, tile, opened, candidates[rng.integers(candidates.size)])
    shut = [kind for kind in range(kinds) if not board.driving[kind]]
    for cell in np.flatnonzero((board.driving[tile] == 1) & ~joined & closable):
        tile[cell] = next(kind for kind in shut if board.allowed[cell] >> kind & 1)
    return tile


def open_state(board: Board, tile: np.ndarray) -> State:
    """Start a `State` from `tile` (int64 [N], connected, every tile allowed)."""
    size, stride = tile.size, board.stride
    drive = board.driving[tile]
    near = np.zeros(size, np.int64)
    for step in (1, -1, stride, -stride):
        near += np.roll(board.word[tile], step)
    lacking = (near[:, None] & board.needs[tile]) == 0
    active = np.arange(board.needs.shape[1]) < board.needed[tile][:, None]
    counts = board.member[tile].sum(0)
    broken = (lacking & active).sum()
    broken += np.maximum(board.low - counts, 0).sum() + np.maximum(counts - board.high, 0).sum()
    blocked, cover = np.zeros(size, np.int64), np.zeros(size, np.int64)
    if board.aisle > 1:
        width = board.aisle
        shape = (size // stride, stride)
        blocked = width**2 - _windows(drive.reshape(shape), width).ravel()
        cover = _windows((blocked == 0).reshape(shape)[::-1, ::-1], width)[::-1, ::-1].ravel()
        broken += ((drive == 1) & (cover == 0)).sum()
    return State(
        tile=tile.astype(np.int64),
        drive=drive.copy(),
        near=near,
        counts=counts.astype(np.int64),
        cost=np.array([(board.price * (tile != board.home)).sum()]),
        broken=np.array([broken], np.int64),
        blocked=blocked,
        cover=cover.copy(),
        mark=np.zeros(size + 1, np.int64),
        queue=np.zeros((4, size), np.int64),
        move=np.zeros((3, 3), np.int64),
    )


def anneal(
    layout: np.ndarray,
    rules: Rules,
    seed: int,
    moves: int,
    start: np.ndarray | None = None,
    heats: tuple[float, float] = (0.3, 0.1),
    pulls: tuple[float, float] = (0.8, 2.5),
) -> tuple[np.ndarray | None, float]:
    """Find a cheap layout that obeys every rule.

    Args:
        layout: int8 [H, W], the input from which changes are counted.
        rules: the constraints.
        seed: any integer; the same seed gives the same layout.
        moves: proposed moves.
        start: int8 [H, W], where to start instead of at the input.
        heats: first and last temperature, in units of the mean cell weight.
        pulls: first and last price of a broken demand, in units of the largest cell weight.

    Returns:
        The best feasible layout (int8 [H, W]) and its price, or (None, inf).
    """
    board = compile_board(layout, rules)
    rng = np.random.default_rng(abs(seed))
    first = layout if start is None else start
    tile = np.pad(first.astype(np.int64), 1, constant_values=len(rules.tiles)).ravel()
    state = open_state(board, _settle(board, tile, rng))
    prices = board.price[board.free]
    mean, top = (float(prices.mean()), float(prices.max())) if prices.size else (1.0, 1.0)
    best = np.zeros_like(state.tile)
    draws = rng.integers(1, 2**63, 1).astype(np.uint64)
    heats = tuple(heat * mean for heat in heats)
    pulls = tuple(pull * top for pull in pulls)
    moves = moves if board.free.size else 0
    price = cool(board, state, draws, moves, heats, pulls, best)
    if not np.isfinite(price):
        return None, float("inf")
    rows = layout.shape[0] + 2
    return best.reshape(rows, -1)[1:-1, 1:-1].astype(np.int8), float(price)
