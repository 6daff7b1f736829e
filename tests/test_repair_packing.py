"""Packing: layouts near the greatest number of obstacles, audited and counted anew."""

import numpy as np
import pytest
from scipy import ndimage

from qdenv.domains.base import find_domain
from qdenv.repair.anneal import packing
from qdenv.repair.anneal.packing import draw_templates, pack, pack_moves, start_packing
from qdenv.repair.audit import audit
from qdenv.repair.recipe import repair_layout
from qdenv.repair.rules import Facts
from qdenv.repair.settings import RepairConfig
from qdenv.types import RepairStatus, Rules


def warehouse(rows: int, cols: int, shelves: int) -> Rules:
    return find_domain("warehouse-even").resized(rows, cols, {"shelves": shelves}).rules()


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
    assert pack(Facts(rules._replace(aisle=2))) is None
    assert pack(Facts(rules._replace(counts=()))) is None
    assert pack(Facts(rules._replace(connected=""))) is None
    assert pack(Facts(find_domain("manufacturing").rules())) is None
