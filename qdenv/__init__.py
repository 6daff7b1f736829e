"""Generate environments that make robot fleets flow.

One loop, one folder per stage:

    parameters ─▶ generate ─▶ repair ─▶ simulate ─▶ score ─▶ search ─▶ next parameters
                  (device)    (host     (device)   (device)  (device)
                              callback)

A neural cellular automaton draws a floor plan, a mixed-integer program changes as little as
possible until every rule holds, a fleet of robots is simulated in it, and CMA-MAE keeps an
archive of different good automata. `domains` says what differs between warehouse, manufacturing
and maze; `pipeline` is the chain on one screen; `train` is the loop with its run directory, and
`study` evaluates saved layouts and runs. Every function below is also a command of the same name.

    >>> import qdenv
    >>> run = qdenv.train("quick", "runs/first")
    >>> plan = qdenv.generate_layout(run, rows=33, cols=36)
    >>> qdenv.simulate_layout(plan, agents=100)

A domain, planner, generator or algorithm of your own is a settings record and a function that
makes it, paired in an `Entry`: register it (`qdenv.DOMAINS.register(name, entry)`), or name it as
an entry point of your package, so that the `qdenv` command knows it too.
"""

import importlib
from typing import Any

# Public names by module. Each is imported when it is first used: `import qdenv` alone is instant.
_NAMES = {
    # Operations, which are commands as well.
    "qdenv.ops.networks": "train_agent evaluate_agent convert_agent fit_surrogate",
    "qdenv.ops.layouts": "render check repair_layout human_layout tile_layout make_environment",
    "qdenv.ops.options": "read_plan",
    "qdenv.ops.output": "Layout",
    "qdenv.ops.pages": "replay explore report",
    "qdenv.ops.runs": "plot generate_layout series export",
    "qdenv.ops.searches": "presets train resume zoo",
    "qdenv.ops.studies": "sweep compare scalability",
    "qdenv.ops.traffic": "simulate_layout",
    # Their parts.
    "qdenv.io.layouts": "read_layout write_layout",
    "qdenv.pipeline": "evaluate make_pipeline",
    "qdenv.view.runs": "plot_run",
    "qdenv.presets": "PRESETS find_preset",
    "qdenv.repair.audit": "audit",
    "qdenv.run.config": "RunConfig",
    "qdenv.run.directory": "RunDirectory",
    "qdenv.run.experiment": "make_experiment make_iteration",
    "qdenv.settings": "EvaluationConfig",
    "qdenv.study.elites": "grow_elite",
    # Plug-ins: a domain, a planner, a generator, an algorithm.
    "qdenv.registry": "Entry",
    "qdenv.types": "InputError Adjacency Count Goal Measure Rules Score TaskRule Traffic",
    "qdenv.domains.base": "DOMAINS Domain DomainConfig KnownSize Simulator find_domain make_domain",
    "qdenv.domains.fleet": "fleet_simulator",
    "qdenv.simulate.mapf.goals": "beside_goal tile_goal",
    "qdenv.simulate.mapf.settings": "FleetConfig PLANNERS",
    "qdenv.simulate.mapf.planner": "AgentState Planner World",
    "qdenv.simulate.mapf.negotiated.settings": "NegotiatedConfig",
    "qdenv.simulate.mapf.pbs.settings": "PbsConfig",
    "qdenv.simulate.mapf.pibt.settings": "PibtConfig",
    "qdenv.generate": "GENERATORS Canvas Generator NcaConfig",
    "qdenv.search.registry": "ALGORITHMS",
    "qdenv.search.base": "Algorithm Problem",
    "qdenv.search.archive": "GridArchive",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used."""
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version("qdenv")
    if name not in _HOMES:
        raise AttributeError(f"module 'qdenv' has no attribute {name!r}")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """List the public names."""
    return [*__all__, "__version__"]
