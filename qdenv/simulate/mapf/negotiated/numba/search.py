"""What one agent can reach within a window, past the reservations of the others.

The same search as `single_agent`, bit for bit, for one agent at a time. A set of cells is the
square of E rows and columns around the agent, as many whole rows to a word as fit into 63 bits,
with an empty word on either side. Arrays of one search; w timesteps, E = 2 w + 1, W words:

    rows    int64 [E, 2], the word of every row and the bit where it begins
    free    int64 [W + 2], cells without walls
    shut    int64 [w, W + 2, 5], cells where arriving at t + 1 conflicts: by waiting, moving right,
            left, down, up
    leave   int64 [layers, 2, w + 1, W + 2], where paths go on from at time t
    dirty   the same, reached at time t by a step with a conflict
    served  int64 [layers, 2, w + 1], bit e: serving for e timesteps at time t
"""

import numpy as np

from qdenv.native import compiled
from qdenv.simulate.mapf.negotiated.numba.reservations import STRIDE

BITS = 63


@compiled
def make_room(window, layers):
    """Allocate the arrays of a search: rows, free, shut, leave, dirty, served."""
    side = 2 * window + 1
    per_word = BITS // side
    rows = np.empty((side, 2), np.int64)
    for row in range(side):
        rows[row, 0], rows[row, 1] = row // per_word + 1, row % per_word * side
    words = rows[-1, 0] + 2
    free = np.zeros(words, np.int64)
    shut = np.zeros((window, words, 5), np.int64)
    leave = np.zeros((layers, 2, window + 1, words), np.int64)
    served = np.zeros((layers, 2, window + 1), np.int64)
    return rows, free, shut, leave, np.zeros_like(leave), served


@compiled
def look(table, walls, row, column, rows, free, shut):
    """Cut out what the agent at (row, column) sees: walls and conflicts with reservations."""
    window = shut.shape[0]
    begin, skip = (column - window) // STRIDE, (column - window) % STRIDE
    sight = (1 << rows.shape[0]) - 1
    free[:] = 0
    for i in range(rows.shape[0]):
        free[rows[i, 0]] |= ((walls[row - window + i, begin] >> skip) & sight) << rows[i, 1]
    per_word = BITS // rows.shape[0]
    for t in range(window):
        first, last = window - t - 1, window + t + 1
        for word in range(rows[first, 0], rows[last, 0] + 1):
            cell, right, left, down, up = 0, 0, 0, 0, 0
            for i in range(max(first, (word - 1) * per_word), min(last + 1, word * per_word)):
                seen, shift = table[t, row - window + i, begin], rows[i, 1]
                cell |= ((seen[0] >> skip) & sight) << shift
                right |= ((seen[1] >> skip) & sight) << shift
                left |= ((seen[2] >> skip) & sight) << shift
                down |= ((seen[3] >> skip) & sight) << shift
                up |= ((seen[4] >> skip) & sight) << shift
            inside = free[word]
            shut[t, word, 0] = cell & inside
            shut[t, word, 1] = (cell | left) & inside
            shut[t, word, 2] = (cell | right) & inside
            shut[t, word, 3] = (cell | up) & inside
            shut[t, word, 4] = (cell | down) & inside


@compiled
def drive(side, free, shut, source, clashed, more, own, target, dirty, first, last):
    """Take one timestep within one layer and level, in words `first` to `last`.

    Args:
        side: rows and columns in sight.
        free: where there are no walls.
        shut: conflicts of this timestep, int64 [W + 2, 5].
        source: where paths go on from.
        clashed: cells reached with a conflict from one layer below.
        more: -1 to let these in, 0 for the lowest layer.
        own: -1 for the last layer, which also keeps its own paths with conflicts.
        target: receives the cells reached.
        dirty: receives those reached with a conflict.
        first: first word.
        last: last word.
    """
    left_edge = 0
    for row in range(BITS // side):
        left_edge |= 1 << (row * side)
    not_left, not_right = ~left_edge, ~(left_edge << (side - 1))
    top = (BITS // side - 1) * side
    one_row = (1 << side) - 1
    for i in range(first, last + 1):
        here, inside = source[i], free[i]
        right, left = (here << 1) & not_left, (here >> 1) & not_right
        down = (here << side) | (source[i - 1] >> top)
        up = (here >> side) | ((source[i + 1] & one_row) << top)
        a, b, c, d, e = shut[i, 0], shut[i, 1], shut[i, 2], shut[i, 3], shut[i, 4]
        hit = (here & a) | (right & b) | (left & c) | (down & d) | (up & e)
        clean = (here & ~a) | (right & ~b) | (left & ~c) | (down & ~d) | (up & ~e)
        dirty[i] = hit
        target[i] = (clean & inside) | (clashed[i] & more) | (hit & own)


@compiled
def spread(layer, last, rows, free, shut, leave, dirty, served, goals, stay, soonest):
    """Fill one layer: where its paths go on from at every timestep.

    Args:
        layer: this layer; those below are filled.
        last: whether it is the last one, which counts all further conflicts.
        rows: see the module.
        free: see the module.
        shut: see the module.
        leave: see the module; filled, as are the next two.
        dirty: see the module.
        served: see the module.
        goals: (word, bit) of both goals; bit 0 where a goal is not in sight or ends no level.
        stay: timesteps served at both goals.
        soonest: timestep before which the first goal cannot be done.
    """
    window, side = shut.shape[0], rows.shape[0]
    below = max(layer - 1, 0)
    more, own = -1 if layer else 0, -1 if last else 0
    for t in range(window):
        first, end = rows[window - t - 1, 0], rows[window + t + 1, 0]
        done = False
        for level in range(2):
            word, bit = goals[level]
            cells = leave[layer, level, t + 1]
            if level == 0 or t >= soonest:
                drive(
                    side,
                    free,
                    shut[t],
                    leave[layer, level, t],
                    dirty[below, level, t + 1],
                    more,
                    own,
                    cells,
                    dirty[layer, level, t + 1],
                    first,
                    end,
                )
            arrived = cells[word] & bit != 0
            cells[word] &= ~bit  # a goal is left only after service, and in the next level
            longer = served[layer, level, t] << 1
            if shut[t, word, 0] & bit:
                held = served[below, level, t] << 1 if layer else 0
                longer = held | (longer if last else 0)
            served[layer, level, t + 1] = longer | (1 if arrived else 0)
            if level == 0:
                done = (served[layer, 0, t + 1] >> stay[0]) & 1 == 1
            elif done:
                cells[goals[0][0]] |= goals[0][1]
