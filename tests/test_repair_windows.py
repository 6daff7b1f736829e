"""Windows solved with all else fixed: against enumeration, and what they may not break."""

import itertools

import numpy as np
import pytest
from scipy import ndimage
from small_yard import yard

from qdenv.domains.base import find_domain
from qdenv.repairs.anneal.loop import anneal
from qdenv.repairs.audit import audit
from qdenv.repairs.milp import windows
from qdenv.repairs.milp.windows import WindowSearch, stays_connected
from qdenv.repairs.rules import Facts
from qdenv.types import Rules


def poor_start(layout: np.ndarray, facts: Facts) -> tuple[np.ndarray, float]:
    """Repair another layout: feasible, and far from this one; returns its cost as well."""
    start, _ = anneal(layout[::-1, ::-1].copy(), facts, 0, 100_000, layout)
    return start, facts.cost(start, layout)


def best_inside(layout: np.ndarray, start: np.ndarray, rules: Rules, window: tuple) -> float:
    """Enumerate what may stand in a window; returns the least cost of the whole layout."""
    best, shape = np.inf, start[window].shape
    for tiles in itertools.product(range(3), repeat=start[window].size):
        candidate = start.copy()
        candidate[window] = np.reshape(tiles, shape)
        cost = (candidate != layout).sum()
        if cost < best and not audit(candidate, rules):
            best = cost
    return best


@pytest.mark.slow
def test_a_window_is_solved_to_the_optimum_that_enumeration_finds():
    rng, improved = np.random.default_rng(2), 0
    for _ in range(6):
        layout = rng.integers(0, 3, (6, 7)).astype(np.int8)
        facts = Facts(yard(6, 7, 8, 8))
        start, cost = poor_start(layout, facts)
        for corner in ((2, -1), (4, 2)):  # both reach beyond the grid: six cells each
            search = WindowSearch(layout, start, facts, 0)
            search.solver.setOptionValue("mip_max_nodes", 1000)
            gain = search.improve(corner, 3)
            window = tuple(slice(max(low, 0), low + 3) for low in corner)
            assert facts.cost(search.candidate, layout) == cost - gain
            assert cost - gain == best_inside(layout, start, facts.rules, window)
            changed = search.candidate != start
            changed[window] = False
            assert not changed.any() and audit(search.candidate, facts.rules) == []
            improved += gain > 0
    assert improved >= 3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["warehouse-even", "manufacturing"])
def test_windows_never_cost_more_and_never_break_a_rule(name, monkeypatch):
    domain = find_domain(name)
    rng, facts, saved = np.random.default_rng(1), Facts(domain.rules()), 0.0
    for limit, value in (("_SIDE", 6), ("_WINDOWS", 25), ("_REWARD", 0.0)):
        monkeypatch.setattr(windows, limit, value)
    for seed in range(3):
        tiles = rng.choice(len(domain.generated), domain.generated_shape, p=odds(domain))
        layout = np.asarray(domain.frame(tiles.astype(np.int8)))
        start, cost = poor_start(layout, facts)
        one, two = (WindowSearch(layout, start, facts, seed).run() for _ in range(2))
        assert (one == two).all() and audit(one, facts.rules) == []
        search = WindowSearch(layout, one, facts, 0)
        assert (search.counts == np.bincount(one.ravel(), minlength=len(search.counts))).all()
        saved += cost - facts.cost(one, layout)
        assert facts.cost(one, layout) <= cost
    assert saved >= 30


def odds(domain) -> np.ndarray:
    """Mostly empty: few changes are needed."""
    weights = np.array([6.0 if tile == "." else 1.0 for tile in domain.generated])
    return weights / weights.sum()


def test_what_stays_connected_in_a_box_stays_connected_in_the_layout():
    """Random boxes of random driving areas: never a wrong yes, and a right one now and then."""
    rng, agreed, checked = np.random.default_rng(0), 0, 0
    while checked < 300:
        area = rng.random((9, 11)) < 0.7
        labels, _ = ndimage.label(area)
        area = labels == np.bincount(labels[area]).argmax()
        box = (slice(2, 8), slice(3, 9))
        changed = area.copy()
        changed[3:7, 4:8] = rng.random((4, 4)) < 0.7
        edges = np.zeros((6, 6), bool)
        edges[[0, -1]] = edges[:, [0, -1]] = True
        whole = ndimage.label(changed)[1] <= 1
        said = stays_connected(area[box], changed[box], edges)
        assert whole or not said
        agreed += said
        checked += 1
    assert agreed > 50
