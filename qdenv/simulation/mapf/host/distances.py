"""Distances on demand: fields of steps to a goal, measured where and when they are needed.

The first request for a goal on a large grid measures the cells that can lie on a way from the
agent, with some slack, by A* with Manhattan distances (Hart, Nilsson and Raphael 1968,
https://doi.org/10.1109/TSSC.1968.300136); so does a request for a cell outside. A field that many
agents need is at last measured as a whole, breadth first. Either way a field holds exact
distances, so the order of requests never shows in a result.

A field lies in pages of neighbouring cells: it takes memory for what was measured of it only, and
fields that no agent needs any more make place for others.
"""

from typing import NamedTuple

import numpy as np

from qdenv.grid import DOWN, LEFT, NUM_MOVES, RIGHT, UP
from qdenv.guidance import BUCKETS
from qdenv.native import Numbers, formula, kernel, numbers
from qdenv.simulation.mapf.host.state import GridMap
from qdenv.simulation.mapf.planner import NOBODY, distance_type

_UNKNOWN = -1
_NO_PAGE = 0  # a page that holds nothing but UNKNOWN: tiles of a field without a page share it
_WHOLE_SIDE = 64  # a grid with at most this many rows and columns is one page
_PAGE_SIDE = 16
_SHARE = 8  # a field is expected to need one page in this many
_LOW_SHARE = 4  # buffers grow if no more than one row or page in this many is free
_SLACK = 12  # steps longer than the shortest way that a first search measures as well
_REACHES = 6  # searches of a field after which the next one measures all of it
_COMPLETE = 127  # of `DistanceFields.extent`, which else counts the searches
_NO_ENTRY = -1
INDICES = (1 << 31) - 1  # a masked index is known not to count from the end


class DistanceFields(NamedTuple):
    """Fields of distances; R rows for fields, S pages of cells, G goals, N cells."""

    row: np.ndarray  # int32 [G], the row of each goal's field, or `NOBODY`
    extent: np.ndarray  # int8 [R], how often a field was measured, or `_COMPLETE`
    page: np.ndarray  # int32 [R, tiles], the page of each tile of the grid
    steps: np.ndarray  # [S, cells of a page], distances (`planner.distance_type`), or `_UNKNOWN`
    tile: np.ndarray  # int32 [N], the tile of each cell
    place: np.ndarray  # int32 [N], where in its page each cell lies
    free_rows: np.ndarray  # int32 [R], a stack
    free_pages: np.ndarray  # int32 [S], a stack
    # free_rows and free_pages, the heights of the stacks; is_full, whether a distance could not be
    # measured for lack of rows or pages
    numbers: Numbers
    queue: np.ndarray  # int64 [2, 4 N], cells that wait in a search
    # [N], distances found by the search under way; between searches all `_UNKNOWN`
    found: np.ndarray
    order: np.ndarray  # int32 [N], the cells of `found`, as they were found
    unreachable: int  # the distance to where no way leads
    buckets: np.ndarray  # int32 [BUCKETS], `_NO_ENTRY` between two searches by cost


