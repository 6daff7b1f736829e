"""The configuration of a run, and its way to JSON and back."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval

from qdenv.domains.base import DOMAINS
from qdenv.generate.generator import GENERATORS
from qdenv.io.files import damaged
from qdenv.io.records import structured, unstructured
from qdenv.ranges import MOST, PositiveInt, Ranged
from qdenv.search.registry import ALGORITHMS
from qdenv.settings import EvaluationConfig
from qdenv.simulate.mapf.settings import PLANNERS
from qdenv.training import schema1
from qdenv.types import InputError

# Settings whose type is a choice, wherever a field of this name stands.
CHOICES = {
    "domain": DOMAINS,
    "generator": GENERATORS,
    "planner": PLANNERS,
    "algorithm": ALGORITHMS,
}


@dataclasses.dataclass(frozen=True)
class RunConfig(Ranged):
    """Everything that decides the result of a run."""

    # domain, generator and numbers of one evaluation
    evaluation: EvaluationConfig = dataclasses.field(default_factory=EvaluationConfig)
    # settings of the search; their type says which algorithm it is
    algorithm: Any = dataclasses.field(default_factory=lambda: ALGORITHMS.config("cma-mae"))
    # how many solutions are evaluated, rounded up to whole iterations
    evaluations: PositiveInt = 10_000
    # (low, high, cells) of each measure; empty for the domain's own
    archive: tuple[tuple[float, float, int], ...] = ()
    # generator from which the search begins: the best of a run or one of the zoo (runs/first,
    # zoo:warehouse-even/calm), or the elite of a cell (runs/first@12,40); zeros where empty
    start: str = ""
    # the one random seed; new runs take none below 0
    seed: Annotated[int, Interval(ge=-MOST, le=MOST)] = 0
    checkpoint_every: PositiveInt = 5  # iterations between checkpoints; decides no result


def config_to_json(config: RunConfig) -> dict[str, Any]:
    """Resolve a configuration to JSON-ready values, each choice by its registered name.

    Raises:
        InputError: the type of a setting is not registered.
    """
    content: dict[str, Any] = unstructured(config, CHOICES)
    return content


def config_from_json(content: dict[str, Any], source: Path) -> RunConfig:
    """Read what `config_to_json` wrote, now or with schema 1.

    Raises:
        InputError: a setting is unknown, missing or of the wrong type; the line names it and
            `source`.
    """
    if not isinstance(content.get("evaluation"), dict):
        raise damaged(source, "no configuration of a run: evaluation is missing")
    try:
        content = schema1.upgraded(content)
    except InputError as error:
        raise damaged(source, error) from error
    return structured(content, RunConfig, source, infinite=True, choices=CHOICES)
