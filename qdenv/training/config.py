"""The configuration of a run, and its way to JSON and back."""

import dataclasses
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_origin

import cattrs
from cattrs.gen import make_dict_structure_fn, make_dict_unstructure_fn, override

from qdenv.domains.base import DOMAINS
from qdenv.generate.generator import GENERATORS
from qdenv.registry import Registry
from qdenv.search.registry import ALGORITHMS
from qdenv.settings import EvaluationConfig
from qdenv.simulate.mapf.settings import PLANNERS
from qdenv.training import schema1
from qdenv.types import InputError

LARGEST = 2**31 - 1  # of a seed, and of whatever is counted

# Settings whose type is a choice, wherever a field of this name stands.
CHOICES = {
    "domain": DOMAINS,
    "generator": GENERATORS,
    "planner": PLANNERS,
    "algorithm": ALGORITHMS,
}


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """Everything that decides the result of a run.

    Attributes:
        evaluation: domain, generator and numbers of one evaluation.
        algorithm: settings of the search; their type says which algorithm it is.
        evaluations: how many solutions are evaluated, rounded up to whole iterations.
        archive: (low, high, cells) of each measure; empty for the domain's own.
        seed: the one random seed.
        checkpoint_every: iterations between checkpoints; decides no result.
    """

    evaluation: EvaluationConfig = dataclasses.field(default_factory=EvaluationConfig)
    algorithm: Any = dataclasses.field(default_factory=lambda: ALGORITHMS.config("cma-mae"))
    evaluations: int = 10_000
    archive: tuple[tuple[float, float, int], ...] = ()
    seed: int = 0
    checkpoint_every: int = 5

    def __post_init__(self) -> None:
        """Refuse numbers that make no run."""
        for name in ("evaluations", "checkpoint_every"):
            value = getattr(self, name)
            if not 1 <= value <= LARGEST:
                raise InputError(f"{name.replace('_', '-')} must be at least 1, not {value}")
        if not -LARGEST <= self.seed <= LARGEST:
            raise InputError(f"seed must be from 0 to {LARGEST}, not {self.seed}")


def config_to_json(config: RunConfig) -> dict[str, Any]:
    """Resolve a configuration to JSON-ready values, each choice by its registered name.

    Raises:
        InputError: the type of a setting is not registered.
    """
    return _converter().unstructure(config)


def config_from_json(content: dict[str, Any], source: Path) -> RunConfig:
    """Read what `config_to_json` wrote, now or with schema 1.

    Raises:
        InputError: a setting is unknown or of the wrong type; the line names `source`.
    """
    if not isinstance(content.get("evaluation"), dict):
        raise InputError(f"{source}: not a configuration of a run ('evaluation' is missing)")
    try:
        return _converter().structure(schema1.upgraded(content), RunConfig)
    except (cattrs.BaseValidationError, KeyError, TypeError, ValueError) as error:
        unknown = _first_input_error(error)
        reasons = str(unknown) if unknown else "; ".join(cattrs.transform_error(error))
        raise InputError(f"{source}: not a configuration of this version ({reasons})") from error


def _first_input_error(error: BaseException) -> InputError | None:
    """Find what a registry said, however deep cattrs has wrapped it."""
    if isinstance(error, InputError):
        return error
    parts = error.exceptions if isinstance(error, BaseExceptionGroup) else ()
    return next((found for part in parts if (found := _first_input_error(part))), None)


def _converter() -> cattrs.Converter:
    converter = cattrs.Converter(forbid_extra_keys=True)

    def structure_choice(registry: Registry) -> Any:
        def structure(content: dict[str, Any], _: Any) -> Any:
            settings = dict(content)
            return converter.structure(settings, registry.entry(settings.pop("name")).config)

        return structure

    def unstructure_choice(registry: Registry) -> Any:
        return lambda config: {"name": registry.name_of(config)} | converter.unstructure(config)

    def structure_fields(cls: Any) -> Any:
        hooks: dict[str, Any] = {
            name: override(struct_hook=structure_choice(CHOICES[name])) for name in _choices_in(cls)
        }
        return make_dict_structure_fn(cls, converter, _cattrs_forbid_extra_keys=True, **hooks)

    def unstructure_fields(cls: Any) -> Any:
        hooks: dict[str, Any] = {
            name: override(unstruct_hook=unstructure_choice(CHOICES[name]))
            for name in _choices_in(cls)
        }
        return make_dict_unstructure_fn(cls, converter, **hooks)

    # JSON itself tells a number from a word; a word may name what a user has registered.
    converter.register_structure_hook_func(
        lambda kind: get_origin(kind) in (Union, UnionType, Literal), lambda value, _: value
    )
    converter.register_structure_hook_factory(dataclasses.is_dataclass, structure_fields)
    converter.register_unstructure_hook_factory(dataclasses.is_dataclass, unstructure_fields)
    return converter


def _choices_in(cls: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(cls) if field.name in CHOICES]
