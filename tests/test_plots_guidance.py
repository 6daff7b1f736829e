"""Arrows of guidance, and of what agents drove, point the way that the numbers say."""

import numpy as np
import pytest
from matplotlib.image import imread
from matplotlib.quiver import Quiver

from qdenv.grid import DOWN, LEFT, MOVES, RIGHT, UP, WAIT
from qdenv.guidance import crisscross, fixed_costs
from qdenv.view.guidance import ARROWS, draw_guidance, pack_arrows, preferences, share_along
from qdenv.view.style import save_figure

FREE = np.array([[1, 1, 1], [1, 0, 1], [1, 1, 1]], bool)  # a ring
ONES, STILL = np.ones((5, 3, 3)), np.zeros((5, 3, 3))


def arrows(axes):
    """List the arrows of a panel by the cell they leave: (row, column) -> colours and moves."""
    (drawn,) = (one for one in axes.collections if isinstance(one, Quiver))
    found = {}
    for (x, y), right, down, colour in zip(
        drawn.XY, drawn.U, drawn.V, drawn.get_facecolors(), strict=True
    ):
        step = (int(np.sign(down)), int(np.sign(right)))
        cell = round(y - 0.5 * step[0]), round(x - 0.5 * step[1])
        found[(*cell, MOVES.index(step) + 1)] = colour
    return found


def test_the_cheaper_way_is_that_of_the_lower_cost():
    costs = ONES.copy()
    costs[LEFT, 0, 2] = 4.0  # from the corner back to the left
    costs[DOWN, 0, 0], costs[UP, 1, 0] = 4.0, 0.5
    expected = np.zeros((2, 3, 3))
    expected[0, 0, 1], expected[1, 0, 0] = 2.0, -3.0
    np.testing.assert_array_equal(preferences(costs, FREE), expected)
    # Into walls and out of the layout no way leads, whatever it would cost.
    costs[RIGHT, 1, 0], costs[UP, 0, 1], costs[RIGHT, 2, 2] = 0.1, 0.1, 0.1
    np.testing.assert_array_equal(preferences(costs, FREE), expected)
    assert set(arrows(draw_guidance(FREE, costs, STILL, "").axes[0])) == {(0, 1, RIGHT), (1, 0, UP)}


@pytest.mark.parametrize("closed", [np.inf, 0.0])
def test_a_one_way_lane_is_stronger_than_any_cost(closed):
    """Infinite in costs as they are stated, zero in those that fleets drive by."""
    costs = np.full((5, 3, 3), 64.0)
    costs[LEFT, 0, 1], costs[RIGHT, 2, 0], costs[LEFT, 2, 1] = closed, 1.0, 1023.0
    preferred = preferences(costs, FREE)
    assert preferred[0, 0, 0] > preferred[0, 2, 0] > 9
    fixed = preferences(fixed_costs(crisscross(FREE), FREE), FREE)
    np.testing.assert_allclose(fixed, preferences(crisscross(FREE), FREE), atol=0.05)


def test_crisscross_goes_to_the_right_in_even_rows_and_up_in_even_columns():
    figure = draw_guidance(FREE, crisscross(FREE), STILL, "")
    drawn = arrows(figure.axes[0])
    assert set(drawn) == {
        (0, 0, RIGHT), (0, 1, RIGHT), (2, 0, RIGHT), (2, 1, RIGHT),
        (1, 0, UP), (2, 0, UP), (1, 2, UP), (2, 2, UP),
    }  # fmt: skip
    for (_, _, move), colour in drawn.items():
        shade = tuple(int(ARROWS[move - 1][k : k + 2], 16) / 255 for k in (1, 3, 5))
        np.testing.assert_allclose(colour, (*shade, 0.65))  # half of the strongest


def test_the_flow_is_what_more_agents_drive_than_back():
    moves = np.zeros((5, 3, 3))
    moves[RIGHT, 0, 0], moves[LEFT, 0, 1] = 0.5, 0.2
    moves[DOWN, 0, 2], moves[UP, 1, 2] = 0.1, 0.4
    moves[WAIT] = 1.0
    costs = ONES.copy()
    costs[LEFT, 0, 1] = 2.0
    assert share_along(preferences(costs, FREE), moves) == pytest.approx(5 / 7)
    costs[UP, 1, 2] = 2.0  # most agents drive against this one
    assert share_along(preferences(costs, FREE), moves) == pytest.approx(6 / 12)
    assert np.isnan(share_along(preferences(ONES, FREE), moves))
    panels = draw_guidance(FREE, costs, moves, "ring").axes
    assert set(arrows(panels[0])) == {(0, 0, RIGHT), (0, 2, DOWN)}
    flow = arrows(panels[1])
    assert set(flow) == {(0, 0, RIGHT), (1, 2, UP)}
    assert [colour[3] for colour in flow.values()] == pytest.approx([1, 1])  # 0.3 more than back
    assert "darkest: 0.3 more moves" in panels[1].get_xlabel()
    assert panels[1].get_title() == "where agents drove: 50% the cheaper way"


def test_cells_where_waiting_is_dear_are_yellow():
    costs = ONES.copy()
    costs[WAIT, 2, 1] = 9.0
    axes = draw_guidance(FREE, costs, STILL, "").axes[0]
    assert np.argwhere(~axes.images[1].get_array().mask).tolist() == [[2, 1]]
    assert "yellow" in axes.get_xlabel()
    plain = draw_guidance(FREE, crisscross(FREE), STILL, "").axes[0]
    assert len(plain.images) == 1 and "yellow" not in plain.get_xlabel()


def test_a_byte_holds_the_arrows_to_the_right_and_below():
    preferred = np.zeros((2, 1, 3))
    preferred[:, 0] = [[2.0, -9.0, 0.0], [0.0, 1.0, -0.1]]
    packed = pack_arrows(preferred)
    assert packed.dtype == np.uint8 and packed.shape == (1, 3)
    assert (packed >> 4).tolist() == [[15, 1, 8]] and (packed & 15).tolist() == [[8, 12, 8]]


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(3, 200), (200, 3), (1, 1), (101, 102)])
def test_any_shape_can_be_drawn_with_and_without_preferences(shape, tmp_path):
    free = np.ones(shape, bool)
    for costs in (np.ones((5, *shape)), crisscross(free)):
        figure = draw_guidance(free, costs, np.zeros((5, *shape)), "title")
        save_figure(figure, tmp_path / "guidance.png")
        assert imread(tmp_path / "guidance.png").std() > 0
