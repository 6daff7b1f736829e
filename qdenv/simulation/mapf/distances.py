"""Shortest distances in XLA: from many goals to every cell at once, one bit per goal.

Small layouts get a table of all goals; for large ones every agent has two rows, which are measured
again when it gets a new goal. `host.distances` measures them on the host.
"""

from typing import NamedTuple, Self, TypeAlias

import jax
import jax.numpy as jnp

from qdenv.grid import MOVES, fixed_point, move_steps, shift
from qdenv.simulation.mapf.planner import NOBODY, UNREACHABLE_COST, World, distance_type

_Planes: TypeAlias = tuple[jax.Array, ...]
# A search between two epochs: uint32 [G / 32, H, W], one bit for each goal that reaches a cell;
# [G, H * W], steps for which it was out of reach; whether the last epoch reached new cells.
_Wave: TypeAlias = tuple[jax.Array, jax.Array, jax.Array]

_PLANES = 4  # bits of the step counter that is unpacked once per epoch
_WORD = 32
_AT_ONCE = 8 * _WORD  # rows measured side by side


def goal_distances(traversable: jax.Array, cells: jax.Array, used: jax.Array) -> jax.Array:
    """Measure the way from every cell of a map (bool [H, W]) to every goal, breadth first.

    All goals spread at the same time, 32 to a word. How long a cell stayed out of reach is counted
    in four bit planes that are added to the distances after every 15 steps: adding them at each
    step would unpack bits nearly four times as often.

    `used` (bool [G]) marks the slots of `cells` (int32 [G]) that hold a goal. Returns the distances
    (`distance_type`) [G, H * W]; where no way leads, and in unused slots, the number for that.
    """
    rows, cols = traversable.shape
    count, size, (kind, far) = cells.shape[0], rows * cols, distance_type(traversable.size)
    open_cells = jnp.where(traversable, jnp.uint32(0xFFFFFFFF), jnp.uint32(0))
    # Bit ``g % 32`` of word ``g // 32`` at the cell of goal g.
    slot = jnp.arange(count)
    bit = jnp.where(used, jnp.uint32(1) << (slot % _WORD).astype(jnp.uint32), jnp.uint32(0))
    empty = jnp.zeros((-(-count // _WORD), size), jnp.uint32)
    start = empty.at[slot // _WORD, cells].add(bit).reshape(-1, rows, cols) & open_cells[None]

    def step(_: jax.Array, carry: tuple[jax.Array, _Planes]) -> tuple[jax.Array, _Planes]:
        reached, planes = carry
        carry_bit, sums = ~reached, []
        for plane in planes:  # a ripple-carry counter, one bit plane after the other
            sums.append(plane ^ carry_bit)
            carry_bit = plane & carry_bit
        after = reached
        for move in MOVES:
            after = after | jax.vmap(lambda word, move=move: shift(word, move))(reached)
        return after & open_cells[None], tuple(sums)

    def unpack(words: jax.Array) -> jax.Array:
        bits = (words[:, None] >> jnp.arange(_WORD, dtype=jnp.uint32)[None, :, None, None]) & 1
        return bits.astype(kind).reshape(-1, size)[:count]

    def epoch(wave: _Wave) -> _Wave:
        before, distance, _ = wave
        planes = (jnp.zeros_like(before),) * _PLANES
        reached, planes = jax.lax.fori_loop(0, 2**_PLANES - 1, step, (before, planes))
        for bit, plane in enumerate(planes):
            distance = distance + (unpack(plane) << bit)
        return reached, distance, (reached != before).any()

    first = (start, jnp.zeros((count, size), kind), jnp.bool_(True))
    reached, distance, _ = jax.lax.while_loop(lambda wave: wave[2], epoch, first)
    return jnp.where(unpack(reached) == 1, distance, kind(far))


def goal_costs(
    traversable: jax.Array, costs: jax.Array, cells: jax.Array, used: jax.Array
) -> jax.Array:
    """Measure the cheapest way from every cell to every goal, by relaxation until nothing changes.

    As `goal_distances`, on a map with walls all around, but by the `costs` of each move at each
    cell (int32 [5, H * W], 0 where it is not allowed). Returns int32 [G, H * W];
    `UNREACHABLE_COST` where no way leads, and in unused slots.
    """
    size, free = traversable.size, traversable.reshape(-1)
    neighbour = jnp.arange(size)[None] + jnp.asarray(move_steps(traversable.shape[1]))[1:, None]
    neighbour = jnp.clip(neighbour, 0, size - 1)
    exists = free[None] & free[neighbour] & (costs[1:] > 0)
    ahead = jnp.where(exists, costs[1:], UNREACHABLE_COST)
    start = jnp.full((cells.shape[0], size), UNREACHABLE_COST, jnp.int32)
    begin = jnp.where(used & free[cells], 0, UNREACHABLE_COST)
    start = start.at[jnp.arange(cells.shape[0]), cells].set(begin)
    return fixed_point(
        lambda cost: jnp.minimum(cost, (cost[:, neighbour] + ahead[None]).min(axis=1)), start
    )


class Fields(NamedTuple):
    """Distances to the goals that agents have; two rows for each of A agents."""

    distance: jax.Array  # [2 A, H' * W'], steps from every cell, see `distance_type`
    # int32 [2, A], the slot of the goal that each row was measured for, or `NOBODY`
    goal: jax.Array
    # bool [A], whether the current goal is in the second of an agent's rows: what was the next goal
    # becomes the current one without a copy
    flipped: jax.Array

    @classmethod
    def empty(cls, world: World, agents: int) -> Self:
        """Make rows for A agents, none of them measured."""
        size = world.traversable.size
        number, far = distance_type(size, world.costs is not None)
        distance = jnp.full((2 * agents, size), far, number)
        return cls(distance, jnp.full((2, agents), NOBODY, jnp.int32), jnp.zeros((agents,), bool))


def rows_of(fields: Fields) -> jax.Array:
    """Find the rows of the agents' current and next goals (int32 [2, A])."""
    agents = fields.flipped.shape[0]
    second = jnp.arange(2)[:, None] ^ fields.flipped[None]
    return second * agents + jnp.arange(agents)[None]


def measure_fields(world: World, fields: Fields, goal: jax.Array) -> Fields:
    """Measure the rows of goals (slots, int32 [2, A]) that changed since."""
    count = goal.size
    first = fields.goal.reshape(-1)[rows_of(fields)]
    fields = fields._replace(
        flipped=fields.flipped ^ ((first[0] != goal[0]) & (first[1] == goal[0]))
    )
    current = jnp.zeros((count,), jnp.int32).at[rows_of(fields)].set(goal)

    def measure(carry: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        distance, measured = carry
        row = jnp.nonzero(measured != current, size=min(_AT_ONCE, count), fill_value=count)[0]
        slot = current[jnp.minimum(row, count - 1)]
        cells = world.goals.cells[slot]
        used = (row < count) & world.goals.used[slot] & world.traversable.reshape(-1)[cells]
        if world.costs is None:
            steps = goal_distances(world.traversable, cells, used)
        else:
            steps = goal_costs(world.traversable, world.costs, cells, used)
        distance = distance.at[row].set(steps, mode="drop")
        return distance, measured.at[row].set(slot, mode="drop")

    begin = fields.distance, fields.goal.reshape(-1)
    distance, measured = jax.lax.while_loop(
        lambda carry: (carry[1] != current).any(), measure, begin
    )
    return fields._replace(distance=distance, goal=measured.reshape(2, -1))
