"""Generate environments that make robot fleets flow.

One loop, a file or folder per stage:

    parameters ─▶ generate ─▶ repair ─▶ simulate ─▶ score ─▶ search ─▶ next parameters
                  (device)    (host     (host or   (device)  (device)
                              callback)  device)

A neural cellular automaton draws a floor plan, a repair (simulated annealing, then a mixed-integer
program where `polish` is full) changes little until every rule holds, a fleet of robots is
simulated in it, and CMA-MAE keeps an archive of different good automata. `domains` says what
differs between warehouse, manufacturing and maze; `pipeline` is the chain on one screen; `train`
is the loop with its run directory, and `study` evaluates saved layouts and runs. Every command
but `completion` is a function of the same name (`qdenv layout human`: `qdenv.layout_human`).

    >>> import qdenv
    >>> run = qdenv.train("quick", "runs/first")
    >>> plan = qdenv.generate(run, rows=33, cols=36)
    >>> qdenv.simulate(plan, agents=100)

A domain, planner, generator or algorithm of your own is a settings record and a function that
makes it, paired in an `Entry`: register it (`qdenv.DOMAINS.register(name, entry)`), or name it as
an entry point of your package, so that the `qdenv` command knows it too.
"""

import lazy_loader

# __init__.pyi lists the public names, which type checkers read as well. Each is imported when it is
# first used: `import qdenv` alone is instant.
_import, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Import a public name, or look up the version."""
    if name == "__version__":
        from importlib.metadata import version  # here: it takes longer than all else

        return version("qdenv")
    return _import(name)
