"""Pictures of guidance: which way between two cells is the cheaper one, and which one robots drive.

An arrow lies across the border of two free cells and points the preferred way, so that lanes are
seen as lanes and crossings as crossings. It is longer and darker the stronger the preference is.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver

from qdenv.grid import DOWN, RIGHT, WAIT
from qdenv.guidance import backwards, preferences
from qdenv.view import SCREEN
from qdenv.view.style import PALETTE, new_grid, styled

# Colours of arrows to the right, left, down and up, which colour-blind people can distinguish.
ARROWS = PALETTE[:4]
STRONGEST = 2.0  # doublings of the cost beyond which arrows are the same
_LEVELS = 7  # of strength there, and as many back, where an arrow is half a byte
_WALLS = ListedColormap(["#c4c8cd", "#ffffff"])
_YELLOW = ListedColormap([(0.94, 0.89, 0.26, 0.35)])  # a veil
_DEAR = 1.4  # times the average cost of waiting
_CELL = 0.085  # inches of a cell in which an arrow can be read


def share_along(preferred: np.ndarray, moves: np.ndarray) -> float:
    """Return which share of the moves between cells with a cheaper way takes it; NaN for none."""
    there, back = moves[[RIGHT, DOWN]], backwards(moves, 0.0)
    along = np.where(preferred > 0, there, back)[preferred != 0].sum()
    total = (there + back)[preferred != 0].sum()
    return float(along / total) if total else np.nan


def pack_arrows(preferred: np.ndarray) -> np.ndarray:
    """Turn preferences [2, ..., H, W] into a byte per cell (uint8 [..., H, W]), for pages.

    The upper half holds the arrow to the cell at the right, the lower half the one to the cell
    below: 8 for none, 15 and 1 for the strongest ones there and back.
    """
    level = np.rint(_LEVELS * np.clip(preferred / STRONGEST, -1, 1)).astype(np.int8) + 8
    return (16 * level[0] + level[1]).astype(np.uint8)


def aspect_of(free: np.ndarray) -> float:
    """Return the height of a map as a share of its width, within what a page can hold."""
    rows, cols = free.shape
    return float(np.clip(rows / cols, 0.4, 1.6))


@styled
def draw_guidance(free: np.ndarray, costs: np.ndarray, moves: np.ndarray, title: str) -> Figure:
    """Draw which ways are cheaper, and beside it which ways agents drove.

    `free` (bool [H, W]) are the cells that agents may drive on, `costs` ([5, H, W]) those of each
    move, `moves` ([5, H, W]) what `recordings.count_moves` counts.
    """
    side = float(np.clip(_CELL * free.shape[1], SCREEN / 2, SCREEN))  # inches of a panel
    figure, (first, second) = new_grid(2, 2, (side, side * aspect_of(free) + 0.7), (0, 0.3))
    figure.suptitle(title)
    draw_preferences(first, free, costs)
    draw_flow(second, free, costs, moves)
    return figure


def draw_preferences(axes: Axes, free: np.ndarray, costs: np.ndarray) -> None:
    """Draw the cheaper ways over the floor, and where waiting is dear."""
    _draw_floor(axes, free)
    axes.set_title("guidance: the cheaper way between cells")
    notes = ["column", "blue right, orange left, green down, purple up"]
    notes.append(f"darkest: the way back costs {2**STRONGEST:g} times as much")
    dear = free & (costs[WAIT] >= _DEAR * costs[WAIT][free].mean())
    if dear.any():
        axes.imshow(np.ma.masked_where(~dear, dear), cmap=_YELLOW, interpolation="nearest")
        notes.append(f"yellow: waiting costs {_DEAR:g} times the average")
    axes.set_xlabel("\n".join(notes))
    draw_arrows(axes, preferences(costs, free) / STRONGEST)


def draw_flow(axes: Axes, free: np.ndarray, costs: np.ndarray, moves: np.ndarray) -> None:
    """Draw the ways that more agents drove than the opposite ones, and how many obey."""
    _draw_floor(axes, free)
    along = share_along(preferences(costs, free), moves)
    net = moves[[RIGHT, DOWN]] - backwards(moves, 0.0)
    obey = "" if np.isnan(along) else f": {along:.0%} the cheaper way"
    axes.set_title(f"where agents drove{obey}")
    # A few busy cells must not pale all others.
    most = float(np.quantile(np.abs(net[net != 0]), 0.95)) if net.any() else 1.0
    axes.set_xlabel(f"column\ndarkest: {most:.2g} more moves a timestep than back")
    draw_arrows(axes, net / most)


def _draw_floor(axes: Axes, free: np.ndarray) -> None:
    """Draw walls, and the frame around them."""
    axes.imshow(free, cmap=_WALLS, vmin=0, vmax=1)
    axes.spines[:].set_visible(True)
    axes.set_ylabel("row")


def draw_arrows(axes: Axes, strength: np.ndarray) -> Quiver:
    """Draw arrows between cells; `strength` [2, H, W] as in `preferences`, 1 and -1 the strongest.

    Lengths are shares of a cell: what is drawn fits 33 x 36 cells and 101 x 102 on one screen.
    """
    axis, row, column = np.nonzero(strength)
    value = np.clip(strength[axis, row, column], -1, 1)
    length = np.sign(value) * (0.45 + 0.45 * np.abs(value))
    colours = np.array(ARROWS)[2 * axis + (value < 0)]
    return axes.quiver(
        column + 0.5 * (axis == 0),
        row + 0.5 * (axis == 1),
        length * (axis == 0),
        length * (axis == 1),
        color=to_rgba_array(colours, 0.3 + 0.7 * np.abs(value)),
        angles="xy",
        units="xy",
        scale_units="xy",
        scale=1,
        pivot="mid",
        width=0.22,
        headwidth=2.9,
        headlength=2.6,
        headaxislength=2.6,
        minlength=0,
        # More paths would make a page of megabytes.
        rasterized=len(value) > 5000,
    )
