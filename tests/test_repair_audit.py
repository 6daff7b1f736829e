"""The audit: golden drawings, and agreement with a slow plain-Python oracle."""

import itertools
from functools import partial

import numpy as np
import pytest
import small_yard

from qdenv.domains.base import find_domain
from qdenv.grid import parse
from qdenv.repairs.audit import audit
from qdenv.repairs.rules import Facts, bound_cost, impossible
from qdenv.types import Rules

TILES = ".@ew"
yard = partial(small_yard.yard, tiles=TILES)


def shelved(shelves: int) -> Rules:
    """The even warehouse of size S with another number of shelves."""
    return find_domain("warehouse-even").resized(33, 36, {"shelves": shelves}).rules()


def broken(drawing: list[str], rules: Rules) -> list[tuple[str, tuple[int, int]]]:
    found = audit(parse(drawing, TILES), rules)
    return [(one.message, tuple(one.cells[0].tolist())) for one in found]


def test_a_good_layout_breaks_nothing():
    assert broken(["..@e", "e@..", "...."], yard(3, 4, 2, 2)) == []


@pytest.mark.parametrize(
    ("drawing", "start", "cell"),
    [
        (["..@e", "....", "...."], "1 '@' where the rules demand exactly 2", (0, 2)),
        (["..@.", "e@..", "...."], "'@' without 'e' beside it: 1 cell, row 0, column 2", (0, 2)),
        (["..@e", "e@.e", "...."], "'e' without '@' beside it: 1 cell, row 1, column 3", (1, 3)),
        ([".e@.", ".@e.", "...."], None, None),
        (
            ["e@e.", "@...", "...."],
            "the driving area is in 2 unconnected parts, cut off: 1 cell, row 0, column 0",
            (0, 0),
        ),
        (
            ["w@e.", "e@..", "...."],
            "'w' where only '.', '@' or 'e' may stand: 1 cell, row 0, column 0",
            (0, 0),
        ),
    ],
)
def test_each_rule_is_named_with_a_cell_that_breaks_it(drawing, start, cell):
    found = broken(drawing, yard(3, 4, 2, 2))
    if start is None:
        assert found == []
    else:
        assert (start, cell) in found


def test_messages_call_tiles_by_their_names_and_count_each_kind():
    drawing = ["....", "w..w", "...."]
    names = find_domain("warehouse-even").names
    allowed = np.eye(4, dtype=bool)[[[3, 0, 0, 3]] * 3]
    rules = yard(3, 4, 3, 3, allowed=allowed, names=names, adjacency=())
    assert [message for message, _ in broken(drawing, rules)] == [
        "floor where only workstations may stand: 4 cells, the first at row 0, column 0",
        "0 shelves where the rules demand exactly 3",
    ]
    mixed = broken(["w.ww", ".www", "w..w"], rules)[0]
    assert mixed == (
        "workstation where only floor may stand: 3 cells, the first at row 0, column 2; "
        "floor where only workstations may stand: 1 cell, row 1, column 0",
        (0, 2),
    )
    wrong = audit(parse(drawing, TILES), rules)[0].cells
    assert wrong.tolist() == [[0, 0], [0, 3], [2, 0], [2, 3]]


def test_count_messages_name_the_bound():
    assert "at least 3" in broken(["@e.."], yard(1, 4, 3, None))[0][0]
    assert "2 to 3" in broken(["@e.."], yard(1, 4, 2, 3))[0][0]


def test_narrow_passages_are_found():
    wide = ["......", "......", "..@@..", "..ee..", "......"]
    rules = yard(5, 6, 2, 2).buildable(2)
    assert broken(wide, rules) == []
    slit = ["......", "......", "@@.@@@", "ee.eee", "......"]
    assert broken(slit, yard(5, 6, 5, 5).buildable(2)) == [
        ("aisle narrower than 2 cells: 1 cell, row 2, column 2", (2, 2))
    ]


def test_a_wrong_shape_is_one_message():
    assert len(audit(np.zeros((2, 2), np.int8), yard(3, 4, 2, 2))) == 1


def slow_feasible(layout: np.ndarray, rules: Rules) -> bool:
    """Check with loops and a flood fill."""
    rows, cols = layout.shape
    symbol = {(r, c): TILES[layout[r, c]] for r in range(rows) for c in range(cols)}

    def around(cell):
        r, c = cell
        return [symbol[n] for n in ((r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)) if n in symbol]

    for (r, c), tile in symbol.items():
        if not rules.allowed[r, c, TILES.index(tile)]:
            return False
        for rule in rules.adjacency:
            if tile in rule.tiles and not set(around((r, c))) & set(rule.needs):
                return False
    for bound in rules.counts:
        count = sum(tile in bound.tiles for tile in symbol.values())
        if count < bound.low or (bound.high is not None and count > bound.high):
            return False
    group = {cell for cell, tile in symbol.items() if tile in rules.connected}
    front = [next(iter(group))] if group else []
    seen = set(front)
    while front:
        r, c = front.pop()
        for n in ((r + 1, c), (r - 1, c), (r, c + 1), (r, c - 1)):
            if n in group and n not in seen:
                seen.add(n)
                front.append(n)
    return seen == group


@pytest.mark.slow
def test_audit_agrees_with_the_slow_oracle_on_every_tiny_layout():
    rules = yard(2, 4, 1, 2)
    layouts = [
        np.array(tiles, np.int8).reshape(2, 4) for tiles in itertools.product(range(3), repeat=8)
    ]
    feasible = [slow_feasible(layout, rules) for layout in layouts]
    assert feasible == [not audit(layout, rules) for layout in layouts]
    assert (len(feasible), sum(feasible)) == (3**8, 236)


