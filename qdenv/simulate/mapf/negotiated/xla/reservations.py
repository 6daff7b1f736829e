"""The reservation table of a window: who holds which cells and moves."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from qdenv.simulate.mapf.negotiated import rules
from qdenv.simulate.mapf.negotiated.xla import bitplanes
from qdenv.simulate.mapf.planner import NOBODY, AgentState

Shape = tuple[int, int]  # (H', W') of the padded grid


class Reservations(NamedTuple):
    """Who has reserved what."""

    table: jax.Array  # uint32, flat, the packed reservations (`bitplanes`)
    owner: jax.Array  # int32 [window + 1, H' * W'], the agent at each cell and time, or `NOBODY`
    paths: jax.Array  # int32 [window + 1, A], the latest path of every agent
    reserved_steps: jax.Array  # int32 [A], steps of that path that are reserved

    @property
    def is_reserved(self) -> jax.Array:
        """Mark the agents whose whole path is reserved (bool [A])."""
        return self.reserved_steps == self.paths.shape[0] - 1


class Accepted(NamedTuple):
    """New paths that do not conflict with one another."""

    agent: jax.Array  # int32 [K]
    paths: jax.Array  # int32 [window + 1, K]
    mask: jax.Array  # bool [K], which of them count


def no_reservations(state: AgentState, shape: Shape) -> Reservations:
    """Begin without any; padding agents count as if they had their path."""
    window = state.previous.shape[0] - 1
    return Reservations(
        table=bitplanes.empty(window, *shape),
        owner=jnp.full((window + 1, shape[0] * shape[1]), NOBODY, jnp.int32),
        paths=jnp.broadcast_to(state.position, state.previous.shape),
        reserved_steps=jnp.where(state.active, 0, window),
    )


def remember(
    reservations: Reservations, state: AgentState, shape: Shape, steps: int
) -> Reservations:
    """Reserve the first steps of everybody's previous path until they plan themselves.

    They bind nobody, but tell whom to avoid where avoiding costs nothing.
    """
    count = state.position.shape[0]
    time = jnp.arange(state.previous.shape[0])[:, None]
    live = (time <= steps) & state.active
    place = jnp.where(live, state.previous, reservations.owner.shape[1])
    agents = jnp.broadcast_to(jnp.arange(count), place.shape)
    return Reservations(
        table=bitplanes.add_paths(reservations.table, state.previous, live[1:], shape),
        owner=reservations.owner.at[time, place].set(agents, mode="drop"),
        paths=state.previous,
        reserved_steps=jnp.where(state.active, steps, reservations.reserved_steps),
    )


def reserve(reservations: Reservations, shape: Shape, accepted: Accepted) -> Reservations:
    """Reserve accepted paths, which conflict with no reservation any more."""
    count, (agent, paths, mask) = reservations.reserved_steps.shape[0], accepted
    time = jnp.arange(paths.shape[0])[:, None]
    place = jnp.where(mask, paths, reservations.owner.shape[1])
    winners = jnp.where(mask, agent, count)
    owners = jnp.broadcast_to(agent, paths.shape)
    return Reservations(
        table=bitplanes.add_paths(reservations.table, paths, mask, shape),
        owner=reservations.owner.at[time, place].set(owners, mode="drop"),
        paths=reservations.paths.at[:, winners].set(paths, mode="drop"),
        reserved_steps=reservations.reserved_steps.at[winners].set(paths.shape[0] - 1, mode="drop"),
    )


def release(reservations: Reservations, shape: Shape, agents: jax.Array) -> Reservations:
    """Remove what some agents have reserved (int32 [K], A for nobody)."""
    count = reservations.reserved_steps.shape[0]
    time = jnp.arange(reservations.paths.shape[0])[:, None]
    safe = jnp.minimum(agents, count - 1)
    paths = reservations.paths[:, safe]
    steps = jnp.where(agents < count, reservations.reserved_steps[safe], 0)
    place = jnp.where((time <= steps) & (steps > 0), paths, reservations.owner.shape[1])
    return reservations._replace(
        table=bitplanes.add_paths(reservations.table, paths, time[:-1] < steps, shape, sign=-1),
        owner=reservations.owner.at[time, place].set(NOBODY, mode="drop"),
        reserved_steps=reservations.reserved_steps.at[agents].set(0, mode="drop"),
    )


def evict(reservations: Reservations, shape: Shape, accepted: Accepted) -> Reservations:
    """Release the agents whose reservations accepted paths drive over, a few at a time."""
    count, lanes = reservations.reserved_steps.shape[0], accepted.agent.shape[0]

    def some(carry: tuple[Reservations, jax.Array]) -> tuple[Reservations, jax.Array]:
        reservations, losers = carry
        agents = jnp.nonzero(losers, size=lanes, fill_value=count)[0]
        return release(reservations, shape, agents), losers.at[agents].set(False, mode="drop")

    losers = find_losers(reservations, accepted)
    return jax.lax.while_loop(lambda carry: carry[1].any(), some, (reservations, losers))[0]


def find_losers(reservations: Reservations, accepted: Accepted) -> jax.Array:
    """Mark the agents whose reservations accepted paths drive over (bool [A])."""
    count, (_, paths, mask) = reservations.reserved_steps.shape[0], accepted
    time = jnp.arange(paths.shape[0])[:, None]
    met = reservations.owner[time[1:], paths[1:]]
    ahead = reservations.owner[time[:-1], paths[1:]]
    swapped = rules.is_swapped(ahead, reservations.owner[time[1:], paths[:-1]])
    losers = jnp.stack([met, jnp.where(swapped, ahead, NOBODY)])
    losers = jnp.where(mask & (losers != NOBODY), losers, count).reshape(-1)
    return jnp.zeros((count,), bool).at[losers].set(True, mode="drop")
