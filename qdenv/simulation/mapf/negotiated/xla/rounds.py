"""Rounds of negotiation in XLA, for accelerators: a few agents plan side by side in each.

`numba.rounds` does the same on one core of the host, with the same result to the bit.

The reservation table has five planes per timestep t of the window: plane 0 marks cells occupied at
t + 1; planes 1 to 4 mark cells that an agent leaves between t and t + 1 by a move to the right,
left, down or up. An agent that enters such a cell against the move would swap places, so the swap
test is a bit test at the cell entered. Rows of cells are cut into overlapping words: word j holds
columns 11 j to 11 j + 31, so that the 21 columns around any cell lie within a single word.

Reserved paths never conflict, hence every bit has one owner, and bits are set and cleared by adding
and subtracting words.
"""

from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from qdenv.grid import NUM_MOVES
from qdenv.simulation.mapf import chance
from qdenv.simulation.mapf.negotiated import rules
from qdenv.simulation.mapf.negotiated.settings import NegotiatedConfig
from qdenv.simulation.mapf.negotiated.xla.search import find_paths
from qdenv.simulation.mapf.negotiated.xla.window import STRIDE, gather
from qdenv.simulation.mapf.planner import NOBODY, AgentState, World, move_of

_WORD = 32
_COPIES = 3  # words that hold one cell

# Between two rounds: the reservations, how often each agent has planned in this window (int32 [A]),
# and the number of rounds so far.
_Negotiation: TypeAlias = tuple["Reservations", jax.Array, jax.Array]
_Shape: TypeAlias = tuple[int, int]  # (H', W') of the padded grid