@pytest.mark.parametrize(
    ("rules", "words"),
    [
        (yard(3, 4, 13, 13), "at most 12 fit"),
        (yard(3, 4, 5, 3), "at least 5 and at most 3"),
        (yard(9, 9, 60, 60), "connected driving area can reach at most"),
        (shelved(800), "reach at most 726"),
        (shelved(5000), "at most 1056 fit"),
    ],
)
def test_impossible_rules_are_named(rules, words):
    assert words in impossible(rules)


def test_fixed_obstacles_that_cut_fixed_cells_apart_are_named():
    allowed = np.ones((3, 5, 4), bool)
    allowed[:, 2] = [False, True, False, False]
    allowed[1, [0, 4]] = [False, False, False, True]
    assert "cut row 1, column 4 off" in impossible(yard(3, 5, 3, 6, allowed=allowed))


def test_possible_rules_are_not_called_impossible():
    for shelves in (0, 240, 704):
        assert impossible(shelved(shelves)) is None
    assert impossible(find_domain("manufacturing").resized(33, 36).rules()) is None


def test_the_bound_counts_missing_and_surplus_tiles_at_the_cheapest_cells():
    layout = parse(["@@e.", "....", "...."], TILES)
    costs = np.arange(1.0, 13.0).reshape(3, 4)
    assert bound_cost(layout, Facts(yard(3, 4, 4, 4, change_cost=costs))) == 3 + 4
    assert bound_cost(layout, Facts(yard(3, 4, 1, 1, change_cost=costs))) == 1


def test_shelves_outside_of_racks_are_found():
    rules = yard(6, 6, 8, 8).buildable(rack=(2, 3))
    drawn = ["eeee..", "@@@@..", "@@@@..", "eeee..", "......", "......"]
    assert broken(drawn, rules) == []
    upright = ["e@@e..", "e@@e..", "e@@e..", "e@@e..", "......", "......"]
    assert broken(upright, rules) == []
    ragged = ["eeee..", "@@@@..", "@@@.e.", "eee.@.", "......", "......"]
    assert broken(ragged, rules) == [
        ("'@' in no rack of 2 x 3: 2 cells, the first at row 1, column 3", (1, 3))
    ]


def test_straight_aisles_lie_between_so_many_rows_and_columns():
    rules = yard(7, 6, 0, None, adjacency=()).buildable(cross_aisle=2)
    drawing = ["@.....", "...@..", "......", "@@....", "....@.", "@.....", "......"]
    rows = "'@' in 3 or more rows without a straight aisle: 4 cells, the first at row 3, column 0"
    assert broken(drawing, rules) == [(rows, (3, 0))]
    turned = ["".join(one) for one in zip(*drawing, strict=True)]
    ((columns, _),) = broken(turned, yard(6, 7, 0, None, adjacency=()).buildable(cross_aisle=2))
    assert columns == rows.replace("rows", "columns").replace("row 3, column 0", "row 0, column 3")
    rules.allowed[3:6, 0] = [False, True, False, False]
    assert impossible(rules) == "'@' that stay leave no straight aisle in rows 3 to 5"


def test_racks_with_aisles_on_both_sides_are_one_or_two_deep():
    rules = yard(5, 9, 0, None, adjacency=()).buildable(both_sides=True)
    assert broken([".........", ".@@@@.@@.", ".@@@@....", ".........", "........."], rules) == []
    drawing = ["..@@@.@.@", "....@.@..", "..@......", "......@@.", "......@@."]
    lost = "'@' in no rack with aisles on both sides: 4 cells, the first at row 0, column 2"
    assert broken(drawing, rules) == [(lost, (0, 2))]


def test_what_is_fixed_breaks_no_rule_on_aisles_and_racks():
    """A door one cell wide in a wall, and a column that was there before."""
    rules = yard(5, 6, 0, None, adjacency=()).buildable(2, (2, 2))
    rules.allowed[2] = [False, True, False, False]
    rules.allowed[2, 3] = [True, False, False, False]
    assert broken(["......", "......", "@@@.@@", "......", "......"], rules) == []
    assert broken([".@....", "......", "@@@.@@", ".....@", "....@@"], rules) == [
        ("aisle narrower than 2 cells: 4 cells, the first at row 0, column 0", (0, 0)),
        ("'@' in no rack of 2 x 2: 4 cells, the first at row 0, column 1", (0, 1)),
    ]


MUST = "the number of '@' must be"


@pytest.mark.parametrize(
    ("numbers", "aisle", "rack", "reason"),
    [
        ((5, 5), 1, (2, 3), f"{MUST} at most 5 but racks of 2 x 3 take 6"),
        ((40, None), 1, (2, 9), f"{MUST} at least 40 but racks of 2 x 9 have room for at most 0"),
        ((36, None), 2, None, f"{MUST} at least 36 but aisles 2 cells wide can reach at most 34"),
        ((9, 9), 1, (2, 2), f"{MUST} 9 but racks 2 cells deep hold an even number"),
        ((9, None), 1, (3, 3), "in racks of 3 x 3 the middle has no 'e' beside it"),
    ],
)
def test_aisles_and_racks_that_nothing_can_obey_are_named(numbers, aisle, rack, reason):
    rules = yard(8, 8, *numbers)
    assert impossible(rules) is None
    assert impossible(rules.buildable(aisle, rack)) == reason
