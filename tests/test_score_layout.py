"""Entropy, components, counts and similarity against plain-numpy oracles and closed forms."""

import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from qdenv import grid, score
from qdenv.domains.base import find_domain
from qdenv.types import InputError

TILES = ".@e"
layouts = hnp.arrays(np.int8, (6, 7), elements=st.integers(0, 2))


def oracle_entropy(area: np.ndarray, kinds: int) -> float:
    rows, cols = area.shape
    windows = [
        tuple(area[r : r + 2, c : c + 2].ravel()) for r in range(rows - 1) for c in range(cols - 1)
    ]
    total = len(windows)
    return -sum(n / total * math.log(n / total, kinds**4) for n in Counter(windows).values())


@settings(max_examples=60, deadline=None)
@given(layouts)
def test_entropy_agrees_with_oracle(area):
    assert float(score.entropy(area, 3)) == pytest.approx(oracle_entropy(area, 3), abs=1e-6)


def test_entropy_closed_forms():
    assert float(score.entropy(np.zeros((9, 9), np.int8), 3)) == 0
    board = np.indices((8, 9)).sum(0).astype(np.int8) % 2  # two patterns, 28 windows each
    assert float(score.entropy(board, 2)) == pytest.approx(math.log(2, 16), abs=1e-6)
    assert float(score.entropy(np.zeros((1, 5), np.int8), 3)) == 0


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(layouts)
def test_components_agree_with_oracle(area):
    assert int(score.components(area, "@", TILES)) == ndimage.label(area == 1)[1]


def test_components_of_a_long_snake():
    rows = ["@@@@@@@", "......@", "@@@@@@@", "@......", "@@@@@@@", ".......", "@.@.@.@"]
    assert int(score.components(grid.parse(rows, TILES), "@", TILES)) == 5


def test_similarity_is_the_share_of_cells_that_stay_where_none_weighs_more():
    even = find_domain("warehouse-even")  # a factory: test_domains_manufacturing
    before, after = grid.parse(["@.@e", "...."], TILES), grid.parse(["@..e", "...."], TILES)
    weights = even.similarity_weights(before)
    assert float(score.similarity(before, after, weights)) == pytest.approx(7 / 8)


def test_text_round_trip_and_errors():
    rows = [".@e", "e.@"]
    assert grid.draw(grid.parse(rows, TILES), TILES) == rows
    with pytest.raises(InputError, match="row 1 of the layout has 2 tiles"):
        grid.parse(["...", ".."], TILES)
    with pytest.raises(InputError, match=r"unknown tile 'x' at row 0, column 1"):
        grid.parse([".x"], TILES)
    with pytest.raises(InputError, match="empty"):
        grid.parse([], TILES)


def test_neighbours_look_the_right_way():
    values = np.arange(6).reshape(2, 3)
    right, left, down, up = (np.asarray(grid.shift(values, move, -1)) for move in grid.MOVES)
    np.testing.assert_array_equal(right, [[1, 2, -1], [4, 5, -1]])
    np.testing.assert_array_equal(left, [[-1, 0, 1], [-1, 3, 4]])
    np.testing.assert_array_equal(down, [[3, 4, 5], [-1, -1, -1]])
    np.testing.assert_array_equal(up, [[-1, -1, -1], [0, 1, 2]])
    np.testing.assert_array_equal(
        grid.count_neighbours(np.array([[1, 1, 0], [0, 1, 0]], bool)), [[1, 2, 1], [2, 1, 1]]
    )
