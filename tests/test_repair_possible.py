"""Near the greatest number of shelves: found or packed where one exists, or proven impossible."""

import itertools

import numpy as np
import pytest
from scipy import ndimage
from small_yard import yard

from qdenv.domains.base import find_domain
from qdenv.repairs.anneal import packing
from qdenv.repairs.anneal.packing import draw_templates, pack, pack_moves, start_packing
from qdenv.repairs.audit import audit
from qdenv.repairs.milp import feasibility
from qdenv.repairs.milp.feasibility import explain, find_possible
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.rules import Facts, impossible
from qdenv.repairs.settings import RepairConfig
from qdenv.types import Count, RepairStatus, Rules

pytestmark = pytest.mark.slow
SQUARE = np.ones((2, 2), bool)


def warehouse(rows: int, cols: int, shelves: int) -> Rules:
    return find_domain("warehouse-even").resized(rows, cols, {"shelves": shelves}).rules()


def exact_yard(rows: int, cols: int, shelves: int) -> Rules:
    return yard(rows, cols, shelves, shelves)


def numbers_that_exist(rules: Rules) -> set[int]:
    """List by enumeration of all driving areas with how many shelves some layout exists."""
    shelf = rules.tiles.index("@")
    may, served = rules.allowed[..., shelf], rules.allowed[..., rules.tiles.index("e")]
    free, found = np.argwhere(may), set[int]()
    for stands in itertools.product([False, True], repeat=len(free)):
        shelves = np.zeros_like(may)
        shelves[tuple(free.T)] = stands
        # Every driving cell beside a shelf may be an endpoint, so all of them are.
        endpoints = ~shelves & served & ndimage.binary_dilation(shelves)
        alone = shelves & ~ndimage.binary_dilation(endpoints)
        if not alone.any() and ndimage.label(~shelves)[1] <= 1:
            found.add(int(shelves.sum()))
    return found


@pytest.mark.parametrize(
    ("make", "rows", "cols"),
    [
        (warehouse, 4, 7),
        (warehouse, 6, 6),
        (warehouse, 3, 8),
        (exact_yard, 3, 4),
        (exact_yard, 2, 6),
    ],
)
def test_every_number_of_shelves_is_found_or_proven_impossible(make, rows, cols):
    exist = numbers_that_exist(make(rows, cols, 0))
    assert {0, 1, 2, 3} <= exist
    for shelves in range(max(exist) + 4):
        rules = make(rows, cols, shelves)
        status, layout = find_possible(Facts(rules))
        if shelves in exist:
            assert layout is not None and audit(layout, rules) == []
        else:
            assert status == RepairStatus.IMPOSSIBLE


@pytest.mark.parametrize(("shape", "most"), [((4, 11), 17), ((7, 7), 14), ((6, 14), 40)])
def test_repairs_reach_the_greatest_number_from_any_layout_and_no_more(shape, most):
    rng = np.random.default_rng(3)
    for shelves in (most, most + 1):
        rules = warehouse(*shape, shelves)
        for seed in range(3):
            layout = rng.integers(0, 3, shape).astype(np.int8)
            repaired = repair_layout(layout, rules, seed, RepairConfig("none"))
            if shelves > most:
                assert repaired.status == RepairStatus.IMPOSSIBLE
                np.testing.assert_array_equal(repaired.layout, layout)
            else:
                assert audit(np.asarray(repaired.layout), rules) == []
                assert repaired.cost == (repaired.layout != layout).sum() < np.inf


def test_at_size_s_711_shelves_are_impossible_and_the_answer_is_remembered(monkeypatch):
    facts = Facts(warehouse(33, 36, 711))
    assert find_possible(facts)[0] == RepairStatus.IMPOSSIBLE
    monkeypatch.setattr(feasibility, "_decide", lambda *_: pytest.fail("decided again"))
    assert find_possible(Facts(warehouse(33, 36, 711)))[0] == RepairStatus.IMPOSSIBLE


def test_what_is_not_decided_is_failed(monkeypatch):
    monkeypatch.setattr(feasibility, "_BRANCHED_CELLS", 0)
    assert find_possible(Facts(warehouse(7, 14, 45)))[0] == RepairStatus.FAILED


def test_wide_aisles_that_leave_no_room_are_proven_impossible():
    rules = warehouse(8, 8, 18)
    rules = rules._replace(counts=(Count("@", 18, None),)).buildable(2)
    assert find_possible(Facts(rules))[0] == RepairStatus.IMPOSSIBLE


