"""CMA-MAE, its special case CMA-ME, and CMA-ES with an archive beside it.

Fontaine and Nikolaidis 2023, "Covariance matrix adaptation MAP-annealing",
https://arxiv.org/abs/2205.10752; Fontaine, Togelius, Nikolaidis and Hoover 2020, "Covariance matrix
adaptation for the rapid illumination of behavior space", https://arxiv.org/abs/1912.02400; Hansen
2016, "The CMA evolution strategy: a tutorial", https://arxiv.org/abs/1604.00772.

All three are emitters, evolution strategies that an archive ranks and that restart from its
elites, with the choices of pyribs' `EvolutionStrategyEmitter`.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp

from qdenv.search.archive import GridArchive, Insertion
from qdenv.search.base import (
    Algorithm,
    Problem,
    SearchState,
    StoredArchive,
    check_batch,
    plain_key,
    start_solution,
)
from qdenv.search.settings import CmaEsConfig, CmaMaeConfig
from qdenv.search.strategies import make_strategy
from qdenv.search.strategies.base import SMALLEST_STEP, Strategy
from qdenv.types import Array, Extras, InputError, Score, look_up

_FLAT = 1e-12  # best and worst ranking values closer than this restart the emitter (pyribs)

# A ranker turns (insertion, objective) into sort keys, the most important first.
RANKERS: dict[str, Callable[[Insertion, Array], tuple[Array, ...]]] = {
    "imp": lambda insertion, objective: (insertion.value,),
    "2imp": lambda insertion, objective: (insertion.status, insertion.value),
    "obj": lambda insertion, objective: (objective,),
    "2obj": lambda insertion, objective: (insertion.status, objective),
}

# A selection gives the number of parents from (accepted, successes), both int32, and b.
SELECTIONS: dict[str, Callable[[jax.Array, jax.Array, int], jax.Array]] = {
    "mu": lambda accepted, successes, batch: jnp.minimum(batch // 2, successes),
    "filter": lambda accepted, successes, batch: accepted,
}

# A batch as emitters learn from it: (solutions float [E * b, P], `Score` [E * b], how the learning
# archive received them). Rows whose score is not a success have failed.
_Scored = tuple[jax.Array, Score, Insertion]


class EmittersState(NamedTuple):
    """State of E emitters side by side."""

    strategy: Any  # evosax states, pytree with a leading axis E
    keys: Any  # uint32 [E, 2], for the next tell of evosax' own strategies; None for ours
    iterations: jax.Array  # int32
    restarts: jax.Array  # int32 [E]


class Emitters(NamedTuple):
    """E emitters as a record of functions."""

    init: Callable[[jax.Array], Any]  # key -> state, a pytree; consumes the key
    # (state, key) -> (solutions float [E * b, P], state); consumes the key
    ask: Callable[[Any, jax.Array], tuple[jax.Array, Any]]
    # (state, key, rows, archive that holds them already) -> state; consumes the key
    tell: Callable[[Any, jax.Array, _Scored, Any], Any]


def rank(keys: tuple[Array, ...], usable: Array) -> jax.Array:
    """Order rows best first (int32 [b]) by keys [b], the most important first.

    Rows that are not `usable` (bool [b]) come last, ties are reversed (pyribs).
    """
    return jnp.flip(jnp.lexsort((*reversed(keys), usable)))


def is_flat(keys: tuple[Array, ...], order: jax.Array, successes: jax.Array) -> jax.Array:
    """Return True if the best and the worst of at least two usable rows rank the same."""
    last = order[jnp.maximum(successes - 1, 0)]
    gaps = jnp.stack([(key[order[0]] - key[last]).astype(float) for key in keys])
    return (successes >= 2) & (jnp.sqrt(jnp.square(gaps).sum()) < _FLAT)


def restart_rule(rule: str | int) -> Callable[[jax.Array, jax.Array], jax.Array]:
    """Look up the restart rule of a setting: "no_improvement", "basic" or a positive period.

    It decides from accepted rows of each emitter (int32 [E]) and iterations (int32): bool [E].
    """
    if rule == "no_improvement":
        return lambda accepted, iterations: accepted == 0
    if rule == "basic":
        return lambda accepted, iterations: jnp.zeros_like(accepted, bool)
    if isinstance(rule, int) and not isinstance(rule, bool) and rule > 0:
        return lambda accepted, iterations: jnp.full_like(accepted, iterations % rule == 0, bool)
    raise InputError(f"restart rule {rule!r}: use no_improvement, basic or a number of iterations")


def make_member(strategy: Any, params: Any) -> tuple[Callable, Callable, Callable, Callable]:
    """Drive an evosax algorithm by ranks; return its init, ask, tell and is_degenerate.

    Of ours the emitter decides how many of the best are recombined, and failed rows have a fitness
    of NaN. Any other algorithm has its own number of parents: it is fed only if there are any, and
    failed rows rank last and are moved to the mean.

    Init takes (mean float [P], key) and returns (state, next key), ask takes (state, key) and
    returns (solutions, state, next key), tell takes (state, key, rows float [b, P], their ranks
    float [b], 0 for the best, usable bool [b], number of parents int32) and returns the state. A
    state that is degenerate must restart.
    """
    if isinstance(strategy, Strategy):
        # The best so far and its fitness serve optimisation alone: ranks of two generations do
        # not compare, and the archive has the best. Checkpoints do not hold these fields.
        blank = {"best_solution": None, "best_fitness": None, "generation_counter": None}

        def tell_ours(
            state: Any, key: Any, rows: Any, ranks: Any, usable: Any, parents: Any
        ) -> Any:
            fitness = jnp.where(usable, ranks, jnp.nan)
            return strategy._tell(key, rows, fitness, state, params.replace(num_elites=parents))

        return (
            lambda mean, key: (strategy.init(key, mean, params).replace(**blank), None),
            lambda state, key: (*strategy._ask(key, state, params), None),
            tell_ours,
            strategy.is_degenerate,
        )

    def strong(leaf: Any) -> jax.Array:
        """Fix the dtype of a leaf: a Python number in a state would be traced twice."""
        return jnp.asarray(leaf, jnp.asarray(leaf).dtype)

    def init(mean: jax.Array, key: jax.Array) -> tuple:
        state = strategy.init(key, mean, params).replace(best_solution=mean)  # evosax puts NaN
        return jax.tree.map(strong, state), key

    def ask(state: Any, key: jax.Array) -> tuple:
        ask_key, tell_key = jax.random.split(key)
        with jax.numpy_rank_promotion("allow"):  # evosax adds vectors to matrices
            solutions, state = strategy.ask(ask_key, state, params)
        return solutions, state, tell_key

    def tell(state: Any, key: Any, rows: Any, ranks: Any, usable: Any, parents: Any) -> Any:
        rows = jnp.where(usable[:, None], rows, state.mean[None])
        with jax.numpy_rank_promotion("allow"):
            changed, _ = strategy.tell(key, rows, ranks, state, params)
        choose = lambda new, old: strong(jnp.where(parents > 0, new, old))  # noqa: E731
        return jax.tree.map(choose, changed, state)

    def is_degenerate(state: Any) -> jax.Array:
        step = jnp.asarray(state.std).max()
        healthy = (step >= SMALLEST_STEP) & jnp.isfinite(step)
        return ~(healthy & jnp.isfinite(state.mean).all())

    return init, ask, tell, getattr(strategy, "is_degenerate", is_degenerate)


def make_emitters(config: CmaMaeConfig, start: jax.Array) -> Emitters:
    """Make the emitters that a configuration describes, all starting at `start` (float [P]).

    They are E copies of a strategy, each adapting to its own b rows of every batch. Each emitter
    ranks its rows, recombines the best, and restarts from a random elite (from `start` while the
    archive is empty) by the rule, when its rows all rank the same or when its distribution is
    degenerate. Raises InputError if a setting is unknown.
    """
    emitters, batch = config.emitters, config.batch
    member = make_strategy(config.strategy, start.shape[0], batch, config.sigma0)
    init_one, ask_one, tell_one, is_degenerate = make_member(*member)
    ranker = look_up(RANKERS, config.ranker, "ranker")
    selection = look_up(SELECTIONS, config.selection, "selection")
    restart = restart_rule(config.restart)

    def fresh(means: jax.Array, key: jax.Array) -> tuple:
        return jax.vmap(init_one)(means, jax.random.split(key, emitters))

    def init(key: jax.Array) -> EmittersState:
        states, keys = fresh(jnp.broadcast_to(start, (emitters, *start.shape)), key)
        return EmittersState(states, keys, jnp.int32(0), jnp.zeros(emitters, jnp.int32))

    def ask(state: EmittersState, key: jax.Array) -> tuple[jax.Array, EmittersState]:
        solutions, states, keys = jax.vmap(ask_one)(state.strategy, jax.random.split(key, emitters))
        chex.assert_shape(solutions, (emitters, batch, start.shape[0]))
        return solutions.reshape(emitters * batch, -1), state._replace(strategy=states, keys=keys)

    def adapt(state: Any, key: Any, rows: _Scored) -> tuple[Any, jax.Array, jax.Array]:
        """Adapt one emitter to its b rows: (state, accepted rows int32, must restart bool)."""
        solutions, score, insertion = rows
        keys = ranker(insertion, score.objective)
        order = rank(keys, score.success)
        # Failed rows rank last, so the first `successes` places of the order are real.
        successes = score.success.sum(dtype=jnp.int32)
        accepted = (insertion.status > 0).sum(dtype=jnp.int32)
        parents = selection(accepted, successes, batch)
        # As evosax ranks, which minimises.
        ranks = jnp.zeros(batch, solutions.dtype).at[order].set(jnp.arange(batch))
        state = tell_one(state, key, solutions, ranks, score.success, parents)
        return state, accepted, is_degenerate(state) | is_flat(keys, order, successes)

    def tell(
        state: EmittersState, key: jax.Array, rows: _Scored, archive: GridArchive | StoredArchive
    ) -> EmittersState:
        chex.assert_shape(rows[0], (emitters * batch, start.shape[0]))
        rows = jax.tree.map(lambda leaf: leaf.reshape(emitters, batch, *leaf.shape[1:]), rows)
        elite_key, fresh_key = jax.random.split(key)
        # Emitters never see each other's rows, so a vmap over them is exact.
        states, accepted, spent = jax.vmap(adapt)(state.strategy, state.keys, rows)
        iterations = state.iterations + 1
        again = spent | restart(accepted, iterations)
        means = archive.sample_solutions(elite_key, emitters, start)

        def pick(new: jax.Array, old: jax.Array) -> jax.Array:
            return jnp.where(again.reshape(-1, *[1] * (new.ndim - 1)), new, old)

        # Restarts are rare and a fresh full covariance matrix is not free: most iterations skip it.
        states, keys = jax.lax.cond(
            again.any(),
            lambda old: jax.tree.map(pick, fresh(means, fresh_key), old),
            lambda old: old,
            (states, state.keys),
        )
        return EmittersState(states, keys, iterations, state.restarts + again)

    return _make_groups(Emitters(init, ask, tell), config.ahead + 1)


def _make_groups(emitters: Emitters, groups: int) -> Emitters:
    """Join G groups of the same emitters; population i is of group i mod G.

    A group draws again only after its last population was scored, so each adapts to its own
    solutions as it would alone, and up to G populations are evaluated at once. All share one
    archive. The state is that of the groups, with a leading axis G, and the numbers of populations
    drawn and scored so far (int32).
    """
    if groups == 1:
        return emitters

    def init(key: jax.Array) -> tuple:
        states = jax.vmap(emitters.init)(jax.random.split(key, groups))
        return states, jnp.int32(0), jnp.int32(0)

    def ask(state: tuple, key: jax.Array) -> tuple[jax.Array, tuple]:
        states, drawn, scored = state
        index = drawn % groups
        solutions, group = emitters.ask(jax.tree.map(lambda leaf: leaf[index], states), key)
        states = jax.tree.map(lambda leaf, one: leaf.at[index].set(one), states, group)
        return solutions, (states, drawn + 1, scored)

    def tell(state: tuple, key: jax.Array, rows: _Scored, archive: Any) -> tuple:
        states, drawn, scored = state
        index = scored % groups
        group = jax.tree.map(lambda leaf: leaf[index], states)
        group = emitters.tell(group, key, rows, archive)
        states = jax.tree.map(lambda leaf, one: leaf.at[index].set(one), states, group)
        return states, drawn, scored + 1

    return Emitters(init, ask, tell)


def cma_mae(config: CmaMaeConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make CMA-MAE (Fontaine and Nikolaidis 2023), as pyribs' scheduler runs it.

    All E * b rows enter both archives as one batch; then every emitter ranks its own rows by
    how the learning archive received them, and restarts from an elite of that archive. All start at
    `x0` (float [P]; zeros where None). Raises InputError if a setting is unknown.
    """
    start = start_solution(x0, problem.solution_dim)
    emitters = make_emitters(config, start)
    batch_size = config.emitters * config.batch

    def init(key: jax.Array) -> SearchState:
        key, emitters_key = jax.random.split(plain_key(key))
        thresholds = config.learning_rate, config.threshold_min
        archives = StoredArchive.empty(problem, start, batch_size, thresholds)
        return SearchState(key, emitters.init(emitters_key), archives)

    def ask(state: SearchState) -> tuple[jax.Array, SearchState]:
        key, ask_key = jax.random.split(state.key)
        solutions, changed = emitters.ask(state.emitters, ask_key)
        return solutions, state._replace(key=key, emitters=changed)

    def tell(state: SearchState, solutions: Array, score: Score, extras: Extras) -> SearchState:
        solutions, score = check_batch(solutions, score)
        key, tell_key = jax.random.split(state.key)
        archives, insertion = state.archives.add(solutions, score, extras)
        # Rows are ranked against the archive before the batch, but restarts draw from the archive
        # that holds it: the order of pyribs' scheduler.
        rows = solutions, score, insertion
        return SearchState(key, emitters.tell(state.emitters, tell_key, rows, archives), archives)

    return Algorithm(
        init, ask, tell, lambda state: state.archives.dense(), batch_size, ahead=config.ahead
    )


def cma_es(config: CmaEsConfig, problem: Problem, x0: Array | None = None) -> Algorithm:
    """Make CMA-ES: emitters that rank by the objective and recombine the better half.

    Measures matter only where one restarts, from a random elite. All start at `x0` (float [P];
    zeros where None).
    """
    # The archive has to be there, though nothing ranks by it: the plainest, an elitist one.
    settings = CmaMaeConfig(
        **vars(config), learning_rate=1.0, threshold_min=-math.inf, ranker="obj", selection="mu"
    )
    return cma_mae(settings, problem, x0)
