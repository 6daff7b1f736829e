"""Distances on demand: measured where and when somebody asks.

The first question about a goal on a large grid measures the cells that can lie on a way from the
asker, with some slack, by A* with Manhattan distances (Hart, Nilsson and Raphael 1968,
https://doi.org/10.1109/TSSC.1968.300136); so does a question about a cell outside. A field that
many ask for is at last measured as a whole, breadth first. Either way a field holds exact
distances, so who asks what never shows in a result.
"""

from qdenv.native import formula, kernel
from qdenv.simulate.mapf.host.fields import NOWHERE, PAGES, ROWS, UNKNOWN, WANTED, Fields
from qdenv.simulate.mapf.host.site import DOWN, LEFT, MOVES, RIGHT, UP, Site
from qdenv.simulate.mapf.planner import NOBODY

SLACK = 12  # steps longer than the shortest way that a first search measures as well
REACHES = 6  # searches of a field after which the next one measures all of it
COMPLETE = 127  # of `Fields.extent`, which else counts the searches
INDICES = (1 << 31) - 1  # a masked index is known not to count from the end


@formula
def distance(fields: Fields, site: Site, goal: int, cell: int) -> int:
    """Look up the steps from a free cell to a goal; measure them first where nobody asked before.

    Where room is wanting the answer is `fields.unreachable`, and `lacks_room` tells.
    """
    row = fields.row[goal]
    if row != NOBODY:
        page = fields.page[row & INDICES, fields.tile[cell] & INDICES]
        steps = fields.steps[page & INDICES, fields.place[cell] & INDICES]
        if steps != UNKNOWN:
            return steps + 0  # as a number of 64 bits
    return _measure(fields, site, goal, cell)


@formula
def lacks_room(fields: Fields) -> bool:
    """Tell whether a distance could not be measured for want of room."""
    return fields.free[WANTED] != 0


@kernel
def _measure(fields: Fields, site: Site, goal: int, cell: int) -> int:
    """Measure the field of a goal, at least as far as a cell; returns the cell's distance."""
    if fields.free[WANTED]:
        return fields.unreachable  # nothing more can be learnt before there is room
    if fields.row[goal] == NOBODY:
        if fields.free[ROWS] == 0:
            fields.free[WANTED] = 1
            return fields.unreachable
        fields.free[ROWS] -= 1
        fields.row[goal] = fields.free_rows[fields.free[ROWS]]
    row, begin = fields.row[goal], site.goals[goal]
    if fields.extent[row] == COMPLETE or not site.free[begin]:
        return fields.unreachable
    # Small fields are cheap, and goals that many ask for are soon wanted everywhere.
    before = fields.extent[row]
    if before == REACHES or fields.page.shape[1] == 1:
        fields.extent[row] = COMPLETE
        count = _flood(fields, site, begin)
    else:
        fields.extent[row] = before + 1
        count = _reach(fields, site, begin, cell)
    steps = fields.found[cell] + 0  # as a number of 64 bits
    if not _store(fields, row, count):
        fields.extent[row], fields.free[WANTED] = before, 1
        return fields.unreachable
    return steps if steps != UNKNOWN else fields.unreachable


@kernel
def _store(fields: Fields, row: int, count: int) -> bool:
    """Put what a search found into pages, and forget it; returns whether there was room."""
    room = True
    for index in range(count):
        cell = fields.order[index]
        room = room and _write(fields, row, cell, fields.found[cell])
        fields.found[cell] = UNKNOWN
    return room


@formula
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
    fields.steps[page, fields.place[cell]] = steps
    return True


@formula
def _find(fields: Fields, count: int, cell: int, steps: int) -> int:
    """Note the distance of a cell; returns how many are found."""
    fields.found[cell] = steps
    fields.order[count] = cell
    return count + 1


@kernel
def _flood(fields: Fields, site: Site, begin: int) -> int:
    """Find the distances of all cells, breadth first; returns how many."""
    head, count = 0, _find(fields, 0, begin, 0)
    while head < count:
        cell = fields.order[head]
        head += 1
        for move in range(1, MOVES):
            other = cell + site.steps[move]
            if site.free[other] and fields.found[other] == UNKNOWN:
                count = _find(fields, count, other, fields.found[cell] + 1)
    return count


@kernel
def _reach(fields: Fields, site: Site, begin: int, target: int) -> int:
    """Find the distances of the cells on ways to `target` of little more than its distance.

    A step leads nearer to the target or away from it, so the length of a way through a cell stays
    or grows by two: two stacks serve as the queue.
    """
    width = site.width
    target_row, target_column = target // width, target % width
    length = abs(begin // width - target_row) + abs(begin % width - target_column)
    longest = site.free.size
    fields.queue[0, 0] = begin
    this, sizes_this, sizes_next, count = 0, 1, 0, 0
    while length <= longest:
        while sizes_this > 0:
            sizes_this -= 1
            cell = fields.queue[this, sizes_this]
            if fields.found[cell] != UNKNOWN:
                continue
            at_row = cell // width
            at_column = cell - at_row * width
            left = abs(at_row - target_row) + abs(at_column - target_column)
            count = _find(fields, count, cell, length - left)
            if cell == target:
                longest = length + SLACK
            for move in range(1, MOVES):
                other = cell + site.steps[move]
                if not site.free[other] or fields.found[other] != UNKNOWN:
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
