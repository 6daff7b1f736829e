"""Generate environments that make robot fleets flow.

One loop, one folder per stage:

    parameters ─▶ generate ─▶ repair ─▶ simulate ─▶ score ─▶ search ─▶ next parameters
                  (device)    (host     (device)   (device)  (device)
                              callback)

A neural cellular automaton draws a floor plan, a mixed-integer program changes as little as
possible until every rule holds, a fleet of robots is simulated in it, and CMA-MAE keeps an
archive of different good automata. `domains` says what differs between warehouse, manufacturing
and maze; `pipeline` is the chain on one screen; `run` is the loop with its run directory.

    >>> import qdenv
    >>> run = qdenv.train(qdenv.find_preset("quick"), "runs/first")
    >>> qdenv.plot_run(run)
"""

import importlib
from typing import Any

# Public name -> (module, name there).
_HOMES = {
    "DOMAINS": ("qdenv.domains", "DOMAINS"),
    "InputError": ("qdenv.types", "InputError"),
    "PRESETS": ("qdenv.presets", "PRESETS"),
    "RunConfig": ("qdenv.train.config", "RunConfig"),
    "RunDirectory": ("qdenv.train.records", "RunDirectory"),
    "audit": ("qdenv.repair.audit", "audit"),
    "find_preset": ("qdenv.presets", "find_preset"),
    "grow_elite": ("qdenv.study.elites", "grow_elite"),
    "plot_run": ("qdenv.plots.run", "plot_run"),
    "read_layout": ("qdenv.formats.layouts", "read_layout"),
    "repair_layout": ("qdenv.repair.recipe", "repair"),
    "resume": ("qdenv.train.loop", "resume"),
    "simulate_layout": ("qdenv.study.traffic", "simulate_layout"),
    "train": ("qdenv.train.loop", "train"),
    "write_layout": ("qdenv.formats.layouts", "write_layout"),
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for: `import qdenv` alone is instant."""
    if name not in _HOMES:
        raise AttributeError(f"module 'qdenv' has no attribute {name!r}")
    module, original = _HOMES[name]
    return getattr(importlib.import_module(module), original)


def __dir__() -> list[str]:
    """List the public names."""
    return __all__
