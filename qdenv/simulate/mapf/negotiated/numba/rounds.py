"""Bargaining for a window, compiled for one core of the host: `bargain.bargain`, bit for bit.

On a CPU it takes a quarter of the time of XLA's program: nothing is computed for lanes without an
agent, rows out of reach and layers that cannot pay, and small steps cost no kernel launches.

numba's disk cache watches only this file: after editing `book`, `front` or `path`, touch it.
"""

from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax.experimental.buffer_callback import buffer_callback

from qdenv.native import compiled
from qdenv.simulate.mapf.negotiated.numba.backtrack import find_path
from qdenv.simulate.mapf.negotiated.numba.reservations import PLANES, enter, evict, pack, strike_out
from qdenv.simulate.mapf.negotiated.numba.search import make_room
from qdenv.simulate.mapf.negotiated.xla.reservations import NOBODY
from qdenv.simulate.mapf.negotiated.xla.rounds import (
    PlanResult,
    draw_lots,
    most_rounds,
    quarter_steps,
)
from qdenv.simulate.mapf.negotiated.xla.window import NOISE_STEP
from qdenv.simulate.mapf.planner import AgentState, World
from qdenv.types import Array

if TYPE_CHECKING:
    from qdenv.simulate.mapf.negotiated.planner import WindowedPlanner


def bargain(
    settings: "WindowedPlanner", world: World, state: AgentState, horizon: int, key: Array
) -> PlanResult:
    """Do what `bargain.bargain` does, in a callback that works on jax's own buffers."""
    window, count = state.previous.shape[0] - 1, state.position.shape[0]
    lanes, penalties = min(settings.lanes, count), quarter_steps(settings)
    steps = window - horizon if settings.remember else 0

    def on_host(_: Any, result: PlanResult, limit: Any, *arrays: Any) -> None:
        # Only numpy here: a jax call inside a callback can wait for the very device it blocks.
        plain = [np.asarray(array) for array in arrays]
        numbers = (penalties, lanes, int(np.asarray(limit)), settings.layers, steps)
        run_rounds(*plain, *numbers, np.asarray(result.paths), np.asarray(result.holds))

    result = PlanResult(
        jax.ShapeDtypeStruct((window + 1, count), np.int32), jax.ShapeDtypeStruct((count,), bool)
    )
    call = buffer_callback(on_host, result, vmap_method="sequential")
    return call(
        most_rounds(settings, state),
        world.traversable,
        world.goals.cells,
        world.distance,
        state.position,
        state.active,
        state.goal,
        state.service_time,
        state.remaining_service,
        state.previous,
        *draw_lots(state, key),
    )


@compiled
def clash(ours, theirs):
    """Whether two paths have a vertex or swap conflict after their first cell."""
    for t in range(1, ours.size):
        if ours[t] == theirs[t] or (ours[t] == theirs[t - 1] and ours[t - 1] == theirs[t]):
            return True
    return False


@compiled
def choose(asking, able, found):
    """Choose paths that clash with none chosen before, by `base.first_of_each_clash`."""
    clashes = np.zeros((asking, asking), np.bool_)
    for i in range(asking):
        for j in range(i):
            clashes[i, j] = able[i] and able[j] and clash(found[i], found[j])
    chosen = able[:asking].copy()
    for _ in range(3):
        before = chosen.copy()
        for i in range(asking):
            chosen[i] = able[i]
            for j in range(i):
                chosen[i] &= not (clashes[i, j] and before[j])
    return chosen


@compiled
def most_urgent(urgency, until, window, who):
    """Fill `who` with the agents without a whole reservation that come first; returns how many."""
    count, lanes = 0, who.size
    for agent in range(until.size):
        if until[agent] == window:
            continue
        place = min(count, lanes)
        while place > 0 and urgency[who[place - 1]] > urgency[agent]:
            if place < lanes:
                who[place] = who[place - 1]
            place -= 1
        if place < lanes:
            who[place] = agent
            count = min(count + 1, lanes)
    return count


@compiled
def run_rounds(
    traversable,
    cells,
    distance,
    position,
    active,
    slots,
    stay,
    serving,
    previous,
    order,
    noise,
    penalties,
    lanes,
    limit,
    layers,
    steps,
    shown,
    holds,
):
    """Run rounds of planning until everybody holds a reservation or the rounds are used up.

    Args:
        traversable: `World.traversable`.
        cells: the goal cells of `World.goals`.
        distance: `World.distance`.
        position: as the next five, of `AgentState`.
        active: see there.
        slots: its goals.
        stay: see there.
        serving: see there.
        previous: see there.
        order: int32 [A], who comes first among agents with equally many attempts.
        noise: int32 [A], random bits that settle ties.
        penalties: int32 [attempts], quarter steps for driving over one reservation.
        lanes: agents that plan against the same reservations in one round.
        limit: most rounds.
        layers: how finely reservations driven over are counted.
        steps: steps of the previous paths that are entered before anybody plans.
        shown: int32 [w + 1, A], receives the paths.
        holds: bool [A], receives whose path is reserved.
    """
    count, window = position.size, previous.shape[0] - 1
    rows, width = traversable.shape
    walls = pack(traversable)
    table = np.zeros((window, *walls.shape, PLANES), np.int64)
    owner = np.full((window + 1, rows * width), NOBODY, np.int32)
    paths = np.empty((count, window + 1), np.int64)
    until = np.full(count, window)
    attempts = np.zeros(count, np.int64)
    urgency = order.astype(np.int64)
    for agent in range(count):
        paths[agent] = previous[:, agent]
        if active[agent]:
            enter(table, owner, paths, until, agent, paths[agent], steps, width)
    room = make_room(window, layers)
    who = np.zeros(lanes, np.int64)
    found = np.zeros((lanes, window + 1), np.int64)
    able = np.zeros(lanes, np.bool_)
    for turn in range(limit):
        asking = most_urgent(urgency, until, window, who)
        if asking == 0:
            break
        for lane in range(asking):
            strike_out(table, owner, paths, until, who[lane], width)
        for lane in range(asking):
            agent = who[lane]
            able[lane] = find_path(
                table,
                walls,
                width,
                distance,
                cells,
                position[agent],
                (np.int64(slots[0, agent]), np.int64(slots[1, agent])),
                (np.int64(stay[0, agent]), np.int64(stay[1, agent])),
                np.int64(serving[agent]),
                np.int64(penalties[min(attempts[agent], penalties.size - 1)]),
                np.int64(noise[agent]) ^ (turn * NOISE_STEP),
                layers,
                room,
                found[lane],
            )
            attempts[agent] += 1
            urgency[agent] += count
        accepted = choose(asking, able, found)
        for lane in range(asking):
            if accepted[lane]:
                evict(table, owner, paths, until, found[lane], width)
        for lane in range(asking):
            if accepted[lane]:
                enter(table, owner, paths, until, who[lane], found[lane], window, width)
    shown[:] = paths.T
    holds[:] = until == window
