"""Teams of emitters that take turns: while one is evaluated, the next can be asked."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from qdenv.search.emitters import Emitters


class TurnsState(NamedTuple):
    """State of G teams."""

    teams: Any  # pytree of a team's state, leading axis G
    asked: jax.Array  # int32, how often the teams were asked together
    told: jax.Array  # int32, how often they were told


def take_turns(emitters: Emitters, teams: int) -> Emitters:
    """Join G teams of the same emitters; population i is asked of team i mod G and told to it.

    A team is asked again only when it has been told, so each adapts to its own solutions as it
    would alone, and up to G populations are under way at once. All share one archive.

    Args:
        emitters: of one team.
        teams: G; 1 gives `emitters` as they are.
    """
    if teams == 1:
        return emitters

    def init(key: jax.Array) -> TurnsState:
        states = jax.vmap(emitters.init)(jax.random.split(key, teams))
        return TurnsState(states, jnp.int32(0), jnp.int32(0))

    def ask(state: TurnsState, key: jax.Array) -> tuple[jax.Array, TurnsState]:
        turn = state.asked % teams
        solutions, team = emitters.ask(_team(state, turn), key)
        return solutions, _with_team(state, turn, team)._replace(asked=state.asked + 1)

    def tell(state: TurnsState, *given: Any) -> TurnsState:
        turn = state.told % teams
        team = emitters.tell(_team(state, turn), *given)
        return _with_team(state, turn, team)._replace(told=state.told + 1)

    return Emitters(init, ask, tell)


def _team(state: TurnsState, turn: jax.Array) -> Any:
    return jax.tree.map(lambda leaf: leaf[turn], state.teams)


def _with_team(state: TurnsState, turn: jax.Array, team: Any) -> TurnsState:
    teams = jax.tree.map(lambda leaf, one: leaf.at[turn].set(one), state.teams, team)
    return state._replace(teams=teams)
