"""The annealer: its tables and its bookkeeping against slow recomputation."""

import itertools

import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError
from scipy import ndimage

from qdenv.domains.base import find_domain
from qdenv.native import kernel
from qdenv.repairs.anneal.connectivity import RING_PIECES, join_pieces, may_close
from qdenv.repairs.anneal.loop import anneal, anneal_periods
from qdenv.repairs.anneal.packing import draw_templates
from qdenv.repairs.anneal.start import compile_board, initial_covers, initial_state, project
from qdenv.repairs.anneal.state import MOST, AnnealState, Board, Move, Schedule, Trait
from qdenv.repairs.audit import audit
from qdenv.repairs.rules import Facts
from qdenv.types import Adjacency, Count, InputError, Rules


def mixed_rules() -> Rules:
    """Three kinds of station counted apart, a fixed door, a keep-out and uneven weights."""
    allowed = np.ones((9, 10, 5), bool)
    allowed[0, 0] = [True, False, False, False, False]
    allowed[4, 4:7, 1:4] = False
    weights = np.ones((9, 10))
    weights[:, :3] = 2
    return Rules(
        tiles=".012e",
        counts=(Count("0", 2, 4), Count("12", 3, None), Count("e", 1, 40)),
        adjacency=(Adjacency("012", "e"), Adjacency("e", "012")),
        connected=".e",
        allowed=allowed,
        change_cost=weights,
    )


def test_ring_table_agrees_with_labelling():
    places = [(0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0)]
    for pattern, pieces in enumerate(RING_PIECES):
        ring = np.zeros((3, 3), bool)
        for bit, place in enumerate(places):
            ring[place] = pattern >> bit & 1
        labels, _ = ndimage.label(ring)
        sides = {labels[place] for place in places[::2] if ring[place]}
        assert pieces == len(sides), pattern


def test_tiles_alike_share_a_role():
    assert Facts(find_domain("manufacturing").resized(5, 5).rules()).roles == [[0], [1, 2, 3], [4]]
    assert Facts(find_domain("warehouse-even").resized(5, 9, {"shelves": 2}).rules()).roles == [
        [0],
        [1],
        [2],
        [3],
    ]
    assert Facts(mixed_rules().buildable(rack=(2, 2), of="0")).roles == [[0], [1], [2, 3], [4]]


def test_facts_follow_from_the_rules():
    facts = Facts(mixed_rules())
    assert facts.driving.tolist() == [True, False, False, False, True]
    assert facts.demands.tolist() == [0, 1, 1, 1, 1]
    assert facts.needs == [[], ["e"], ["e"], ["e"], ["012"]]
    assert facts.count_bounds.tolist() == [[2, 4], [3, 90], [1, 40]]
    assert (facts.free_cells, int((~facts.free).sum())) == (89, 1)
    assert np.argwhere(~facts.may("012")).tolist() == [[0, 0], [4, 4], [4, 5], [4, 6]]
    assert np.argwhere(facts.must(".e")).tolist() == [[0, 0], [4, 4], [4, 5], [4, 6]]
    assert facts.cost(np.ones((9, 10), np.int8), np.zeros((9, 10), np.int8)) == 90 + 27


