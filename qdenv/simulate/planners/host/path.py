"""The best path of one agent through a window: its end, the way there, the search as a whole.

The same search as `single_agent` and `trail`, bit for bit. Layers that cannot pay are left out:
those where even the best possible path would cost more than the one found. `front` explains the
arrays.
"""

import numpy as np

from qdenv.native import compiled
from qdenv.simulate.planners.host.front import look, spread
from qdenv.simulate.planners.view import CODE_BITS, NEVER, UNIT

CODES = (1 << CODE_BITS) - 1


@compiled
def price_ends(
    layer,
    layers,
    leave,
    served,
    distance,
    slots,
    corner,
    width,
    base,
    tail,
    stay,
    charge,
    noise,
    best,
):
    """Find the cheapest end of a path within one layer; returns it, or `best` if that is cheaper.

    Args:
        layer: this layer.
        layers: how many there are.
        leave: see `front`.
        served: see `front`.
        distance: int16 [G, N], steps to go to every goal.
        slots: both goals.
        corner: the cell in sight farthest up and left.
        width: cells per row of the grid.
        base: quarter steps to add on either level.
        tail: quarter steps to go once the first goal is done.
        stay: timesteps served at both goals.
        charge: quarter steps this layer costs.
        noise: bits that settle ties.
        best: price and code of the best end so far, in one number.
    """
    side = leave.shape[3] - 2
    for level in range(2):
        block = level * layers + layer
        for i in range(side):
            bits = leave[layer, level, -1, i + 1]
            if bits == 0:
                continue
            for j in range(side):
                if (bits >> j) & 1:
                    to_go = distance[slots[level], corner + i * width + j]
                    price = UNIT * np.int64(to_go) + base[level] + charge
                    code = (block * side + i) * side + j
                    best = min(best, (price << CODE_BITS) | (code ^ noise))
        bits, elapsed = served[layer, level, -1], 0
        while bits >> elapsed:
            if (bits >> elapsed) & 1:
                price = UNIT * max(stay[level] - elapsed, 0) + (1 - level) * tail + charge
                code = 2 * layers * side * side + block * 32 + elapsed
                best = min(best, (price << CODE_BITS) | (code ^ noise))
            elapsed += 1
    return best


@compiled
def trace(code, flip, layers, shut, leave, served, goals, columns, stay, path):
    """Read the path that ends at `code` backwards into `path` (int64 [w + 1, 2], row and column).

    Args:
        code: the end, from `price_ends`.
        flip: whether to look along the columns before looking along the rows.
        layers: how many there are.
        shut: see `front`.
        leave: see `front`.
        served: see `front`.
        goals: (row, bit) of both goals.
        columns: their columns.
        stay: timesteps served at both goals.
        path: receives the path; rows count from the edge row.
    """
    window = shut.shape[0]
    side = 2 * window + 1
    if code >= 2 * layers * side * side:
        block, elapsed = divmod(code - 2 * layers * side * side, 32)
        level, layer = divmod(block, layers)
        row, column = goals[level][0], columns[level]
    else:
        block, cell = divmod(code, side * side)
        elapsed = -1
        level, layer = divmod(block, layers)
        row, column = cell // side + 1, cell % side
    for t in range(window - 1, -1, -1):
        path[t + 1, 0], path[t + 1, 1] = row, column
        on_goal = row == goals[0][0] and (goals[0][1] >> column) & 1
        if elapsed < 0 and level == 1 and on_goal and (served[layer, 0, t + 1] >> stay[0]) & 1:
            level, elapsed = 0, stay[0]
        fewer = max(layer - 1, 0)
        if elapsed > 0:  # the layer falls where the stay was disturbed
            before = (served[fewer, level, t] >> (elapsed - 1)) & 1
            if layer and before and (shut[t, 0, row] >> column) & 1:
                layer = fewer
            elapsed -= 1
            continue
        elapsed = -1
        for choice in range(5):
            way = 5 - choice if flip and choice else choice
            i = row - (way == 3) + (way == 4)
            j = column - (way == 1) + (way == 2)
            if not (1 <= i <= side and 0 <= j < side):
                continue
            same = (leave[layer, level, t, i] >> j) & 1
            less = (leave[fewer, level, t, i] >> j) & 1 if layer else 0
            if (shut[t, way, row] >> column) & 1:
                if less or (same and layer == layers - 1):
                    row, column, layer = i, j, fewer if less else layer
                    break
            elif same:
                row, column = i, j
                break
    path[0, 0], path[0, 1] = row, column


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
    free,
    shut,
    leave,
    dirty,
    served,
    trail,
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
        free: as the next four, see `front`; room to work in.
        shut: see `front`.
        leave: see `front`.
        dirty: see `front`.
        served: see `front`.
        trail: int64 [w + 1, 2], likewise.
        path: int64 [w + 1], receives the path.
    """
    window = shut.shape[0]
    middle, side = window + 1, 2 * window + 1
    row, column = position // width, position % width
    look(table, walls, row, column, free, shut)
    goals, columns = ((0, 0), (0, 0)), (0, 0)
    i, j = cells[slots[0]] // width - row + middle, cells[slots[0]] % width - column + window
    k, m = cells[slots[1]] // width - row + middle, cells[slots[1]] % width - column + window
    if 1 <= i <= side and 0 <= j < side:
        goals, columns = ((i, 1 << j), goals[1]), (j, columns[1])
    if stay[1] > 0 and 1 <= k <= side and 0 <= m < side:
        goals, columns = (goals[0], (k, 1 << m)), (columns[0], m)
    tail = UNIT * (np.int64(distance[slots[1], cells[slots[0]]]) + stay[1])
    base = (UNIT * stay[0] + tail, UNIT * stay[1])
    soonest = serving if serving else np.int64(distance[slots[0], position]) + stay[0]
    least = UNIT * (soonest - window) + tail  # no path can get more done
    tie = noise & CODES
    corner = position - window * width - window
    best = NEVER
    for layer in range(layers):
        leave[layer] = 0
        served[layer, :, 0] = 0
        if layer == 0 and serving:
            served[0, 0, 0] = 1 << (stay[0] - serving)
        elif layer == 0:
            leave[0, 0, 0, middle] = 1 << window
        last = layer == layers - 1
        spread(layer, last, free, shut, leave, dirty, served, goals, stay, soonest)
        best = price_ends(
            layer,
            layers,
            leave,
            served,
            distance,
            slots,
            corner,
            width,
            base,
            tail,
            stay,
            layer * penalty,
            tie,
            best,
        )
        if best >> CODE_BITS < least + (layer + 1) * penalty:
            break  # a path with more conflicts costs more, whatever it is
    code = (best ^ tie) & CODES if best < NEVER else 0
    flip = (noise >> CODE_BITS) & 1
    trace(code, flip, layers, shut, leave, served, goals, columns, stay, trail)
    for t in range(window + 1):
        path[t] = corner + (trail[t, 0] - 1) * width + trail[t, 1]
    return best < NEVER
