"""What makes traffic on a layout risky though it breaks no rule: where robots lock one another in.

Remarks, not rules: a dead end has room for one robot at a time, a cell that joins two halves of a
hall stops both when a robot breaks down on it, and where an aisle is one robot wide and open both
ways, robots that meet have to back out.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import count_neighbours, of_tiles, shift
from qdenv.guidance import preferences
from qdenv.lazy import ndimage
from qdenv.study.plans import Plan, station_tiles

_LANE = 1.0  # doublings of the cost from one way to the other, from which on an aisle is one way


class Remark(NamedTuple):
    """Something that is worth a second look."""

    kind: str  # "dead ends", "cuts", "narrow" or "stations"
    message: str  # in words, with the number of cells and the first or the worst
    cells: np.ndarray  # int64 [n, 2], (row, column) of the cells it is about


def diagnose(plan: Plan) -> list[Remark]:
    """List what is risky about a layout; nothing where no fleet drives."""
    domain, layout = plan.domain, plan.layout
    if domain.simulator.tasks is None:
        return []
    area = domain.drivable(layout)
    stations = area & np.asarray(of_tiles(layout, station_tiles(domain), domain.tiles))
    ends, narrow = dead_ends(area), narrow_aisles(area, plan.costs)
    lost = np.where(ends, 0, cut_off(area, area & ~ends))
    remarks = []

    def remark(kind: str, where: np.ndarray, what: str, facts: str, at: int = 0) -> None:
        cells = np.argwhere(where)
        place = "row {}, column {}".format(*cells[at])
        remarks.append(Remark(kind, f"{what}: {facts.format(len(cells), place)}", cells))

    labels, number = ndimage.label(ends)
    # A station in a niche of its own is no aisle.
    sizes = np.bincount(labels[ends & ~stations], minlength=number + 1)
    aisles = ends & (sizes[labels] > 0)
    if number := int((sizes > 0).sum()):
        longest = np.bincount(labels[aisles]).argmax()
        cell = int(np.flatnonzero(labels[aisles] == longest)[0])
        facts = f"{number}, {{}} cells in all, the longest at {{}}"
        remark("dead ends", aisles, "dead-end aisles", facts, cell)
    if (lost > 0).any():
        worst = f"{{}}, the worst at {{}} with {lost.max():,} cells behind it"
        at = int(lost[lost > 0].argmax())
        remark("cuts", lost > 0, "cells whose loss cuts the hall in two", worst, at)
    if narrow.any():
        share = f"{narrow.sum() / area.sum():.0%} of the floor, {{}} cells, the first at {{}}"
        remark("narrow", narrow, "two-way aisles one robot wide", share)
    lonely = stations & (count_neighbours(area) == 1)
    if lonely.any():
        remark("stations", lonely, "stations with one access only", "{}, the first at {}")
    return remarks


def dead_ends(area: np.ndarray) -> np.ndarray:
    """Find the cells that lead nowhere: what is left of `area` has a way on from every cell.

    Cells with one neighbour are taken away again and again (bool [H, W] -> bool [H, W]); what
    remains is the 2-core of the graph of cells.
    """
    core = area.copy()
    while (ends := core & (count_neighbours(core) <= 1)).any():
        core &= ~ends
    return area & ~core


def narrow_aisles(area: np.ndarray, costs: np.ndarray | None = None) -> np.ndarray:
    """Find the cells of `area` (bool [H, W]) where no two robots can pass: none of a 2 x 2 square.

    With costs of moves (float [5, H, W]) a cell is left out if at each border to a neighbour one
    way is the cheaper one, by half or more.
    """
    narrow = area & ~ndimage.binary_opening(area, np.ones((2, 2), bool))
    if costs is None:
        return narrow
    right, down = np.abs(preferences(costs, area)) < _LANE
    right, down = right & area & shift(area, (0, 1)), down & area & shift(area, (1, 0))
    two_way = right | down | shift(right, (0, -1)) | shift(down, (-1, 0))
    return narrow & two_way


def cut_off(area: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Count what is cut off when a cell of `area` (bool [H, W]) is lost: its articulation points.

    Return for each cell how many of the `counted` cells (bool [H, W]) that are connected with it
    would no longer be connected with most of them (int64 [H, W]). One depth-first search (Hopcroft
    and Tarjan 1973, "Algorithm 447: efficient algorithms for graph manipulation"), linear in the
    number of cells.
    """
    width = area.shape[1] + 2  # with a border of walls, so that no neighbour is outside
    free, weights = (np.pad(one, 1).ravel().tolist() for one in (area, counted.astype(int)))
    order, low = [0] * len(free), [0] * len(free)  # when a cell is found; the earliest one in reach
    below, parts, largest = list(weights), [0] * len(free), [0] * len(free)
    lost, time = np.zeros(len(free), np.int64), 0
    for root in np.flatnonzero(free).tolist():
        if order[root]:
            continue
        time += 1
        order[root] = low[root] = time
        found, path = [root], [(root, 0)]
        while path:
            cell, turn = path.pop()
            if turn < 4:
                path.append((cell, turn + 1))
                beside = cell + (1, -1, width, -width)[turn]
                if not free[beside]:
                    continue
                if order[beside]:
                    low[cell] = min(low[cell], order[beside])
                    continue
                time += 1
                order[beside] = low[beside] = time
                found.append(beside)
                path.append((beside, 0))
            elif path:
                parent = path[-1][0]
                low[parent] = min(low[parent], low[cell])
                below[parent] += below[cell]
                if low[cell] >= order[parent]:  # nothing below reaches past the parent
                    parts[parent] += below[cell]
                    largest[parent] = max(largest[parent], below[cell])
        for cell in found:
            rest = below[root] - weights[cell] - parts[cell]
            lost[cell] = below[root] - weights[cell] - max(largest[cell], rest)
    return lost.reshape(-1, width)[1:-1, 1:-1]
