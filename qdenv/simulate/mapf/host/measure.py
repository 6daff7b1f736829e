"""Distances on demand: measured where and when somebody asks.

The first question about a goal on a large grid measures the cells that can lie on a way from the
asker, with some slack, by A* with Manhattan distances (Hart, Nilsson and Raphael 1968,
https://doi.org/10.1109/TSSC.1968.300136); whoever asks for a cell outside has the whole field
measured, breadth first. Either way a field holds exact distances, so who asks what never shows in
a result.
"""

from qdenv.native import inlined, kernel
from qdenv.simulate.mapf.host.fields import NOWHERE, PAGES, ROWS, UNKNOWN, WANTED, Fields
from qdenv.simulate.mapf.host.site import DOWN, LEFT, MOVES, RIGHT, UP, Site
from qdenv.simulate.mapf.planner import NOBODY, UNREACHABLE

SLACK = 12  # steps longer than the shortest way that a first search measures as well
PARTIAL, COMPLETE = 1, 2  # of `Fields.extent`; 0 where nothing was measured


@inlined
def distance(fields: Fields, site: Site, goal: int, cell: int) -> int:
    """Look up the steps from a free cell to a goal; measure them first where nobody asked before.

    Where room is wanting the answer is `UNREACHABLE`, and `lacks_room` tells.
    """
    row = fields.row[goal]
    if row != NOBODY:
        steps = fields.steps[fields.page[row, fields.tile[cell]], fields.place[cell]]
        if steps != UNKNOWN:
            return steps + 0  # as a number of 64 bits
    return _measure(fields, site, goal, cell)


@inlined
def lacks_room(fields: Fields) -> bool:
    """Tell whether a distance could not be measured for want of room."""
    return fields.free[WANTED] != 0


@kernel
def _measure(fields: Fields, site: Site, goal: int, cell: int) -> int:
    """Measure the field of a goal, at least as far as a cell; returns the cell's distance."""
    if fields.free[WANTED]:
        return UNREACHABLE  # nothing more can be learnt before there is room
    if fields.row[goal] == NOBODY:
        if fields.free[ROWS] == 0:
            fields.free[WANTED] = 1
            return UNREACHABLE
        fields.free[ROWS] -= 1
        fields.row[goal] = fields.free_rows[fields.free[ROWS]]
    row, begin = fields.row[goal], site.goals[goal]
    if fields.extent[row] == COMPLETE or not site.free[begin]:
        return UNREACHABLE
    # Small fields are cheap, and goals that many ask for are soon wanted everywhere.
    if fields.extent[row] == PARTIAL or fields.page.shape[1] == 1:
        fields.extent[row] = COMPLETE
        done = _flood(fields, site, row, begin)
    else:
        fields.extent[row] = PARTIAL
        done = _reach(fields, site, row, begin, cell)
    if not done:
        fields.extent[row], fields.free[WANTED] = PARTIAL, 1
        return UNREACHABLE
    steps = fields.steps[fields.page[row, fields.tile[cell]], fields.place[cell]]
    return steps + 0 if steps != UNKNOWN else UNREACHABLE


@inlined
def _known(fields: Fields, row: int, cell: int) -> bool:
    """Tell whether a cell was measured."""
    return fields.steps[fields.page[row, fields.tile[cell]], fields.place[cell]] != UNKNOWN


@kernel
def _write(fields: Fields, row: int, cell: int, steps: int) -> bool:
    """Write a distance down; returns whether there was room."""
    tile = fields.tile[cell]
    page = fields.page[row, tile]
    if page == NOWHERE:
        if fields.free[PAGES] == 0:
            return False
        fields.free[PAGES] -= 1
        page = fields.free_pages[fields.free[PAGES]]
        fields.page[row, tile] = page
        for place in range(fields.steps.shape[1]):
            fields.steps[page, place] = UNKNOWN
    fields.steps[page, fields.place[cell]] = min(steps, UNREACHABLE)
    return True


@kernel
def _flood(fields: Fields, site: Site, row: int, begin: int) -> bool:
    """Measure all cells breadth first, anew; returns whether there was room."""
    for tile in range(fields.page.shape[1]):
        page = fields.page[row, tile]
        for place in range(fields.steps.shape[1] if page != NOWHERE else 0):
            fields.steps[page, place] = UNKNOWN
    if not _write(fields, row, begin, 0):
        return False
    fields.queue[0, 0] = begin
    head, tail = 0, 1
    while head < tail:
        cell = fields.queue[0, head]
        head += 1
        steps = fields.steps[fields.page[row, fields.tile[cell]], fields.place[cell]] + 1
        for change in (1, -1, site.width, -site.width):
            other = cell + change
            if site.free[other] and not _known(fields, row, other):
                if not _write(fields, row, other, steps):
                    return False
                fields.queue[0, tail] = other
                tail += 1
    return True


@kernel
def _reach(fields: Fields, site: Site, row: int, begin: int, target: int) -> bool:
    """Measure the cells on ways to `target` of little more than its distance.

    A step leads nearer to the target or away from it, so the length of a way through a cell stays
    or grows by two: two stacks serve as the queue.

    Returns:
        Whether there was room.
    """
    width = site.width
    target_row, target_column = target // width, target % width
    length = abs(begin // width - target_row) + abs(begin % width - target_column)
    longest = site.free.size
    fields.queue[0, 0] = begin
    this, sizes_this, sizes_next = 0, 1, 0
    while length <= longest:
        while sizes_this > 0:
            sizes_this -= 1
            cell = fields.queue[this, sizes_this]
            if _known(fields, row, cell):
                continue
            at_row, at_column = cell // width, cell % width
            left = abs(at_row - target_row) + abs(at_column - target_column)
            if not _write(fields, row, cell, length - left):
                return False
            if cell == target:
                longest = length + SLACK
            for move in range(1, MOVES):
                other = cell + site.steps[move]
                if not site.free[other] or _known(fields, row, other):
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
    return True