def plan_of(moves: int) -> Schedule:
    """Plan a hot run of a hundred periods."""
    period = max(moves // 100, 1)
    count = max(-(-moves // period), 1)
    return Schedule((2.0, 1.0), (0.5, 0.5), moves, period, count)


def empty_move() -> Move:
    return Move(*np.zeros((3, MOST), np.int64))


@pytest.mark.parametrize(("aisle", "rack"), [(1, None), (2, None), (1, (1, 3)), (2, (2, 4))])
def test_bookkeeping_and_connectivity_survive_thousands_of_moves(aisle, rack):
    rules = mixed_rules().buildable(aisle, rack, of="012")
    rng = np.random.default_rng(0)
    for seed in range(4):
        layout = rng.integers(0, 5, (9, 10)).astype(np.int8)
        facts = Facts(rules)
        board = compile_board(layout, facts)
        candidate = project(board, layout, rng)
        for moves in (0, 3000):
            covers, plan = initial_covers(board, candidate, facts), plan_of(moves)
            state, word = initial_state(board, candidate, covers), np.uint64(seed)
            anneal_periods(board, state, covers, empty_move(), plan, word, 0, plan.periods)
            assert (state.candidate != candidate).any() == (moves > 0)
            fresh_covers = initial_covers(board, state.candidate, facts)
            fresh = initial_state(board, state.candidate, fresh_covers)
            for field in ("ring", "tally", "counts"):
                assert (getattr(state, field) == getattr(fresh, field)).all(), field
            assert (covers is None) == (aisle == 1 and rack is None)
            for followed, counted in zip(covers or (), fresh_covers or (), strict=True):
                assert (followed == counted).all()
            assert (state.cost, state.violations) == (fresh.cost, fresh.violations)
            driving = board.traits[state.candidate, Trait.DRIVES].reshape(11, 12) == 1
            assert ndimage.label(driving)[1] == 1
            differs = np.flatnonzero(state.candidate != board.layout)
            assert sorted(state.changed[: state.num_changed]) == differs.tolist()


def test_the_best_layout_costs_what_was_noted_for_it():
    """`best` follows by differences; the sum of its changes tells whether it lost one."""
    facts = Facts(mixed_rules())
    layout = np.random.default_rng(3).integers(0, 5, (9, 10)).astype(np.int8)
    board = compile_board(layout, facts)
    state = initial_state(board, project(board, layout, np.random.default_rng(0)))
    noted = set()
    plan = plan_of(200_000)._replace(temperatures=(1.0, 0.1), penalty_weights=(1.0, 3.0))
    for period in range(plan.periods):
        anneal_periods(board, state, None, empty_move(), plan, np.uint64(3), period, period + 1)
        if np.isfinite(state.best_cost):
            best = state.best.reshape(11, 12)[1:-1, 1:-1].copy()
            assert (
                facts.cost(best, layout) == float(state.best_cost)
                and audit(best, facts.rules) == []
            )
            noted.add(float(state.best_cost))
    assert len(noted) > 3


def test_a_run_cut_into_pieces_goes_the_same_way():
    layout = np.random.default_rng(1).integers(0, 5, (9, 10)).astype(np.int8)
    board, ended = compile_board(layout, Facts(mixed_rules())), []
    for cuts in ([0, 100], [0, 1, 37, 99, 100]):
        state = initial_state(board, project(board, layout, np.random.default_rng(0)))
        for first, last in itertools.pairwise(cuts):
            word = np.uint64(7)
            anneal_periods(board, state, None, empty_move(), plan_of(5000), word, first, last)
        ended.append(state)
    for field, other in zip(*ended, strict=True):
        assert (field == other).all()


@pytest.mark.slow
@pytest.mark.parametrize("open_share", [0.5, 0.6, 0.75])
def test_walkers_find_what_labelling_finds(open_share):
    """Every cell of random mazes: may it close without cutting the driving area in two?"""
    rng, asked, walked = np.random.default_rng(int(100 * open_share)), 0, 0
    for _ in range(60):
        layout = np.where(rng.random((9, 10)) < open_share, 0, 1).astype(np.int8)
        board = compile_board(layout, Facts(open_rules(9, 10)))
        candidate = project(board, layout, rng)
        state = initial_state(board, candidate)
        driving = board.traits[candidate, Trait.DRIVES].reshape(11, 12) == 1
        for cell in np.flatnonzero(driving):
            without = driving.copy()
            without.ravel()[cell] = False
            alone = driving.sum() == 1
            expected = ndimage.label(without)[1] == 1 and not alone
            assert ask_walkers(board, state, cell) == expected
            asked += 1
            walked += RING_PIECES[state.ring[cell]] > 1
    assert asked > 2000 and walked > 400


@numba.njit
def ask_walkers(board: Board, state: AnnealState, cell: int) -> bool:
    return may_close(board, state, cell)


def open_rules(rows: int, cols: int) -> Rules:
    """Nothing but one driving area."""
    everything = np.ones((rows, cols, 2), bool)
    return Rules(".@", (), (), ".", everything, np.ones((rows, cols)))


def test_pieces_are_joined_by_the_shortest_ways():
    drawing = ["..@@.", "@@@@@", ".@@@@", "@@.@@"]
    driving = np.pad(np.array([[tile == "." for tile in row] for row in drawing]), 1).ravel()
    may_open = np.pad(np.ones((4, 5), bool), 1).ravel()
    joined, hanging = join_pieces(driving, may_open, root=8, stride=7)
    # Two cells to the right, one down, and from there two on to the right.
    assert (joined & ~driving).sum() == 5
    assert (hanging == joined).all()
    assert ndimage.label(joined.reshape(6, 7))[1] == 1
    may_open[3 * 7 : 5 * 7] = False
    joined, hanging = join_pieces(driving, may_open, root=8, stride=7)
    assert np.flatnonzero(joined & ~hanging).tolist() == [31]


def test_the_initial_state_counts_the_same_breaches_as_the_audit_finds():
    layout = np.zeros((9, 10), np.int8)
    layout[2, 2:5] = [1, 4, 2]
    layout[6, 6] = 4  # an endpoint without a station; one 0 and two of 1 and 2 are missing
    board = compile_board(layout, Facts(mixed_rules()))
    start = project(board, layout, np.random.default_rng(0))
    assert initial_state(board, start).violations == 1 + 1 + 2


def test_same_seed_same_layout_and_cost():
    rules = mixed_rules()
    layout = np.full((9, 10), 4, np.int8)
    one, cost = anneal(layout, Facts(rules), 7, 20000, layout)
    two, _ = anneal(layout, Facts(rules), 7, 20000, layout)
    assert (one == two).all()
    assert cost == (rules.change_cost * (one != layout)).sum()
    assert audit(one, rules) == []


def hard_layouts(domain, rows: int, cols: int) -> list[np.ndarray]:
    """Draw layouts that are far from any rule, for each pair of neighbouring tiles."""
    down, right = np.indices((rows - 2 * domain.margin[0], cols - 2 * domain.margin[1]))
    rng, kinds, drawn = np.random.default_rng(5), len(domain.generated), []
    for first in range(kinds):
        second = (first + 1) % kinds
        pockets = (down % 3 == 0) | (right % 3 == 0)
        slanted = (down + 2 * right) % 5 < 2
        specks = rng.random(down.shape) < 0.01
        drawn += [np.where(mask, first, second) for mask in (pockets, slanted, specks)]
        drawn.append(rng.integers(0, kinds, down.shape))
    return [np.asarray(domain.frame(inside.astype(np.int8))) for inside in drawn]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["warehouse-even", "manufacturing"])
def test_hard_layouts_become_feasible_with_few_moves(name):
    domain = find_domain(name)
    facts = Facts(domain.rules())
    layouts = hard_layouts(domain, 33, 36)
    assert len(layouts) >= 12
    for layout in layouts:
        found, _ = anneal(layout, facts, 0, 200_000, layout)
        assert found is not None and audit(found, facts.rules) == []


@pytest.mark.parametrize("shelves", [0, 1, 240, 600, 704])
def test_one_of_the_templates_obeys_the_rules_at_any_number_of_shelves(shelves):
    rules = find_domain("warehouse-even").resized(33, 36, {"shelves": shelves}).rules()
    layout = np.where(rules.allowed[..., 0], 0, 3).astype(np.int8)
    assert min(len(audit(drawn, rules)) for drawn in draw_templates(layout, Facts(rules))) == 0


def test_a_kernel_that_makes_an_array_is_refused():
    @kernel
    def makes_one():
        return np.zeros(3).sum()

    with pytest.raises(NumbaError):
        makes_one()


def test_too_many_kinds_are_refused_in_one_line():
    allowed = np.ones((9, 10, 21), bool)
    rules = mixed_rules()._replace(tiles="abcdefghijklmnopqrstu", allowed=allowed)
    rules = rules._replace(counts=(), adjacency=())
    with pytest.raises(InputError, match="at most 20 kinds of tile"):
        compile_board(np.zeros((9, 10), np.int8), Facts(rules))


def test_too_many_needs_are_refused_in_one_line():
    pairs = tuple(Adjacency("0", other) for other in ("1", "2", "e", ".", "12", "1e", "2e", "12e"))
    with pytest.raises(InputError, match="at most 7 different neighbours"):
        compile_board(np.zeros((9, 10), np.int8), Facts(mixed_rules()._replace(adjacency=pairs)))


def test_free_changes_are_no_division_by_zero():
    rules = mixed_rules()._replace(change_cost=np.zeros((9, 10)))
    layout = np.full((9, 10), 4, np.int8)
    found, cost = anneal(layout, Facts(rules), 0, 20000, layout)
    assert cost == 0 and audit(found, rules) == []
