"""The evolution strategies by name; a user's own is one more entry of `STRATEGIES`."""

from collections.abc import Callable

from qdenv.search.strategies.base import Strategy
from qdenv.search.strategies.evosax import EVOSAX_NAMES, evosax_strategy
from qdenv.search.strategies.full import full
from qdenv.search.strategies.isotropic import isotropic
from qdenv.search.strategies.limited_memory import limited_memory
from qdenv.search.strategies.separable import separable

# Each is called with (parameters P, batch b, initial step size).
STRATEGIES: dict[str, Callable[[int, int, float], Strategy]] = {
    "iso": isotropic,
    "sep": separable,
    "full": full,
    "lm_ma": limited_memory,
    **{name: evosax_strategy(name) for name in EVOSAX_NAMES},
}
