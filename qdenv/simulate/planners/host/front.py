"""What one agent can reach within a window, past the reservations of the others.

The same search as `single_agent`, bit for bit, for one agent at a time. Rows that cannot be
reached yet are left out. Arrays of one search; w timesteps, E rows in sight and an edge on either
side:

    free    int32 [E + 2], cells without walls
    shut    int32 [w, 5, E + 2], cells where arriving at t + 1 conflicts: by waiting, moving right,
            left, down, up
    leave   int32 [layers, 2, w + 1, E + 2], where paths go on from at time t
    dirty   the same, reached at time t by a step with a conflict
    served  int64 [layers, 2, w + 1], bit e: serving for e timesteps at time t
"""

from qdenv.native import compiled
from qdenv.simulate.planners.host.book import STRIDE


@compiled
def look(table, walls, row, column, free, shut):
    """Cut out what the agent at (row, column) sees: walls and conflicts with reservations."""
    window = shut.shape[0]
    word, shift = (column - window) // STRIDE, (column - window) % STRIDE
    sight = (1 << (2 * window + 1)) - 1
    for i in range(-window, window + 1):
        free[i + window + 1] = (walls[row + i, word] >> shift) & sight
    for t in range(window):
        for i in range(-t - 1, t + 2):
            seen, place = table[t, row + i, word], i + window + 1
            inside = free[place]
            cell = (seen[0] >> shift) & inside
            shut[t, 0, place] = cell
            shut[t, 1, place] = cell | ((seen[2] >> shift) & inside)
            shut[t, 2, place] = cell | ((seen[1] >> shift) & inside)
            shut[t, 3, place] = cell | ((seen[4] >> shift) & inside)
            shut[t, 4, place] = cell | ((seen[3] >> shift) & inside)


@compiled
def drive(free, shut, source, clashed, more, own, target, dirty, first, last):
    """Take one timestep within one layer and level, in rows `first` to `last`.

    Args:
        free: where there are no walls.
        shut: conflicts of this timestep, int32 [5, E + 2].
        source: where paths go on from.
        clashed: cells reached with a conflict from one layer below.
        more: -1 to let these in, 0 for the lowest layer.
        own: -1 for the last layer, which also keeps its own paths with conflicts.
        target: receives the cells reached.
        dirty: receives those reached with a conflict.
        first: first row.
        last: last row.
    """
    for i in range(first, last + 1):
        here, inside = source[i], free[i]
        right, left, down, up = here << 1, here >> 1, source[i - 1], source[i + 1]
        a, b, c, d, e = shut[0, i], shut[1, i], shut[2, i], shut[3, i], shut[4, i]
        hit = (here & a) | (right & b) | (left & c) | (down & d) | (up & e)
        clean = (here & ~a) | (right & ~b) | (left & ~c) | (down & ~d) | (up & ~e)
        dirty[i] = hit
        target[i] = (clean & inside) | (clashed[i] & more) | (hit & own)


@compiled
def spread(layer, last, free, shut, leave, dirty, served, goals, stay, soonest):
    """Fill one layer: where its paths go on from at every timestep.

    Args:
        layer: this layer; those below are filled.
        last: whether it is the last one, which counts all further conflicts.
        free: see the module.
        shut: see the module.
        leave: see the module; filled, as are the next two.
        dirty: see the module.
        served: see the module.
        goals: (row, bit) of both goals; bit 0 where a goal is not in sight or ends no level.
        stay: timesteps served at both goals.
        soonest: timestep before which the first goal cannot be done.
    """
    window = shut.shape[0]
    below = max(layer - 1, 0)
    more, own = -1 if layer else 0, -1 if last else 0
    for t in range(window):
        first, end = window - t, window + t + 2
        done = False
        for level in range(2):
            row, bit = goals[level]
            cells = leave[layer, level, t + 1]
            if level == 0 or t >= soonest:
                drive(
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
            arrived, disturbed = False, False
            if bit and first <= row <= end:
                arrived = cells[row] & bit != 0
                disturbed = shut[t, 0, row] & bit != 0
                cells[row] &= ~bit  # a goal is left only after service, and in the next level
            longer = served[layer, level, t] << 1
            if disturbed:
                held = served[below, level, t] << 1 if layer else 0
                longer = held | (longer if last else 0)
            served[layer, level, t + 1] = longer | (1 if arrived else 0)
            if level == 0:
                done = (served[layer, 0, t + 1] >> stay[0]) & 1 == 1
            elif done:
                cells[goals[0][0]] |= goals[0][1]
