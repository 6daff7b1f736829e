"""What is risky about a layout: slow oracles on random layouts, and golden drawings."""

import numpy as np
from scipy import ndimage

from qdenv.domains.base import find_domain
from qdenv.grid import LEFT, RIGHT, parse
from qdenv.repairs.audit import audit
from qdenv.study.diagnosis import cut_off, dead_ends, diagnose, narrow_aisles
from qdenv.study.plans import Plan
from qdenv.view.change import draw_diagnosis
from qdenv.view.style import save_figure

RNG = np.random.default_rng(0)
AREAS = [RNG.random(RNG.integers(1, 9, 2)) < share for share in (0.5, 0.65, 0.8) for _ in range(60)]
WAREHOUSE = find_domain("warehouse-even")


def neighbours(row, col):
    return ((row, col + 1), (row, col - 1), (row + 1, col), (row - 1, col))


def test_cut_off_agrees_with_removing_each_cell_and_counting_what_hangs_together():
    for area in AREAS:
        counted = area & (RNG.random(area.shape) < 0.7)
        found = cut_off(area, counted)
        labels, _ = ndimage.label(area)
        for row, col in np.ndindex(area.shape):
            lost = 0
            if area[row, col]:
                rest = labels == labels[row, col]
                rest[row, col] = False
                parts, _ = ndimage.label(rest)
                sizes = [int((counted & (parts == one)).sum()) for one in range(1, parts.max() + 1)]
                lost = sum(sizes) - max(sizes, default=0)
            assert found[row, col] == lost


def test_dead_ends_agree_with_taking_cells_away_one_by_one():
    for area in AREAS:
        left = {tuple(cell) for cell in np.argwhere(area).tolist()}
        while ends := [one for one in left if sum(n in left for n in neighbours(*one)) <= 1]:
            left.remove(ends[0])
        slow = area.copy()
        for cell in left:
            slow[cell] = False
        assert (dead_ends(area) == slow).all()


def test_narrow_aisles_are_the_cells_of_no_square_of_four():
    for area in AREAS:
        rows, cols = area.shape
        wide = np.zeros_like(area)
        for row, col in np.ndindex(max(rows - 1, 0), max(cols - 1, 0)):
            if area[row : row + 2, col : col + 2].all():
                wide[row : row + 2, col : col + 2] = True
        assert (narrow_aisles(area) == (area & ~wide)).all()


def test_a_lane_is_no_two_way_aisle():
    area = np.ones((1, 6), bool)
    costs = np.ones((5, 1, 6))
    costs[LEFT, :, 3:] = 4.0
    assert narrow_aisles(area, costs).tolist() == [[True, True, True, False, False, False]]
    costs[LEFT] = np.inf
    assert not narrow_aisles(area, costs).any()
    costs[RIGHT] = np.inf
    assert narrow_aisles(area, np.ones((5, 1, 6))).all()


DRAWING = [
    "w....@...",
    ".....@...",
    "@@@.@@...",
    "........@",
    "w.......w",
    "...@....@",
    "@@@@.@@@@",
    "@@@@.@@@@",
]


def test_risks_are_named_in_words_with_a_place():
    plan = Plan("plan", parse(DRAWING, WAREHOUSE.tiles), WAREHOUSE, False)
    found = diagnose(plan)
    assert [one.message for one in found] == [
        "dead-end aisles: 1, 2 cells in all, the longest at row 6, column 4",
        "cells whose loss cuts the hall in two: 3, the worst at row 3, column 3 with 11 cells "
        "behind it",
        "two-way aisles one robot wide: 9% of the floor, 4 cells, the first at row 2, column 3",
        "stations with one access only: 1, the first at row 4, column 8",
    ]
    assert found[1].cells.tolist() == [[1, 3], [2, 3], [3, 3]]
    assert diagnose(plan._replace(layout=np.zeros((4, 4), np.int8))) == []
    maze = find_domain("maze-walls")
    assert diagnose(Plan("maze", np.zeros((4, 4), np.int8), maze, False)) == []


def test_the_picture_marks_each_kind_and_says_what_it_is(tmp_path):
    plan = Plan("plan", parse(DRAWING, WAREHOUSE.tiles), WAREHOUSE, False)
    broken = audit(plan.layout, plan.fitted().rules())
    remarks = diagnose(plan)
    figure = draw_diagnosis(plan, broken, remarks)
    (legend,) = figure.legends
    texts = [text.get_text().replace("\n", " ") for text in legend.get_texts()]
    assert sorted(texts) == sorted(one.message for one in [*broken, *remarks])
    marked = [len(one.get_paths()) for one in figure.axes[0].collections]
    assert sorted(marked) == sorted(len(one.cells) for one in [*broken, *remarks])
    save_figure(figure, tmp_path / "check.png", crop=True)
    (nothing,) = draw_diagnosis(plan, [], []).legends
    assert nothing.get_texts()[0].get_text() == "nothing to remark"
