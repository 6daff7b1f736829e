"""Fields of distances: steps to a goal, in pages of neighbouring cells.

So a field takes memory for what was measured of it only (`measure`), and fields that nobody needs
any more make room for others.
"""

from typing import NamedTuple

import numpy as np

from qdenv.simulate.mapf.planner import NOBODY, steps_type, unreachable

UNKNOWN = -1
NOWHERE = 0  # a page that holds nothing but UNKNOWN: tiles of a field without a page share it
WHOLE_SIDE = 64  # a grid of so many rows and columns is one page
PAGE_SIDE = 16
SHARE = 8  # a field is expected to take one page in so many
ENOUGH = 4  # room grows where no more than one in so many is free
ROWS, PAGES, WANTED = range(3)  # entries of `Fields.free`


class Fields(NamedTuple):
    """Fields of distances; R rows for fields, S pages of cells, G goals, N cells."""

    row: np.ndarray  # int32 [G], the row of each goal's field, or `NOBODY`
    extent: np.ndarray  # int8 [R], how often a field was measured, see `measure`
    page: np.ndarray  # int32 [R, tiles], the page of each tile of the grid
    steps: np.ndarray  # [S, cells of a page], distances (`planner.steps_type`), or `UNKNOWN`
    tile: np.ndarray  # int32 [N], the tile of each cell
    place: np.ndarray  # int32 [N], where in its page each cell lies
    free_rows: np.ndarray  # int32 [R], a stack
    free_pages: np.ndarray  # int32 [S], a stack
    free: np.ndarray  # int64 [3], how many rows and pages are free, and whether one was wanting
    queue: np.ndarray  # int64 [2, 4 N], cells that wait in a search
    # [N], distances found by the search under way; between searches all `UNKNOWN`
    found: np.ndarray
    order: np.ndarray  # int32 [N], the cells of `found`, as they were found
    unreachable: int  # the distance to where no way leads


def empty_fields(shape: tuple[int, int], goals: int, rows: int, pages: int = 0) -> Fields:
    """Make room for fields, none measured.

    Args:
        shape: (H', W') of the padded grid.
        goals: how many goals there are.
        rows: fields at a time.
        pages: pages at a time; 0 for what such fields are expected to take.
    """
    cells = shape[0] * shape[1]
    side = WHOLE_SIDE if max(shape) <= WHOLE_SIDE else PAGE_SIDE
    row, column = np.divmod(np.arange(cells, dtype=np.int32), shape[1])
    tiles_across = -(-shape[1] // side)
    tiles = -(-shape[0] // side) * tiles_across
    pages = pages or 1 + max(rows, rows * tiles // SHARE)
    return Fields(
        row=np.full(goals, NOBODY, np.int32),
        extent=np.zeros(rows, np.int8),
        page=np.zeros((rows, tiles), np.int32),
        steps=_blank_pages(pages, side, steps_type(cells)),
        tile=row // side * tiles_across + column // side,
        place=row % side * side + column % side,
        free_rows=np.arange(rows, dtype=np.int32)[::-1].copy(),
        free_pages=np.arange(pages, dtype=np.int32)[:NOWHERE:-1].copy(),
        free=np.array([rows, pages - 1, 0], np.int64),
        queue=np.empty((2, 4 * cells), np.int64),
        found=np.full(cells, UNKNOWN, steps_type(cells)),
        order=np.empty(cells, np.int32),
        unreachable=unreachable(cells),
    )


def _blank_pages(pages: int, side: int, kind: type) -> np.ndarray:
    """Make pages that take memory once they are used, but for the first, which is never written."""
    steps: np.ndarray = np.empty((pages, side * side), kind)
    steps[NOWHERE] = UNKNOWN
    return steps


def make_room(fields: Fields, wanted_goals: np.ndarray) -> Fields:
    """Forget the fields of all goals but those wanted (int [n]); double what is still scarce.

    Returns:
        The fields, with nothing wanting.
    """
    spared = np.zeros(fields.row.size, bool)
    spared[wanted_goals] = True
    _forget(fields, np.flatnonzero((fields.row != NOBODY) & ~spared))
    if fields.free[ROWS] <= fields.extent.size // ENOUGH:
        fields = _more_rows(fields)
    if fields.free[PAGES] <= len(fields.steps) // ENOUGH:
        fields = _more_pages(fields)
    fields.free[WANTED] = 0
    return fields


def _forget(fields: Fields, goals: np.ndarray) -> None:
    """Give the rows and the pages of the fields of `goals` (int [n]) back."""
    rows = fields.row[goals]
    tables = fields.page[rows]
    pages = tables[tables != NOWHERE]
    stacks = ((fields.free_rows, ROWS, rows), (fields.free_pages, PAGES, pages))
    for stack, count, given in stacks:
        first = fields.free[count]
        stack[first : first + given.size] = given
        fields.free[count] += given.size
    fields.page[rows], fields.extent[rows], fields.row[goals] = NOWHERE, 0, NOBODY


def _more_rows(fields: Fields) -> Fields:
    """Make room for twice as many fields."""
    old = fields.extent.size
    stack = np.concatenate([fields.free_rows, np.zeros(old, np.int32)])
    first = fields.free[ROWS]
    stack[first : first + old] = np.arange(old, 2 * old)
    fields.free[ROWS] += old
    return fields._replace(
        extent=np.concatenate([fields.extent, np.zeros(old, np.int8)]),
        page=np.concatenate([fields.page, np.zeros_like(fields.page)]),
        free_rows=stack,
    )


def _more_pages(fields: Fields) -> Fields:
    """Make room for twice as many pages."""
    old, cells = fields.steps.shape
    steps = np.empty((2 * old, cells), fields.steps.dtype)
    steps[:old] = fields.steps
    stack = np.concatenate([fields.free_pages, np.zeros(old + 1, np.int32)])
    first = fields.free[PAGES]
    stack[first : first + old] = np.arange(old, 2 * old)
    fields.free[PAGES] += old
    return fields._replace(steps=steps, free_pages=stack)
