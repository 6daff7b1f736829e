"""Where annealing starts: the rules and the input as tables, a layout projected into one piece."""

import numpy as np

from qdenv.repairs.anneal.connectivity import join_pieces
from qdenv.repairs.anneal.state import (
    DRAWS,
    MAX_KINDS,
    MAX_NEEDS,
    NO_TILE,
    PLACES,
    AnnealState,
    Board,
    Covers,
    TileGroup,
    Trait,
)
from qdenv.repairs.rules import Facts
from qdenv.types import InputError

# `Board.demand_weight` without covers, with aisles, with racks. A shelf where it breaks another
# rule must not make up for one that is missing: such pairs would jam what changes by whole
# rectangles, and one more shelf finds its place more easily. Measured on grown layouts.
_DEMAND_WEIGHTS = (1, 2, 4)


def _tabulate_choices(allowed: np.ndarray, facts: Facts) -> tuple[np.ndarray, np.ndarray]:
    """Tabulate what to draw on cells that allow the tiles `allowed` (bool [K]).

    Each role is as often drawn as another, so that three kinds of station are not three times as
    likely; another kind of the same role matters to the counts only, and comes a quarter as often.
    """
    kinds = allowed.size
    choices = np.full((len(TileGroup), kinds + 1, DRAWS), NO_TILE, np.int8)
    fits = np.zeros((len(TileGroup), kinds + 1), np.int8)
    for group in TileGroup:
        fits[group, :kinds] = allowed & ((group == TileGroup.ANY) | (facts.driving == group))
        for old in range(kinds):
            weights = np.zeros(kinds)
            for role, members in enumerate(facts.roles):
                others = [kind for kind in members if fits[group, kind] and kind != old]
                share = 0.25 if role == facts.role_of[old] else 1.0
                weights[others] = share / max(len(others), 1)
            if weights.any():
                ends = np.cumsum(weights) / weights.sum()
                choices[group, old] = np.searchsorted(ends, (np.arange(DRAWS) + 0.5) / DRAWS)
    return choices, fits


def compile_board(layout: np.ndarray, facts: Facts) -> Board:
    """Compile the rules and the input `layout` (int8 [H, W]) for the kernels, or InputError."""
    rules, kinds = facts.rules, len(facts.rules.tiles)
    if kinds > MAX_KINDS:
        more = f"at most {MAX_KINDS} kinds of tile, these rules have {kinds}"
        raise InputError(f"the repair knows {more}: merge tiles that obey the same rules")
    different = sorted({need for needs in facts.needs for need in needs})
    if len(different) > MAX_NEEDS:
        more = f"at most {MAX_NEEDS} different neighbours that tiles need, not {len(different)}"
        raise InputError(f"the repair knows {more}: merge demands")
    traits = []
    for kind, tile in enumerate(rules.tiles):
        unit = sum(1 << 4 * field for field, need in enumerate(different) if tile in need)
        needs = sum(1 << 4 * different.index(need) for need in set(facts.needs[kind]))
        bounds = sum(int(counts) << q for q, counts in enumerate(facts.counting[:, kind]))
        traits.append([facts.driving[kind], unit, needs, facts.role_of[kind], bounds])
    allowed = np.pad((rules.allowed * (1 << np.arange(kinds))).sum(-1).astype(np.int64), 1).ravel()
    masks, tile_set = np.unique(allowed, return_inverse=True)
    tables = [_tabulate_choices(mask >> np.arange(kinds) & 1 == 1, facts) for mask in masks]
    open_tile = np.full(allowed.size, NO_TILE, np.int8)
    for driving in sorted(np.flatnonzero(facts.driving), key=lambda kind: -facts.demands[kind]):
        open_tile[allowed >> driving & 1 == 1] = driving
    steps, free = PLACES @ (layout.shape[1] + 2, 1), np.pad(facts.free, 1).ravel()
    return Board(
        layout=np.pad(layout.astype(np.int8), 1, constant_values=kinds).ravel(),
        change_cost=np.pad(np.asarray(rules.change_cost, np.float32), 1).ravel(),
        free=np.flatnonzero(free).astype(np.int32),
        free_ring=join_bits(free, steps),
        open_tile=open_tile,
        tile_set=tile_set.astype(np.int16),
        choices=np.array([choices for choices, _ in tables]),
        fits=np.array([fits for _, fits in tables]),
        traits=np.array([*traits, [0, 0, 0, -1, 0]], np.int32),  # the last one is the wall
        count_bounds=facts.count_bounds,
        steps=steps,
        demand_weight=_DEMAND_WEIGHTS[0 if not rules.covers else 1 if all(facts.widens) else 2],
        connected=bool(rules.connected),
        # A partner that leaves its input tile shifts a corridor. Measured: where a number of tiles
        # is exact such pairs are worth less than changes of one cell.
        leave_quarters=1 if any(low == high for low, high in facts.count_bounds) else 4,
    )


