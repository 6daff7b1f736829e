"""The best path of one agent through a window: its end, the way there, the search as a whole.

The same search as `single_agent` and `trail`, bit for bit. Layers that cannot pay are left out:
those where even the best possible path would cost more than the one found. `front` explains the
arrays.
"""

import numpy as np

from qdenv.native import compiled
from qdenv.simulate.mapf.negotiated.numba.search import look, spread
from qdenv.simulate.mapf.negotiated.xla.window import CODE_BITS, NEVER, UNIT

CODES = (1 << CODE_BITS) - 1


@compiled
def price_ends(layer, layers, rows, leave, served, prices, stay, charge, tie, best):
    """Find the cheapest end of a path within one layer; returns it, or `best` if that is cheaper.

    Args:
        layer: this layer.
        layers: how many there are.
        rows: see `front`.
        leave: see `front`.
        served: see `front`.
        prices: the steps to go to every goal (int16 [G, N]), the slots of both goals, the cell in
            sight farthest up and left, cells per row of the grid, the quarter steps to add on
            either level, and those to go once the first goal is done.
        stay: timesteps served at both goals.
        charge: quarter steps this layer costs.
        tie: bits that settle ties.
        best: price and code of the best end so far, in one number.
    """
    distance, slots, corner, width, base, tail = prices
    side = rows.shape[0]
    for level in range(2):
        block = level * layers + layer
        for i in range(side):
            bits = (leave[layer, level, -1, rows[i, 0]] >> rows[i, 1]) & ((1 << side) - 1)
            if bits == 0:
                continue
            start = corner + i * width
            to_go = distance[slots[level], start : start + side]
            code = (block * side + i) * side
            for j in range(side):
                price = UNIT * np.int64(to_go[j]) + base[level] + charge
                key = (price << CODE_BITS) | ((code + j) ^ tie)
                best = min(best, key if (bits >> j) & 1 else NEVER)
        bits, elapsed = served[layer, level, -1], 0
        while bits >> elapsed:
            if (bits >> elapsed) & 1:
                price = UNIT * max(stay[level] - elapsed, 0) + (1 - level) * tail + charge
                code = 2 * layers * side * side + block * 32 + elapsed
                best = min(best, (price << CODE_BITS) | (code ^ tie))
            elapsed += 1
    return best


@compiled
def trace(code, flip, layers, rows, shut, leave, served, spots, stay, corner, width, path):
    """Read the path that ends at `code` backwards into `path` (int64 [w + 1], cells).

    Args:
        code: the end, from `price_ends`.
        flip: whether to look along the columns before looking along the rows.
        layers: how many there are.
        rows: see `front`.
        shut: see `front`.
        leave: see `front`.
        served: see `front`.
        spots: (row, column) of both goals; row -1 where a goal is not in sight or ends no level.
        stay: timesteps served at both goals.
        corner: the cell in sight farthest up and left.
        width: cells per row of the grid.
        path: receives the path.
    """
    window, side = shut.shape[0], rows.shape[0]
    if code >= 2 * layers * side * side:
        block, elapsed = divmod(code - 2 * layers * side * side, 32)
        level, layer = divmod(block, layers)
        row, column = spots[level]
    else:
        block, cell = divmod(code, side * side)
        elapsed = -1
        level, layer = divmod(block, layers)
        row, column = divmod(cell, side)
    for t in range(window - 1, -1, -1):
        path[t + 1] = corner + row * width + column
        on_goal = row == spots[0][0] and column == spots[0][1]
        if elapsed < 0 and level == 1 and on_goal and (served[layer, 0, t + 1] >> stay[0]) & 1:
            level, elapsed = 0, stay[0]
        fewer = max(layer - 1, 0)
        word, shift = rows[row, 0], rows[row, 1] + column
        if elapsed > 0:  # the layer falls where the stay was disturbed
            before = (served[fewer, level, t] >> (elapsed - 1)) & 1
            if layer and before and (shut[t, word, 0] >> shift) & 1:
                layer = fewer
            elapsed -= 1
            continue
        elapsed = -1
        for choice in range(5):
            way = 5 - choice if flip and choice else choice
            i = row - (way == 3) + (way == 4)
            j = column - (way == 1) + (way == 2)
            if not (0 <= i < side and 0 <= j < side):
                continue
            there, bit = rows[i, 0], rows[i, 1] + j
            same = (leave[layer, level, t, there] >> bit) & 1
            less = (leave[fewer, level, t, there] >> bit) & 1 if layer else 0
            if (shut[t, word, way] >> shift) & 1:
                if less or (same and layer == layers - 1):
                    row, column, layer = i, j, fewer if less else layer
                    break
            elif same:
                row, column = i, j
                break
    path[0] = corner + row * width + column


