"""The command presets."""

from typing import Any

from qdenv.commands.costs import describe_cost
from qdenv.commands.output import JsonFile, write_facts
from qdenv.domains.base import DOMAINS
from qdenv.presets import PRESETS
from qdenv.search.registry import ALGORITHMS
from qdenv.training.config import RunConfig

HEAD = ("preset", "domain", "algorithm", "size", "agents", "steps", "evaluations", "takes")


def presets(json_file: JsonFile = None) -> None:
    """List the presets: what they search, and how long that takes on this machine.

    Args:
        json_file: where to write the numbers; - for standard output.
    """
    table = [facts_of(name, config) for name, config in PRESETS.items()]
    lines = [HEAD, *(tuple(str(row[name]) for name in HEAD) for row in table)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(HEAD))]
    for line in lines:
        print(
            "  ".join(word.ljust(width) for word, width in zip(line, widths, strict=True)).rstrip()
        )
    print("agents: robots in a simulation; steps: its timesteps; evaluations: layouts simulated")
    write_facts(json_file, "presets", {"presets": table})


def facts_of(name: str, config: RunConfig) -> dict[str, Any]:
    """Reduce a preset to the numbers that a person chooses by."""
    domain = config.evaluation.domain
    fleet = getattr(domain, "fleet", domain)
    return {
        "preset": name,
        "domain": DOMAINS.name_of(domain),
        "size": f"{domain.rows} x {domain.cols}",
        "agents": getattr(fleet, "agents", 1),
        "steps": fleet.timesteps,
        "evaluations": config.evaluations,
        "takes": describe_cost(name, config) or "not known",
        "alpha": config.evaluation.alpha,
        "algorithm": ALGORITHMS.name_of(config.algorithm),
        "simulations": config.evaluation.simulations,
    }
