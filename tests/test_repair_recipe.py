"""The whole repair: optimal where enumeration can tell, feasible for every kind of rule."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from conftest import read_layout
from small_yard import yard

from qdenv.domains.base import find_domain
from qdenv.grid import parse
from qdenv.repairs import recipe
from qdenv.repairs.audit import audit
from qdenv.repairs.milp import highs
from qdenv.repairs.milp.highs import new_solver, separate
from qdenv.repairs.milp.program import build, decode, encode
from qdenv.repairs.milp.windows import WindowSearch
from qdenv.repairs.recipe import repair_layout
from qdenv.repairs.rules import Facts, impossible
from qdenv.repairs.settings import MOVES_PER_CELL, RepairConfig
from qdenv.types import InputError, RepairStatus, Rules

FULL = RepairConfig("full", moves_per_cell=300)


def factory(rows: int, cols: int, **changes) -> Rules:
    rules = find_domain("manufacturing").resized(rows, cols).rules()
    return rules._replace(**changes)


def feasible_layouts(rules: Rules) -> np.ndarray:
    """List every layout that obeys the rules, by enumeration (int8 [n, H, W])."""
    rows, cols, kinds = rules.allowed.shape
    everything = itertools.product(range(kinds), repeat=rows * cols)
    drawn = (np.array(tiles, np.int8).reshape(rows, cols) for tiles in everything)
    low, high = rules.counts[0].low, rules.counts[0].high
    counted = (layout for layout in drawn if low <= (layout == 1).sum() <= high)
    return np.array([layout for layout in counted if not audit(layout, rules)])


@pytest.mark.slow
@pytest.mark.parametrize("changes", [{}, {"change_cost": np.arange(1.0, 10.0).reshape(3, 3)}])
def test_full_repair_is_optimal_on_every_tried_tiny_layout(changes):
    rules = yard(3, 3, 2, 2, **changes)
    candidates, rng = feasible_layouts(rules), np.random.default_rng(0)
    assert len(candidates) > 50
    for _ in range(12):
        layout = rng.integers(0, 3, (3, 3)).astype(np.int8)
        best = ((candidates != layout) * rules.change_cost).sum((1, 2)).min()
        found = repair_layout(layout, rules, 0, FULL)
        assert found.cost == best
        assert found.lower_bound <= best
        assert audit(found.layout, rules) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "built",
    [
        {"aisle": 2},
        {"rack": (1, 2)},
        {"aisle": 2, "rack": (1, 2)},
        {"cross_aisle": 1},
        {"both_sides": True},
    ],
)
def test_program_prices_and_accepts_exactly_what_the_rules_do(built):
    """Every constraint but connectivity, over all layouts of a tiny canvas."""
    layout = np.array([[0, 1], [2, 2], [1, 0]], np.int8)
    facts = Facts(yard(3, 2, 1, 2).buildable(**built))
    program = build(layout, facts)
    for tiles in itertools.product(range(3), repeat=6):
        candidate = np.array(tiles, np.int8).reshape(3, 2)
        values = encode(program, candidate, layout, facts)
        accepted = True
        for rows in program.rows:
            left = np.where(rows.terms(), rows.values * values[rows.columns], 0.0).sum(1)
            accepted &= ((left >= rows.low - 1e-9) & (left <= rows.high + 1e-9)).all()
        breaches = audit(candidate, facts.rules)
        others = [found for found in breaches if "unconnected" not in found.message]
        assert accepted == (not others), candidate
        assert program.cost @ values + program.constant == (candidate != layout).sum()
        assert (decode(program.cells, values) == candidate).all()


def test_kinds_counted_apart_are_priced_when_they_must_change():
    """Four stations of one kind, two kinds missing: two of them change their kind."""
    layout = np.array([[1, 4, 1, 0], [0, 0, 0, 0], [1, 4, 1, 0]], np.int8)
    found = repair_layout(layout, factory(3, 4), 0, FULL)
    assert (found.cost, found.status) == (2, RepairStatus.OPTIMAL)


def test_cuts_forbid_the_pocket_and_no_connected_layout():
    drives = np.ones((4, 4), bool)
    drives[[0, 1, 1], [1, 0, 1]] = False  # the corner is cut off
    always = np.zeros((4, 4), bool)
    cuts = separate(drives, always)
    assert cuts
    rng = np.random.default_rng(0)

    def holds(cut, area):
        flat, (ends, gates) = area.ravel(), cut
        return flat[ends].sum() - flat[gates].sum() <= len(ends) - 1

    assert not any(holds(cut, drives) for cut in cuts)
    for _ in range(300):
        area = rng.random((4, 4)) < 0.7
        if not separate(area, always):
            assert all(holds(cut, area) for cut in cuts)


def test_engineers_rules_are_kept():
    """Keep-out, a fixed door, a fixed column, a count range and an aisle at once."""
    allowed = np.ones((10, 12, 3), bool)
    allowed[4:6, :, 1] = False  # keep-out: no shelf on the main lane
    allowed[0, 5] = [True, False, False]  # door
    allowed[7:9, 9] = [False, True, False]  # column
    rules = yard(10, 12, 8, 12, allowed=allowed).buildable(2)
    for seed in range(3):
        layout = np.random.default_rng(seed).integers(0, 3, (10, 12)).astype(np.int8)
        found = repair_layout(layout, rules, seed, RepairConfig("quick"))
        assert audit(found.layout, rules) == []
        assert 0 < found.lower_bound <= found.cost


@pytest.mark.slow
@pytest.mark.parametrize(
    ("built", "shelves"),
    [
        ({"aisle": 2}, 40),
        ({"aisle": 2, "rack": (2, 4)}, 40),
        ({"rack": (1, 3)}, 60),
        ({"aisle": 2, "rack": (2, 4), "cross_aisle": 4}, 32),
        ({"cross_aisle": 3}, 60),
        ({"rack": (2, 4), "both_sides": True}, 56),
    ],
)
def test_repairs_keep_the_rules_of_halls_that_are_built(built, shelves):
    for seed in range(3):
        rules = yard(14, 15, shelves, shelves).buildable(**built)
        layout = np.random.default_rng(seed).integers(0, 3, (14, 15)).astype(np.int8)
        found = repair_layout(layout, rules, seed, RepairConfig("quick"))
        assert audit(found.layout, rules) == []
        assert found.status == RepairStatus.ANNEALED


@pytest.mark.slow
def test_racks_fill_a_hall_that_straight_aisles_can_hold():
    """Ten racks of 2 x 10 between aisles two cells wide, and no more."""
    rules = yard(42, 14, 200, 200).buildable(2, (2, 10))
    layout = np.random.default_rng(0).integers(0, 3, (42, 14)).astype(np.int8)
    found = repair_layout(layout, rules, 0, RepairConfig("quick"))
    assert audit(found.layout, rules) == []


def test_rules_without_connectivity_or_adjacency():
    rules = yard(4, 5, 3, 3, connected="", adjacency=())
    found = repair_layout(np.full((4, 5), 1, np.int8), rules)
    assert (found.cost, found.status) == (17, RepairStatus.OPTIMAL)


def test_a_feasible_layout_stays_as_it_is():
    rules = yard(3, 4, 2, 2)
    layout = np.array([[0, 0, 1, 2], [2, 1, 0, 0], [0, 0, 0, 0]], np.int8)
    found = repair_layout(layout, rules)
    assert (found.layout == layout).all()
    assert (found.cost, found.status) == (0, RepairStatus.OPTIMAL)


def test_seeds_and_batches():
    rules = yard(8, 9, 14, 14)
    layout = np.full((8, 9), 2, np.int8)
    one, again, other = (repair_layout(layout, rules, seed, FULL) for seed in (1, 1, 2))
    assert (one.layout == again.layout).all()
    assert (one.layout != other.layout).any()
    assert one.cost == other.cost


@pytest.mark.parametrize("shelves", [0, 1, 8, 16])
def test_any_possible_number_of_shelves_is_reached(shelves):
    rules = find_domain("warehouse-even").resized(6, 9, {"shelves": shelves}).rules()
    assert impossible(rules) is None
    for tile in range(3):
        layout = np.where(rules.allowed[..., tile], tile, rules.allowed.argmax(-1)).astype(np.int8)
        found = repair_layout(layout, rules, 0, RepairConfig("none"))
        assert audit(found.layout, rules) == []


def test_impossible_rules_return_at_once():
    layout = np.zeros((3, 3), np.int8)
    found = repair_layout(layout, yard(3, 3, 9, 9))
    assert found.status == RepairStatus.IMPOSSIBLE
    assert (found.layout == layout).all() and np.isinf(found.cost)


@pytest.mark.parametrize("name", ["moves_per_cell", "node_limit", "workers"])
def test_a_negative_limit_is_refused(name):
    with pytest.raises(InputError, match=f"{name.replace('_', '-')} must be at least 0, not -1"):
        RepairConfig(**{name: -1})


def test_moves_grow_with_the_cells_and_with_the_polish():
    assert RepairConfig("none").count_moves(4000) == 4000 * 400
    assert RepairConfig("quick").count_moves(4000) == 4000 * 1400
    assert RepairConfig("quick", moves_per_cell=7).count_moves(4000) == 4000 * 7
    assert RepairConfig("full").count_moves(4000) == 4000 * 2500
    assert RepairConfig("full").count_moves(1) == 20_000


def test_only_full_uses_the_solver(monkeypatch):
    used = []
    monkeypatch.setattr(recipe, "improve", lambda *given: used.append("improve") or given[2])
    monkeypatch.setattr(WindowSearch, "run", lambda self, *_: used.append("run") or self.candidate)
    layout = np.full((8, 9), 2, np.int8)
    for level in MOVES_PER_CELL:
        used.append(level)
        repair_layout(layout, yard(8, 9, 14, 14), 0, RepairConfig(level))
    assert used == ["none", "quick", "full", "run", "improve"]


@pytest.mark.slow
def test_a_large_layout_is_bounded_without_branching(monkeypatch):
    """One step of branching on a large factory takes minutes that nothing can interrupt."""
    monkeypatch.setattr(highs, "run_limited", lambda *given: pytest.fail("it branches"))
    monkeypatch.setattr(highs, "_MAX_GAP", 1.0)  # even where the bound is far
    monkeypatch.setattr(highs, "_BRANCHED_CELLS", 3000)
    layout = np.random.default_rng(0).integers(0, 5, (57, 58)).astype(np.int8)
    found = repair_layout(layout, factory(57, 58), 0, RepairConfig("full", moves_per_cell=300))
    assert 0 < found.lower_bound < found.cost
    assert audit(found.layout, factory(57, 58)) == []


def test_progress_is_reported_and_changes_nothing():
    layout, told = np.full((8, 9), 2, np.int8), []
    rules = yard(8, 9, 14, 14)
    found = repair_layout(
        layout, rules, 0, FULL, lambda step, share, note: told.append((step, share))
    )
    assert [doing for doing, _ in told if doing == "annealing"]
    assert told[0][1] <= 1 and {"solving windows"} <= {doing for doing, _ in told}
    assert (found.layout == repair_layout(layout, rules, 0, FULL).layout).all()


SLANTED_SHELVES = """
..@ee@e@ee@e@e..
w.@.@e.@e@.e@..w
..e.@e@.e@.@....
..e@ee@e@ee@e@..
w.e@.@..@.@e.@.w
..@..@.@e.@e@...
..@e@ee@e@ee@e..
w.e.@e@.e@.@...w
..e@.e@.@..@.@..
"""
SLANTED_STATIONS = """
2eeee2eeee
e.2e..e2.e
e..e2.e..2
e2eeee2eee
e..2..e.2e
2..e.2e..e
ee2eeee2ee
"""


@pytest.mark.parametrize(
    ("drawing", "domain", "shelves", "best"),
    [(SLANTED_SHELVES, "warehouse-even", 20, 26), (SLANTED_STATIONS, "manufacturing", 0, 5)],
)
def test_drawn_layouts_are_repaired_to_the_proven_optimum(drawing, domain, shelves, best):
    kind = find_domain(domain)
    layout = parse(drawing.split(), kind.tiles)
    numbers = {"shelves": shelves} if "shelves" in kind.counted else {}
    rules = kind.resized(*layout.shape, numbers).rules()
    found = repair_layout(layout, rules, 0, RepairConfig("full", moves_per_cell=500))
    assert (found.cost, found.lower_bound) == (best, best)
    assert found.status == RepairStatus.OPTIMAL
    assert audit(found.layout, rules) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "domain", "best"),
    [
        ("warehouse_even_nca_a5_unrepaired", "warehouse-even", 32),
        ("warehouse_uneven_nca_a5_unrepaired", "warehouse-even", 147),
        ("manufacturing_nca_a5_unrepaired", "manufacturing", 147),
    ],
)
def test_published_layouts_are_repaired_to_the_proven_optimum(name, domain, best, published):
    found = repaired_in_full(published(name), domain)
    assert found == (best, best, RepairStatus.OPTIMAL, [])


@pytest.mark.parametrize(
    ("name", "best"), [("warehouse_even_unrepaired", 145), ("warehouse_uneven_unrepaired", 252)]
)
def test_our_own_layouts_are_repaired_to_the_proven_optimum(name, best, own_layout):
    found = repaired_in_full(own_layout(name), "warehouse-even")
    assert found == (best, best, RepairStatus.OPTIMAL, [])


def repaired_in_full(path: Path, domain: str) -> tuple:
    """Repair a layout file of size S; returns cost, bound, status and broken rules."""
    rules = find_domain(domain).rules()
    layout = read_layout(path, rules.tiles)
    found = repair_layout(layout, rules, 0, RepairConfig("full", moves_per_cell=500))
    return found.cost, found.lower_bound, found.status, audit(found.layout, rules)


def test_the_solver_prints_nothing(capfd):
    new_solver(0).run()
    assert capfd.readouterr() == ("", "")
