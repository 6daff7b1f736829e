"""The annealer: its tables and its bookkeeping against slow recomputation."""

import numpy as np
import pytest
from scipy import ndimage

from qdenv.bench.repair import hard_layouts, rules_at_size
from qdenv.domains import find_domain
from qdenv.repair.anneal import anneal
from qdenv.repair.audit import audit
from qdenv.repair.board import begin, compile_board, group_roles, settle
from qdenv.repair.kernels import cool
from qdenv.repair.moves import DRIVES
from qdenv.repair.template import templates
from qdenv.repair.topology import ring_parts
from qdenv.types import Adjacency, Count, InputError, Rules

CROSS = ndimage.generate_binary_structure(2, 1)


def mixed_rules(rows: int = 9, cols: int = 10, aisle: int = 1) -> Rules:
    """Three kinds of station counted apart, a fixed door, a keep-out and uneven weights."""
    allowed = np.ones((rows, cols, 5), bool)
    allowed[0, 0] = [True, False, False, False, False]
    allowed[4, 4:7, 1:4] = False
    weights = np.ones((rows, cols))
    weights[:, :3] = 2
    return Rules(
        tiles=".012e",
        counts=(Count("0", 2, 4), Count("12", 3, None), Count("e", 1, 40)),
        adjacency=(Adjacency("012", "e"), Adjacency("e", "012")),
        connected=".e",
        allowed=allowed,
        change_cost=weights,
        aisle=aisle,
    )


def test_ring_table_agrees_with_labelling():
    places = [(0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0)]
    for pattern, parts in enumerate(ring_parts()):
        ring = np.zeros((3, 3), bool)
        for bit, place in enumerate(places):
            ring[place] = pattern >> bit & 1
        labels, _ = ndimage.label(ring, CROSS)
        sides = {labels[place] for place in places[::2] if ring[place]}
        assert parts == len(sides), pattern


def test_tiles_alike_share_a_role():
    assert group_roles(find_domain("manufacturing").rules(5, 5, 0)) == [[0], [1, 2, 3], [4]]
    assert group_roles(find_domain("warehouse-even").rules(5, 9, 2)) == [[0], [1], [2], [3]]


@pytest.mark.parametrize("aisle", [1, 2])
def test_bookkeeping_and_connectivity_survive_thousands_of_moves(aisle):
    rules = mixed_rules(aisle=aisle)
    rng = np.random.default_rng(0)
    for seed in range(4):
        layout = rng.integers(0, 5, (9, 10)).astype(np.int8)
        board = compile_board(layout, rules)
        tile = settle(board, layout, rng)
        for moves in (0, 3000):
            state = begin(board, tile)
            draws = np.array([seed + 1], np.uint64)
            cool(board, state, draws, moves, (2.0, 1.0), (0.5, 0.5))
            fresh = begin(board, state.tile)
            for field in ("drive", "near", "counts", "blocked", "cover")[: 3 if aisle == 1 else 5]:
                assert (getattr(state, field) == getattr(fresh, field)).all(), field
            drive = board.kinds[state.tile, DRIVES].reshape(11, 12) == 1
            assert ndimage.label(drive, CROSS)[1] == 1
            differs = np.flatnonzero(state.tile != board.home)
            assert sorted(state.changed[1 : 1 + state.changed[0]]) == differs.tolist()


def test_begin_counts_the_same_breaches_as_the_audit_finds():
    rules = mixed_rules()
    layout = np.zeros((9, 10), np.int8)
    layout[2, 2:5] = [1, 4, 2]
    layout[6, 6] = 4  # an endpoint without a station; one 0 and two of 1 and 2 are missing
    board = compile_board(layout, rules)
    assert begin(board, settle(board, layout, np.random.default_rng(0))).broken == 1 + 1 + 2


def test_same_seed_same_layout_and_price():
    rules = mixed_rules()
    layout = np.full((9, 10), 4, np.int8)
    one, price = anneal(layout, rules, 7, 20000)
    two, _ = anneal(layout, rules, 7, 20000)
    assert (one == two).all()
    assert price == (rules.change_cost * (one != layout)).sum()
    assert audit(one, rules) == []


@pytest.mark.parametrize("kind", ["warehouse-even", "manufacturing"])
def test_hard_layouts_become_feasible_with_few_moves(kind):
    rules = rules_at_size(kind)
    for layout in hard_layouts(kind, 8, seed=5):
        found, _ = anneal(layout, rules, 0, 200_000)
        assert found is not None and audit(found, rules) == []


@pytest.mark.parametrize("shelves", [0, 1, 240, 600, 704])
def test_one_of_the_templates_obeys_the_rules_at_any_number_of_shelves(shelves):
    rules = find_domain("warehouse-even").rules(33, 36, shelves)
    layout = np.where(rules.allowed[..., 0], 0, 3).astype(np.int8)
    assert min(len(audit(drawn, rules)) for drawn in templates(layout, rules)) == 0


def test_too_many_kinds_are_refused_in_one_line():
    rules = mixed_rules()._replace(tiles="abcdefghijklmnopqrstu", counts=(), adjacency=())
    with pytest.raises(InputError, match="at most 20 kinds of tile"):
        compile_board(np.zeros((9, 10), np.int8), rules)


def test_free_changes_are_no_division_by_zero():
    rules = mixed_rules()._replace(change_cost=np.zeros((9, 10)))
    found, price = anneal(np.full((9, 10), 4, np.int8), rules, 0, 20000)
    assert price == 0 and audit(found, rules) == []
