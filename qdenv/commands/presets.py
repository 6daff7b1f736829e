"""The command presets."""

from typing import Any

from qdenv.commands.costs import describe_cost
from qdenv.commands.output import JsonFile, write_facts
from qdenv.domains.base import DOMAINS, Domain, find_domain
from qdenv.presets import PRESETS
from qdenv.run.config import RunConfig
from qdenv.search.registry import ALGORITHMS

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
    names = dict.fromkeys(str(row["domain"]) for row in table)
    sizes = [row for name in names for row in known_sizes(find_domain(name))]
    print("\nsizes with numbers of their own, which commands take there unless others are stated:")
    for row in sizes:
        numbers = ", ".join(f"{value} {name}" for name, value in list(row.items())[2:])
        print(f"  {row['domain']}, {row['size']}: {numbers}")
    write_facts(json_file, "presets", {"presets": table, "sizes": sizes})


def known_sizes(domain: Domain) -> list[dict[str, Any]]:
    """List the sizes whose numbers a domain knows."""
    return [
        {"domain": domain.name, "size": f"{rows} x {cols}", **size.numbers}
        | ({"agents": size.agents} if domain.simulator.tasks else {})
        | {"timesteps": size.timesteps, "steps of growth": size.steps}
        for (rows, cols), size in domain.known.items()
    ]


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