def empty_fields(
    shape: tuple[int, int], goals: int, rows: int, pages: int = 0, has_costs: bool = False
) -> DistanceFields:
    """Make fields of a padded grid [H', W'], none measured.

    At most `rows` fields and `pages` pages at a time; 0 pages stands for what the fields are
    expected to need.
    """
    cells = shape[0] * shape[1]
    kind, unreachable = distance_type(cells, has_costs)
    side = _WHOLE_SIDE if max(shape) <= _WHOLE_SIDE else _PAGE_SIDE
    row, column = np.divmod(np.arange(cells, dtype=np.int32), shape[1])
    tiles_across = -(-shape[1] // side)
    tiles = -(-shape[0] // side) * tiles_across
    pages = pages or 1 + max(rows, rows * tiles // _SHARE)
    # Not initialised: a page takes memory once it is used, but for the first, never written again.
    steps: np.ndarray = np.empty((pages, side * side), kind)
    steps[_NO_PAGE] = _UNKNOWN
    sizes = numbers("free_rows", "free_pages", "is_full")
    sizes.free_rows, sizes.free_pages = rows, pages - 1
    return DistanceFields(
        row=np.full(goals, NOBODY, np.int32),
        extent=np.zeros(rows, np.int8),
        page=np.zeros((rows, tiles), np.int32),
        steps=steps,
        tile=row // side * tiles_across + column // side,
        place=row % side * side + column % side,
        free_rows=np.arange(rows, dtype=np.int32)[::-1].copy(),
        free_pages=np.arange(pages, dtype=np.int32)[:_NO_PAGE:-1].copy(),
        numbers=sizes,
        queue=np.empty((2, 4 * cells), np.int64),
        found=np.full(cells, _UNKNOWN, kind),
        order=np.empty(cells, np.int32),
        unreachable=unreachable,
        buckets=np.full(BUCKETS, _NO_ENTRY, np.int32),
    )


def make_room(fields: DistanceFields, needed: np.ndarray) -> DistanceFields:
    """Drop the fields of all goals but those needed (int [n]); double what is still scarce."""
    spared = np.zeros(fields.row.size, bool)
    spared[needed] = True
    dropped = np.flatnonzero((fields.row != NOBODY) & ~spared)
    rows = fields.row[dropped]
    pages = fields.page[rows][fields.page[rows] != _NO_PAGE]
    free_rows = np.append(fields.free_rows[: fields.numbers.free_rows], rows)
    free_pages = np.append(fields.free_pages[: fields.numbers.free_pages], pages)
    fields.page[rows], fields.extent[rows], fields.row[dropped] = _NO_PAGE, 0, NOBODY
    old = fields.extent.size
    if free_rows.size <= old // _LOW_SHARE:
        free_rows = np.append(free_rows, np.arange(old, 2 * old, dtype=np.int32))
        fields = fields._replace(
            extent=np.append(fields.extent, np.zeros(old, np.int8)),
            page=np.append(fields.page, np.zeros_like(fields.page), axis=0),
        )
    old = len(fields.steps)
    if free_pages.size <= old // _LOW_SHARE:
        free_pages = np.append(free_pages, np.arange(old, 2 * old, dtype=np.int32))
        steps = np.empty((2 * old, fields.steps.shape[1]), fields.steps.dtype)
        steps[:old] = fields.steps
        fields = fields._replace(steps=steps)
    sizes = fields.numbers
    sizes.free_rows, sizes.free_pages, sizes.is_full = free_rows.size, free_pages.size, False
    free_rows.resize(fields.extent.size, refcheck=False)
    free_pages.resize(len(fields.steps), refcheck=False)
    return fields._replace(free_rows=free_rows, free_pages=free_pages)


@formula
def distance(fields: DistanceFields, grid: GridMap, goal: int, cell: int) -> int:
    """Look up the steps from a free cell to a goal; measure them first if needed.

    If the fields are full the answer is `fields.unreachable`, and `is_full` is set.
    """
    row = fields.row[goal]
    if row != NOBODY:
        page = fields.page[row & INDICES, fields.tile[cell] & INDICES]
        steps = fields.steps[page & INDICES, fields.place[cell] & INDICES]
        if steps != _UNKNOWN:
            return steps + 0  # as a number of 64 bits
    return _measure(fields, grid, goal, cell)


@kernel
def _measure(fields: DistanceFields, grid: GridMap, goal: int, cell: int) -> int:
    """Measure the field of a goal, at least as far as a cell; returns the cell's distance."""
    if fields.numbers.is_full:
        return fields.unreachable  # the window will be planned again with larger buffers
    if fields.row[goal] == NOBODY:
        if fields.numbers.free_rows == 0:
            fields.numbers.is_full = True
            return fields.unreachable
        fields.numbers.free_rows -= 1
        fields.row[goal] = fields.free_rows[fields.numbers.free_rows]
    row, begin = fields.row[goal], grid.goals[goal]
    if fields.extent[row] == _COMPLETE or not grid.free[begin]:
        return fields.unreachable
    # Small fields are cheap, and goals that many agents head for are soon needed everywhere.
    before = fields.extent[row]
    if grid.costs.size > 0:
        fields.extent[row] = _COMPLETE
        count = _settle(fields, grid, begin)
    elif before == _REACHES or fields.page.shape[1] == 1:
        fields.extent[row] = _COMPLETE
        count = _flood(fields, grid, begin)
    else:
        fields.extent[row] = before + 1
        count = _reach(fields, grid, begin, cell)
    steps = fields.found[cell] + 0  # as a number of 64 bits
    _store(fields, row, count)
    if fields.numbers.is_full:
        fields.extent[row] = before
        return fields.unreachable
    return steps if steps != _UNKNOWN else fields.unreachable


@kernel
def _store(fields: DistanceFields, row: int, count: int) -> None:
    """Move what a search found into pages; sets `is_full` if there are not enough of them."""
    for index in range(count):
        cell = fields.order[index]
        tile = fields.tile[cell]
        page = fields.page[row, tile]
        if page == _NO_PAGE:
            if fields.numbers.free_pages > 0:
                fields.numbers.free_pages -= 1
                page = fields.free_pages[fields.numbers.free_pages]
                fields.page[row, tile] = page
                fields.steps[page] = _UNKNOWN
            else:
                fields.numbers.is_full = True
        if page != _NO_PAGE:
            fields.steps[page, fields.place[cell]] = fields.found[cell]
        fields.found[cell] = _UNKNOWN


@kernel
def _flood(fields: DistanceFields, grid: GridMap, begin: int) -> int:
    """Find the distances of all cells, breadth first; returns their number."""
    found, order = fields.found, fields.order
    head, count = 0, 1
    found[begin], order[0] = 0, begin
    while head < count:
        cell = order[head]
        head += 1
        for move in range(1, NUM_MOVES):
            other = cell + grid.steps[move]
            if grid.free[other] and found[other] == _UNKNOWN:
                found[other], order[count] = found[cell] + 1, other
                count += 1
    return count


@kernel
def _settle(fields: DistanceFields, grid: GridMap, begin: int) -> int:
    """Find the costs from all cells, the cheapest first; returns their number.

    Dial 1969 (https://doi.org/10.1145/363269.363610): no cost reaches `BUCKETS`, so cells that wait
    lie in a ring of lists, one for each cost. A cell may wait in several; the first one counts.
    """
    found, entry_cell, entry_next = fields.found, fields.queue[0], fields.queue[1]
    fields.buckets[0], entry_cell[0], entry_next[0] = 0, begin, _NO_ENTRY
    entries, waiting, count, cost = 1, 1, 0, 0
    while waiting > 0:
        bucket = cost % BUCKETS
        while fields.buckets[bucket] != _NO_ENTRY:
            entry = fields.buckets[bucket]
            fields.buckets[bucket] = entry_next[entry]
            waiting -= 1
            cell = entry_cell[entry]
            if found[cell] != _UNKNOWN:
                continue
            found[cell], fields.order[count] = min(cost, fields.unreachable), cell
            count += 1
            for move in range(1, NUM_MOVES):
                other = cell - grid.steps[move]  # from where the move leads to the cell
                price = grid.costs[move, other]
                if price > 0 and grid.free[other] and found[other] == _UNKNOWN:
                    after = (cost + price) % BUCKETS
                    entry_cell[entries], entry_next[entries] = other, fields.buckets[after]
                    fields.buckets[after] = entries
                    entries, waiting = entries + 1, waiting + 1
        cost += 1
    return count


@kernel
def _reach(fields: DistanceFields, grid: GridMap, begin: int, target: int) -> int:
    """Find the distances of the cells on ways to `target` of little more than its distance.

    A step leads nearer to the target or away from it, so the length of a way through a cell stays
    or grows by two: two stacks serve as the queue.
    """
    width = grid.width
    target_row, target_column = target // width, target % width
    length = abs(begin // width - target_row) + abs(begin % width - target_column)
    longest = grid.free.size
    fields.queue[0, 0] = begin
    this, sizes_this, sizes_next, count = 0, 1, 0, 0
    while length <= longest:
        while sizes_this > 0:
            sizes_this -= 1
            cell = fields.queue[this, sizes_this]
            if fields.found[cell] != _UNKNOWN:
                continue
            at_row = cell // width
            at_column = cell - at_row * width
            left = abs(at_row - target_row) + abs(at_column - target_column)
            fields.found[cell], fields.order[count] = length - left, cell
            count += 1
            if cell == target:
                longest = length + _SLACK
            for move in range(1, NUM_MOVES):
                other = cell + grid.steps[move]
                if not grid.free[other] or fields.found[other] != _UNKNOWN:
                    continue
                across = abs(at_column + (move == RIGHT) - (move == LEFT) - target_column)
                nearer = across + abs(at_row + (move == DOWN) - (move == UP) - target_row)
                if nearer < left:
                    fields.queue[this, sizes_this] = other
                    sizes_this += 1
                else:
                    fields.queue[1 - this, sizes_next] = other
                    sizes_next += 1
        if sizes_next == 0:
            break
        this, sizes_this, sizes_next, length = 1 - this, sizes_next, 0, length + 2
    return count