def pack(mask: jax.Array) -> jax.Array:
    """Pack a map of cells (bool [H', W']) into overlapping words (uint32 [H', words])."""
    width = mask.shape[1]
    columns = STRIDE * jnp.arange(-(-width // STRIDE))[:, None] + jnp.arange(_WORD)[None, :]
    bits = mask[:, jnp.minimum(columns, width - 1)] & (columns < width)[None]
    return (bits.astype(jnp.uint32) << jnp.arange(_WORD, dtype=jnp.uint32)).sum(
        -1, dtype=jnp.uint32
    )


def add_paths(
    table: jax.Array, paths: jax.Array, mask: jax.Array, shape: _Shape, sign: int = 1
) -> jax.Array:
    """Add (or with ``sign=-1`` remove) the reservations of some paths to a table.

    `paths` are positions of the padded grid (H', W') (int32 [window + 1, K]), `mask` says which of
    them count (bool [K], or [window, K] for single steps).
    """
    rows, width = shape
    words = -(-width // STRIDE)
    plane = move_of(paths[1:] - paths[:-1], width)
    time = jnp.arange(len(plane))[:, None]

    def updates(cells: jax.Array, plane: jax.Array, mask: jax.Array) -> tuple[jax.Array, jax.Array]:
        row, column = cells // width, cells % width
        base = ((time * NUM_MOVES + plane) * rows + row) * words
        word = column[None] // STRIDE - jnp.arange(_COPIES)[:, None, None]
        bit = column[None] - STRIDE * word
        seen = mask[None] & (word >= 0) & (bit < _WORD)
        value = jnp.where(seen, jnp.uint32(1) << bit.astype(jnp.uint32) % _WORD, 0)
        return base[None] + jnp.maximum(word, 0), value

    mask = jnp.broadcast_to(mask, plane.shape)
    entered = updates(paths[1:], jnp.zeros_like(plane), mask)
    left = updates(paths[:-1], plane, mask & (plane > 0))
    places = jnp.concatenate([entered[0].reshape(-1), left[0].reshape(-1)])
    values = jnp.concatenate([entered[1].reshape(-1), left[1].reshape(-1)]).astype(jnp.uint32)
    return table.at[places].add(values if sign > 0 else -values, mode="promise_in_bounds")


class Reservations(NamedTuple):
    """Who has reserved what."""

    table: jax.Array  # uint32 [window * 5 * H' * words], flat, the packed reservations
    owner: jax.Array  # int32 [window + 1, H' * W'], the agent at each cell and time, or `NOBODY`
    paths: jax.Array  # int32 [window + 1, A], the latest path of every agent
    reserved_steps: jax.Array  # int32 [A], steps of that path that are reserved

    @property
    def is_reserved(self) -> jax.Array:
        """Mark the agents whose whole path is reserved (bool [A])."""
        return self.reserved_steps == self.paths.shape[0] - 1


def begin(state: AgentState, shape: _Shape, steps: int) -> Reservations:
    """Reserve the first steps of all previous paths until their agents plan.

    They bind no agent, but show whom to avoid where avoiding costs nothing. Padding agents count
    as if they had their path.
    """
    time = jnp.arange(state.previous.shape[0])[:, None]
    window, cells = state.previous.shape[0] - 1, shape[0] * shape[1]
    live = (time <= steps) & state.active
    place = jnp.where(live, state.previous, cells)
    agents = jnp.broadcast_to(jnp.arange(state.position.shape[0]), place.shape)
    owner = jnp.full((window + 1, cells), NOBODY, jnp.int32)
    empty = jnp.zeros((window * NUM_MOVES * shape[0] * -(-shape[1] // STRIDE),), jnp.uint32)
    return Reservations(
        table=add_paths(empty, state.previous, live[1:], shape),
        owner=owner.at[time, place].set(agents, mode="drop"),
        paths=state.previous,
        reserved_steps=jnp.where(state.active, steps, window),
    )


def release(reservations: Reservations, shape: _Shape, agents: jax.Array) -> Reservations:
    """Remove what some agents have reserved (int32 [K], A for none)."""
    count = reservations.reserved_steps.shape[0]
    time = jnp.arange(reservations.paths.shape[0])[:, None]
    safe = jnp.minimum(agents, count - 1)
    paths = reservations.paths[:, safe]
    steps = jnp.where(agents < count, reservations.reserved_steps[safe], 0)
    place = jnp.where((time <= steps) & (steps > 0), paths, reservations.owner.shape[1])
    return reservations._replace(
        table=add_paths(reservations.table, paths, time[:-1] < steps, shape, sign=-1),
        owner=reservations.owner.at[time, place].set(NOBODY, mode="drop"),
        reserved_steps=reservations.reserved_steps.at[agents].set(0, mode="drop"),
    )


def accept(
    reservations: Reservations, shape: _Shape, agent: jax.Array, paths: jax.Array, mask: jax.Array
) -> Reservations:
    """Reserve new paths and release the agents whose reservations they drive over.

    The paths (int32 [window + 1, K]) of `agent` (int32 [K]) do not conflict with one another;
    `mask` (bool [K]) says which of them count.
    """
    count, lanes = reservations.reserved_steps.shape[0], agent.shape[0]
    time, owner = jnp.arange(paths.shape[0])[:, None], reservations.owner
    met, ahead = owner[time[1:], paths[1:]], owner[time[:-1], paths[1:]]
    # A swap: the agent ahead before the step is behind after it.
    swapped = (ahead != NOBODY) & (owner[time[1:], paths[:-1]] == ahead)
    losers = jnp.stack([met, jnp.where(swapped, ahead, NOBODY)])
    losers = jnp.where(mask & (losers != NOBODY), losers, count).reshape(-1)
    losers = jnp.zeros((count,), bool).at[losers].set(True, mode="drop")

    def release_some(carry: tuple[Reservations, jax.Array]) -> tuple[Reservations, jax.Array]:
        reservations, losers = carry
        agents = jnp.nonzero(losers, size=lanes, fill_value=count)[0]
        return release(reservations, shape, agents), losers.at[agents].set(False, mode="drop")

    # All releases before all entries: a bit has one owner, so it must be free when it is set.
    taken = (reservations, losers)
    free, _ = jax.lax.while_loop(lambda carry: carry[1].any(), release_some, taken)
    place = jnp.where(mask, paths, owner.shape[1])
    winners = jnp.where(mask, agent, count)
    return Reservations(
        table=add_paths(free.table, paths, mask, shape),
        owner=free.owner.at[time, place].set(jnp.broadcast_to(agent, paths.shape), mode="drop"),
        paths=free.paths.at[:, winners].set(paths, mode="drop"),
        reserved_steps=free.reserved_steps.at[winners].set(paths.shape[0] - 1, mode="drop"),
    )


def negotiate(
    config: NegotiatedConfig, world: World, state: AgentState, horizon: int, seed: jax.Array
) -> Reservations:
    """Run rounds of planning until all agents hold a reservation or the rounds are used up.

    The length of the agents' previous paths is the window; `horizon` timesteps will be driven.
    """
    shape = (world.traversable.shape[0], world.traversable.shape[1])
    window, count = state.previous.shape[0] - 1, state.position.shape[0]
    lanes = min(config.lanes, count)
    # The agents' order, and bits that settle ties between paths.
    order_bits, tie_bits = (
        chance.draw(chance.draw(seed, purpose), jnp.arange(count))
        for purpose in (chance.ORDER, chance.TIES)
    )
    rank = jnp.argsort(rules.random_rank(order_bits, state.remaining_service > 0))
    order = jnp.zeros((count,), jnp.int32).at[rank].set(jnp.arange(count, dtype=jnp.int32))
    tie_breaks = (tie_bits >> (32 - rules.TIE_BITS)).astype(jnp.int32)
    walls = pack(world.traversable)
    penalties = jnp.asarray(config.penalty_costs(world.costs is not None))
    limit = jnp.asarray(config.max_rounds(state.active.sum())).astype(jnp.int32)

    def plan_round(negotiation: _Negotiation) -> _Negotiation:
        reservations, attempts, turn = negotiation
        urgency = attempts * count + order  # the fewer attempts the earlier, then by lot
        # Always as many lanes as compiled for: with fewer agents left, some of those that hold a
        # reservation fill them up, and plan in vain.
        agent = _smallest(jnp.where(reservations.is_reserved, 2**30, urgency), lanes)
        plans = ~reservations.is_reserved[agent]
        planning = jnp.where(plans, agent, count)
        if config.remember:  # else no agent that plans has reserved anything
            reservations = release(reservations, shape, planning)
        penalty = penalties[jnp.minimum(attempts[agent], penalties.size - 1)]
        tie_break = tie_breaks[agent] ^ (turn * rules.ROUND_TIE_BREAK)
        local = gather(world, state, reservations.table, walls, agent, penalty, tie_break)
        steps, cost = find_paths(local, config.conflict_levels)
        paths = state.position[agent] + steps[0] * shape[1] + steps[1]
        chosen = choose(path_conflicts(paths, paths), plans & (cost < rules.INFEASIBLE))
        reservations = accept(reservations, shape, agent, paths, chosen)
        return reservations, attempts.at[planning].add(1, mode="drop"), turn + 1

    remembered = begin(state, shape, window - horizon if config.remember else 0)
    return jax.lax.while_loop(
        lambda negotiation: (negotiation[2] < limit) & ~negotiation[0].is_reserved.all(),
        plan_round,
        (remembered, jnp.zeros((count,), jnp.int32), jnp.int32(0)),
    )[0]


def _smallest(keys: jax.Array, count: int) -> jax.Array:
    """Find the indices of the `count` smallest keys (int32 [A]), faster than top_k."""

    def take(keys: jax.Array, _: None) -> tuple[jax.Array, jax.Array]:
        index = jnp.argmin(keys)
        return keys.at[index].set(jnp.iinfo(keys.dtype).max), index

    return jax.lax.scan(take, keys, None, length=count)[1]


def path_conflicts(ours: jax.Array, theirs: jax.Array) -> jax.Array:
    """Find pairs of paths with a vertex or swap conflict (int32 [t+1, A], [t+1, B] -> bool [A, B]).

    The common first row is where the agents stand and is not tested.
    """
    ours, theirs = ours[:, :, None], theirs[:, None, :]
    swapped = (ours[1:] == theirs[:-1]) & (theirs[1:] == ours[:-1])
    return ((ours[1:] == theirs[1:]) | swapped).any(0)


def choose(conflicts: jax.Array, candidates: jax.Array) -> jax.Array:
    """Choose candidates (bool [K]) that conflict (bool [K, K]) with no earlier chosen one.

    The greedy choice in `rules.SWEEPS` sweeps over all at once.
    """
    earlier = conflicts & jnp.tri(len(candidates), k=-1, dtype=bool)
    chosen = candidates
    for _ in range(rules.SWEEPS):
        chosen = candidates & ~(earlier & chosen[None, :]).any(1)
    return chosen
