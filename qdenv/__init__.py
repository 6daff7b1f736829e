"""Generate environments that make robot fleets flow.

One loop, one folder per stage:

    parameters ─▶ generate ─▶ repair ─▶ simulate ─▶ score ─▶ search ─▶ next parameters
                  (device)    (host     (device)   (device)  (device)
                              callback)

A neural cellular automaton draws a floor plan, a mixed-integer program changes as little as
possible until every rule holds, a fleet of robots is simulated in it, and CMA-MAE keeps an
archive of different good automata. `domains` says what differs between warehouse, manufacturing
and maze; `pipeline` is the chain on one screen; `train` is the loop with its run directory, and
`study` what is asked of saved layouts and runs.

    >>> import qdenv
    >>> run = qdenv.train("quick", "runs/first")
    >>> plan = qdenv.generate(run, rows=33, cols=36)
    >>> qdenv.simulate(plan, agents=100)

A domain, planner, generator or algorithm of your own is a settings record and a function that
makes it, paired in an `Entry`: register it (`qdenv.DOMAINS.register(name, entry)`), or name it as
an entry point of your package, so that the `qdenv` command knows it too.
"""

import importlib
import sys
from importlib import metadata
from types import ModuleType
from typing import Any

# Public name -> (module, name there).
_HOMES = {
    # Use it.
    "EvaluationConfig": ("qdenv.settings", "EvaluationConfig"),
    "InputError": ("qdenv.types", "InputError"),
    "PRESETS": ("qdenv.presets", "PRESETS"),
    "RunConfig": ("qdenv.run.config", "RunConfig"),
    "RunDirectory": ("qdenv.run.directory", "RunDirectory"),
    "check": ("qdenv.api.layouts", "check"),
    "compare": ("qdenv.api.layouts", "compare"),
    "render": ("qdenv.api.layouts", "render"),
    "replay": ("qdenv.api.pages", "replay"),
    "make_environment": ("qdenv.api.layouts", "make_environment"),
    "read_plan": ("qdenv.api.plans", "read_plan"),
    "Layout": ("qdenv.api.results", "Layout"),
    "audit": ("qdenv.repair.audit", "audit"),
    "evaluate": ("qdenv.pipeline", "evaluate"),
    "explore": ("qdenv.api.pages", "explore"),
    "find_domain": ("qdenv.domains.base", "find_domain"),
    "find_preset": ("qdenv.presets", "find_preset"),
    "grow_elite": ("qdenv.study.elites", "grow_elite"),
    "make_domain": ("qdenv.domains.base", "make_domain"),
    "make_experiment": ("qdenv.run.loop", "make_experiment"),
    "make_iteration": ("qdenv.run.loop", "make_iteration"),
    "make_pipeline": ("qdenv.pipeline", "make_pipeline"),
    "plot_run": ("qdenv.view.runs", "plot_run"),
    "report": ("qdenv.api.pages", "report"),
    "read_layout": ("qdenv.io.layouts", "read_layout"),
    "repair_layout": ("qdenv.repair.recipe", "repair_layout"),
    "resume": ("qdenv.run.loop", "resume"),
    "simulate_layout": ("qdenv.study.traffic", "simulate_layout"),
    "train": ("qdenv.api.runs", "train"),
    "write_layout": ("qdenv.io.layouts", "write_layout"),
    # Extend it: any of the four.
    "Entry": ("qdenv.registry", "Entry"),
    # A domain.
    "DOMAINS": ("qdenv.domains.base", "DOMAINS"),
    "Adjacency": ("qdenv.types", "Adjacency"),
    "Count": ("qdenv.types", "Count"),
    "Domain": ("qdenv.domains.base", "Domain"),
    "DomainConfig": ("qdenv.domains.base", "DomainConfig"),
    "KnownSize": ("qdenv.domains.base", "KnownSize"),
    "FleetConfig": ("qdenv.simulate.mapf.settings", "FleetConfig"),
    "Goal": ("qdenv.types", "Goal"),
    "Measure": ("qdenv.types", "Measure"),
    "Rules": ("qdenv.types", "Rules"),
    "Simulator": ("qdenv.domains.base", "Simulator"),
    "TaskRule": ("qdenv.types", "TaskRule"),
    "Traffic": ("qdenv.types", "Traffic"),
    "beside_goal": ("qdenv.simulate.mapf.goals", "beside_goal"),
    "fleet_simulator": ("qdenv.domains.fleet", "fleet_simulator"),
    "tile_goal": ("qdenv.simulate.mapf.goals", "tile_goal"),
    # A planner.
    "PLANNERS": ("qdenv.simulate.mapf.settings", "PLANNERS"),
    "AgentState": ("qdenv.simulate.mapf.planner", "AgentState"),
    "NegotiatedConfig": ("qdenv.simulate.mapf.negotiated.settings", "NegotiatedConfig"),
    "PbsConfig": ("qdenv.simulate.mapf.pbs.settings", "PbsConfig"),
    "PibtConfig": ("qdenv.simulate.mapf.pibt.settings", "PibtConfig"),
    "Planner": ("qdenv.simulate.mapf.planner", "Planner"),
    "World": ("qdenv.simulate.mapf.planner", "World"),
    # A generator.
    "GENERATORS": ("qdenv.generate", "GENERATORS"),
    "Canvas": ("qdenv.generate", "Canvas"),
    "Generator": ("qdenv.generate", "Generator"),
    "NcaConfig": ("qdenv.generate", "NcaConfig"),
    # An algorithm.
    "ALGORITHMS": ("qdenv.search.registry", "ALGORITHMS"),
    "Algorithm": ("qdenv.search.base", "Algorithm"),
    "Problem": ("qdenv.search.base", "Problem"),
    "GridArchive": ("qdenv.search.archive", "GridArchive"),
    "Score": ("qdenv.types", "Score"),
}

# Packages that are also functions of the same name: package -> its home.
_STAGES = {
    "generate": "qdenv.api.runs",
    "repair": "qdenv.api.layouts",
    "simulate": "qdenv.api.layouts",
    "surrogate": "qdenv.api.runs",
}

__all__ = sorted({**_HOMES, **_STAGES})


class _Stage(ModuleType):
    """A package that is a function, too: `qdenv.repair("plan.json")` beside `qdenv.repair.audit`.

    Importing a package binds it as an attribute of this module, whoever imports it and whenever: a
    plain function of that name would be hidden by it.
    """

    @property
    def __wrapped__(self) -> Any:
        """The function, whose signature is this one's, too."""
        name = self.__name__.rpartition(".")[2]
        return getattr(importlib.import_module(_STAGES[name]), name)

    def __call__(self, *given: Any, **named: Any) -> Any:
        """Call the function."""
        return self.__wrapped__(*given, **named)


class _Package(ModuleType):
    """This module, which sees its packages being bound."""

    def __setattr__(self, name: str, value: Any) -> None:
        """Make a stage callable when it is bound."""
        if name in _STAGES and isinstance(value, ModuleType):
            value.__class__ = _Stage
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for: `import qdenv` alone is instant."""
    if name in _STAGES:
        return importlib.import_module(f"qdenv.{name}")
    if name == "__version__":
        return metadata.version("qdenv")
    if name not in _HOMES:
        raise AttributeError(f"module 'qdenv' has no attribute {name!r}")
    module, original = _HOMES[name]
    return getattr(importlib.import_module(module), original)


def __dir__() -> list[str]:
    """List the public names."""
    return [*__all__, "__version__"]