def test_cells_beside_wide_aisles_are_bounded_by_those_of_the_aisles():
    rng, tight = np.random.default_rng(0), 0
    for _ in range(200):
        rows, cols = rng.integers(3, 9, 2)
        floor = rng.random((rows, cols)) >= rng.choice([0, 0.15, 0.3])
        allowed = floor[..., None] | np.array([False, True, False])
        facts = Facts(yard(rows, cols, 0, None, allowed=allowed).buildable(2))
        (rule,) = facts.rules.covers
        room = facts.room(rule)
        corners = rng.random((rows, cols)) < rng.random()
        squares = ndimage.binary_dilation(ndimage.binary_erosion(room, SQUARE) & corners, SQUARE)
        drives = squares | (floor & ~room & (rng.random((rows, cols)) < 0.7))
        labels, parts = ndimage.label(drives)
        for part in range(1, parts + 1):
            aisle = np.pad(labels == part, 1)
            ring = (ndimage.binary_dilation(aisle) & ~aisle).sum()
            cells = aisle.sum() + (aisle & ~np.pad(room, 1)).sum()
            assert ring <= cells + facts.spare_ring(rule)
            tight += ring == cells + facts.spare_ring(rule)
    assert tight > 10  # no smaller bound holds


def test_a_layout_is_found_or_excluded_where_aisles_are_wide():
    """Near the most that fit: found without paying for changes, or excluded by a relaxation."""
    facts = Facts(yard(16, 18, 112, 112).buildable(2, (2, 3)))
    status, layout = find_possible(facts)
    assert status == RepairStatus.ANNEALED and audit(layout, facts.rules) == []
    rules = yard(10, 12, 60, 60).buildable(2)
    assert impossible(rules) is None
    assert explain(rules) == "the number of '@' must be at least 60 but at most 59 can be reached"


@pytest.mark.parametrize(("stations", "exists"), [(2, False), (3, True)])
def test_a_station_that_is_fixed_counts_as_its_own_kind(stations, exists):
    rules = find_domain("manufacturing").resized(4, 9).rules()
    kinds = tuple(Count(kind, low, None) for kind, low in (("0", 1), ("1", 0), ("2", 1)))
    allowed = rules.allowed.copy()
    allowed[2, 8] = np.arange(len(rules.tiles)) == rules.tiles.index("1")
    rules = rules._replace(counts=(Count("012", stations, stations), *kinds), allowed=allowed)
    layout = np.random.default_rng(5).integers(0, 5, (4, 9)).astype(np.int8)
    repaired = repair_layout(layout, rules, 0, RepairConfig("quick"))
    if exists:
        assert audit(np.asarray(repaired.layout), rules) == []
    else:
        assert repaired.status == RepairStatus.IMPOSSIBLE


# Straight aisles hold 96, 416 and 704 shelves here.
@pytest.mark.parametrize(("shape", "shelves"), [((18, 12), 98), ((24, 30), 419), ((33, 36), 708)])
def test_more_shelves_than_straight_aisles_hold(shape, shelves):
    rules = warehouse(*shape, shelves)
    layout = pack(Facts(rules))
    assert layout is not None and audit(layout, rules) == []
    assert (layout == rules.tiles.index("@")).sum() == shelves


def test_repairs_use_it_where_annealing_finds_nothing():
    rules = warehouse(18, 12, 98)
    layout = np.random.default_rng(3).integers(0, 3, (18, 12)).astype(np.int8)
    repaired = repair_layout(layout, rules, 0, RepairConfig("none"))
    assert repaired.status == RepairStatus.ANNEALED
    assert audit(np.asarray(repaired.layout), rules) == []


@pytest.mark.parametrize("moves", [1, 1000, 50_000])
def test_what_is_counted_along_the_way_is_what_counting_anew_gives(moves):
    facts = Facts(warehouse(12, 14, 85))
    (service,) = (rule for rule in facts.rules.adjacency if "@" in rule.tiles)
    start = facts.driving[draw_templates(facts.any_layout, facts)[0]]
    packed = start_packing(start, facts, service)
    assert not pack_moves(packed, 85, 85, np.uint64(moves), 0, moves, moves)
    drives = packed.drives.reshape(14, 16)[1:-1, 1:-1]
    again = start_packing(drives.copy(), facts, service)
    for field in ("obstacles", "unserved", "pieces", "ring"):
        np.testing.assert_array_equal(getattr(packed, field), getattr(again, field))
    assert drives[facts.must(".ew")].all() and again.pieces == ndimage.label(drives)[1]


def test_where_a_run_is_cut_makes_no_difference(monkeypatch):
    facts, told = Facts(warehouse(18, 12, 97)), list[float]()
    whole = pack(facts)
    monkeypatch.setattr(packing, "_CHUNK", 70_001)
    cut = pack(facts, lambda step, share, note: told.append(share))
    np.testing.assert_array_equal(whole, cut)
    assert told == sorted(told) and told[0] > 0 and told[-1] < 1


def test_rules_of_another_kind_are_left_to_others():
    rules = warehouse(18, 12, 97)
    assert pack(Facts(rules.buildable(2))) is None
    assert pack(Facts(rules._replace(counts=()))) is None
    assert pack(Facts(rules._replace(connected=""))) is None
    assert pack(Facts(find_domain("manufacturing").rules())) is None