@compiled
def see_goal(cell, row, column, width, rows):
    """Find a goal: its (row, column) in sight and its (word, bit); (-1, -1), (0, 0) if not seen."""
    side = rows.shape[0]
    i, j = cell // width - row + side // 2, cell % width - column + side // 2
    if 0 <= i < side and 0 <= j < side:
        return (i, j), (rows[i, 0], 1 << (rows[i, 1] + j))
    return (-1, -1), (0, 0)


@compiled
def find_path(
    table,
    walls,
    width,
    distance,
    cells,
    position,
    slots,
    stay,
    serving,
    penalty,
    noise,
    layers,
    room,
    path,
):
    """Find the best path of one agent; returns whether there is any.

    Args:
        table: int64 [w, H', words, 5], the reservations.
        walls: int64 [H', words], cells without walls.
        width: cells per row of the grid.
        distance: int16 [G, N], steps from every cell to every goal.
        cells: int32 [G], the goal cells.
        position: where the agent is.
        slots: its current and its next goal.
        stay: timesteps it serves at each.
        serving: timesteps it must still serve where it is; 0 while driving.
        penalty: quarter steps per layer.
        noise: random bits that settle ties.
        layers: how finely reservations driven over are counted.
        room: from `front.make_room`, to work in.
        path: int64 [w + 1], receives the path.
    """
    rows, free, shut, leave, dirty, served = room
    window = shut.shape[0]
    row, column = position // width, position % width
    look(table, walls, row, column, rows, free, shut)
    corner = position - window * width - window
    spot, goal = see_goal(cells[slots[0]], row, column, width, rows)
    next_spot, next_goal = (-1, -1), (0, 0)
    if stay[1] > 0:  # else it is driven over like any other cell
        next_spot, next_goal = see_goal(cells[slots[1]], row, column, width, rows)
    spots, goals = (spot, next_spot), (goal, next_goal)
    tail = UNIT * (np.int64(distance[slots[1], cells[slots[0]]]) + stay[1])
    prices = (distance, slots, corner, width, (UNIT * stay[0] + tail, UNIT * stay[1]), tail)
    soonest = serving if serving else np.int64(distance[slots[0], position]) + stay[0]
    least = UNIT * (soonest - window) + tail  # no path can get more done
    tie = noise & CODES
    best = NEVER
    for layer in range(layers):
        leave[layer] = 0
        served[layer, :, 0] = 0
        if layer == 0 and serving:
            served[0, 0, 0] = 1 << (stay[0] - serving)
        elif layer == 0:
            leave[0, 0, 0, rows[window, 0]] = 1 << (rows[window, 1] + window)
        last = layer == layers - 1
        spread(layer, last, rows, free, shut, leave, dirty, served, goals, stay, soonest)
        charge = layer * penalty
        best = price_ends(layer, layers, rows, leave, served, prices, stay, charge, tie, best)
        if best >> CODE_BITS < least + charge + penalty:
            break  # a path with more conflicts costs more, whatever it is
    code = (best ^ tie) & CODES if best < NEVER else 0
    flip = (noise >> CODE_BITS) & 1
    trace(code, flip, layers, rows, shut, leave, served, spots, stay, corner, width, path)
    return best < NEVER