def join_bits(marks: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Join the marks of the eight neighbours (bool [N]) in one number (uint8 [N])."""
    bits = [np.roll(marks, -step).astype(np.uint8) << place for place, step in enumerate(steps)]
    return np.asarray(np.sum(bits, 0, dtype=np.uint8))


def project(board: Board, start: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Pad a layout (int8 [H, W]), make every tile an allowed one and the driving area one piece.

    `rng` draws the cell whose piece the others are joined to. Returns int8 [N].
    """
    kinds, drives = len(board.traits) - 1, board.traits[:, Trait.DRIVES]
    may = board.fits[board.tile_set, TileGroup.ANY]
    candidate = np.pad(start.astype(np.int8), 1, constant_values=kinds).ravel()
    cells, wall, layout = np.arange(candidate.size), candidate == kinds, board.layout
    # Open a cell with its input tile where that drives: it costs nothing.
    kept = (may[cells, layout] == 1) & (drives[layout] == 1)
    opened = np.where(kept, layout, board.open_tile)
    kept = wall | (may[cells, candidate] == 1)
    fallback = np.where(opened >= 0, opened, may.argmax(1))
    candidate = np.where(kept, candidate, fallback).astype(np.int8)
    if not board.connected or not (opened >= 0).any():
        return candidate
    may_shut = board.fits[board.tile_set, TileGroup.OBSTACLE]
    shut = np.where(may_shut.any(1), may_shut.argmax(1), NO_TILE)
    # Start at a cell that always drives, else at one that does, else at one that may.
    roots = np.flatnonzero((shut < 0) & ~wall)
    roots = roots if roots.size else np.flatnonzero(drives[candidate] == 1)
    roots = roots if roots.size else np.flatnonzero(opened >= 0)
    root, stride = roots[rng.integers(roots.size)], int(board.steps[4])
    driving, joined = join_pieces(drives[candidate] == 1, opened >= 0, root, stride)
    candidate = np.where(driving & (drives[candidate] == 0), opened, candidate)
    return np.where(driving & ~joined & (shut >= 0), shut, candidate).astype(np.int8)


def initial_covers(board: Board, candidate: np.ndarray, facts: Facts) -> Covers | None:
    """Count the whole rectangles of a padded layout (int8 [N]); None where no rule is on them."""
    rules = facts.rules.covers
    if not rules:
        return None
    marks = [facts.holding(rule.tiles) + 2 * facts.holding(rule.ends) for rule in rules]
    belongs = np.pad(np.array(marks, np.int8), ((0, 0), (0, 1)))
    shapes = [(q, *shape) for q, rule in enumerate(rules) for shape in rule.shapes]
    offsets = np.zeros((len(shapes), max(rows * cols for _, rows, cols in shapes)), np.int64)
    needed, member = np.ones(offsets.shape, np.int8), belongs[:, candidate]
    lacking = np.zeros((len(shapes), candidate.size), np.int32)
    whole = np.zeros((len(rules), candidate.size), np.int32)
    for z, (rule, rows, cols) in enumerate(shapes):
        area = rows * cols
        offsets[z, :area] = (board.steps[4] * np.arange(rows)[:, None] + np.arange(cols)).ravel()
        # Rectangles that leave the grid hold a wall, on whichever side they come in again.
        needed[z, :area] = 2 - rules[rule].inner((rows, cols)).ravel()
        places = list(zip(offsets[z, :area], needed[z, :area], strict=True))
        lacking[z] = area - sum(np.roll(member[rule] == kind, -step) for step, kind in places)
        whole[rule] += sum(np.roll(lacking[z] == 0, step) for step, kind in places if kind == 1)
    weight = board.demand_weight
    weights = [
        np.pad((weight if widens else weight + 1) * ~exempt, 1).ravel()
        for widens, exempt in zip(facts.widens, facts.exempt, strict=True)
    ]
    costs = np.array(weights, np.int8)
    broken = np.array((costs * ((member == 1) & (whole == 0))).sum(), np.int64)
    return Covers(belongs, costs, np.array(shapes), offsets, needed, member, lacking, whole, broken)


def initial_state(board: Board, candidate: np.ndarray, covers: Covers | None = None) -> AnnealState:
    """Start at a projected layout (int8 [N])."""
    size, traits = candidate.size, board.traits[candidate]
    tally = sum(np.roll(traits[:, Trait.UNIT], step) for step in board.steps[::2])
    counts = (traits[:, Trait.BOUNDS, None] >> np.arange(len(board.count_bounds)) & 1).sum(0)
    low, high = board.count_bounds.T
    lacking = traits[:, Trait.NEEDS] & ~(tally | tally >> 1 | tally >> 2)
    broken = (lacking[:, None] >> 4 * np.arange(MAX_NEEDS) & 1).sum() * board.demand_weight
    broken += np.maximum(low - counts, counts - high).clip(0).sum()
    broken += 0 if covers is None else int(covers.broken)
    differs = candidate != board.layout
    changed, place = np.zeros(size, np.int32), np.zeros(size, np.int32)
    changed[: differs.sum()] = np.flatnonzero(differs)
    place[differs] = 1 + np.arange(differs.sum())
    return AnnealState(
        candidate=candidate.copy(),
        ring=join_bits(traits[:, Trait.DRIVES] == 1, board.steps),
        tally=tally.astype(np.int32),
        counts=counts.astype(np.int64),
        cost=np.array((board.change_cost * differs).sum(dtype=np.float64)),
        violations=np.array(broken, np.int64),
        changed=changed,
        num_changed=np.array(differs.sum(), np.int64),
        place=place,
        best=candidate.copy(),
        best_cost=np.array(np.inf),
        since=np.zeros(size + 1, np.int32),
        num_since=np.array(0, np.int64),
        feasible_period=np.array(0, np.int64),
        boost=np.array(1.0),
        walkers=np.zeros((3, 4), np.int64),
    )
