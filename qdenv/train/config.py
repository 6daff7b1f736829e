"""The configuration of a run, and its way to JSON and back."""

import dataclasses
from pathlib import Path
from types import UnionType
from typing import Any, Union, get_origin

import cattrs

from qdenv.domains.base import EvaluationConfig
from qdenv.search.cma_mae import CmaMaeConfig
from qdenv.search.registry import ALGORITHMS
from qdenv.types import InputError


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """Everything that decides the result of a run.

    Attributes:
        evaluation: domain, sizes and numbers of one evaluation.
        algorithm: settings of the search; their class says which algorithm it is.
        evaluations: how many solutions are evaluated, rounded up to whole iterations.
        archive: (low, high, cells) of each measure; empty for the domain's own.
        seed: the one random seed.
        checkpoint_every: iterations between checkpoints; decides no result.
    """

    evaluation: EvaluationConfig = dataclasses.field(default_factory=EvaluationConfig)
    algorithm: Any = dataclasses.field(default_factory=CmaMaeConfig)
    evaluations: int = 10_000
    archive: tuple[tuple[float, float, int], ...] = ()
    seed: int = 0
    checkpoint_every: int = 5


def config_to_json(config: RunConfig) -> dict[str, Any]:
    """Resolve a configuration to JSON-ready values, the algorithm by its registered name."""
    name = algorithm_name(config.algorithm)
    content = dataclasses.asdict(config)
    return content | {"algorithm": {"name": name} | content["algorithm"]}


def config_from_json(content: dict[str, Any], source: Path) -> RunConfig:
    """Read what `config_to_json` wrote.

    Raises:
        InputError: a setting is unknown or of the wrong type; the line names `source`.
    """
    converter = cattrs.Converter(forbid_extra_keys=True)
    converter.register_structure_hook_func(
        lambda kind: get_origin(kind) in (Union, UnionType), lambda value, _: value
    )  # JSON itself tells a number from a word
    try:
        algorithm = dict(content["algorithm"])
        settings = ALGORITHMS.entry(algorithm.pop("name")).config
        rest = {key: value for key, value in content.items() if key != "algorithm"}
        config = converter.structure(rest, RunConfig)
        return dataclasses.replace(config, algorithm=converter.structure(algorithm, settings))
    except (cattrs.BaseValidationError, KeyError, TypeError, ValueError) as error:
        reasons = "; ".join(cattrs.transform_error(error)) if isinstance(error, Exception) else ""
        raise InputError(f"{source}: not a configuration of this version ({reasons})") from error


def algorithm_name(settings: Any) -> str:
    """Find the registered name of an algorithm by the class of its settings.

    Raises:
        InputError: the class is not registered.
    """
    return ALGORITHMS.name_of(settings)
