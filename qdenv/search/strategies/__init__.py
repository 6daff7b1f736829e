"""Evolution strategies: evosax algorithms, ours and evosax' own.

Numbers in brackets, like (43), are equations of Hansen's tutorial,
https://arxiv.org/abs/1604.00772v1. Where pyribs departs from it, so do ours, with a comment.
"""

from collections.abc import Callable
from typing import Any

import evosax.algorithms
import jax.numpy as jnp
import optax

from qdenv.search.strategies.cma_es import Full, Isotropic, LimitedMemory, Separable
from qdenv.types import InputError, look_up

_MIRRORED = ("CR_FM_NES", "Open_ES", "PGPE")  # draw every solution together with its mirror image
_ADAM_RATE = 0.1  # in initial step sizes; with evosax' own optimizers these do not move

# Each is called with (population_size=b, solution=float [P]), like every evosax algorithm over a
# distribution.
STRATEGIES: dict[str, Callable[..., Any]] = {
    "iso": Isotropic,
    "sep": Separable,
    "full": Full,
    "lm_ma": LimitedMemory,
    **{
        name: getattr(evosax.algorithms, name)
        for name in ("CMA_ES", "CR_FM_NES", "DiscoveredES", "Open_ES", "PGPE", "SimpleES", "SNES")
    },
}


def make_strategy(name: str, dim: int, batch: int, sigma0: float) -> tuple[Any, Any]:
    """Make the strategy `name` for `dim` parameters P: (evosax algorithm, its parameters).

    Raises InputError if the name is unknown, or the strategy unfit for the batch b.
    """
    make = look_up(STRATEGIES, name, "strategy")
    if name in _MIRRORED and batch % 2:
        raise InputError(f"the strategy {name} needs an even batch, not {batch}")
    settings: dict[str, Any] = {}
    if name in ("Open_ES", "PGPE"):
        settings["optimizer"] = optax.adam(_ADAM_RATE * sigma0)
    if name == "Open_ES":
        settings["std_schedule"] = optax.constant_schedule(sigma0)
    strategy = make(population_size=batch, solution=jnp.zeros(dim), **settings)
    params = strategy.default_params
    if hasattr(params, "std_init"):
        params = params.replace(std_init=jnp.full_like(jnp.asarray(params.std_init), sigma0))
    return strategy, params
