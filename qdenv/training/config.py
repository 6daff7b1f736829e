"""The configuration of a run, and its way to JSON and back."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any

import cattrs
from annotated_types import Interval
from cattrs.gen import make_dict_structure_fn, make_dict_unstructure_fn, override

from qdenv.domains.base import DOMAINS
from qdenv.generate.generator import GENERATORS
from qdenv.ranges import MOST, PositiveInt, Ranged
from qdenv.reading.files import damaged
from qdenv.reading.strict import demand, strict_converter, structured
from qdenv.registry import Registry
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
    return _converter().unstructure(config)


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
    return structured(content, RunConfig, source, _converter())


def _converter() -> cattrs.Converter:
    converter = strict_converter(infinite=True)

    def structure_choice(registry: Registry) -> Any:
        def structure(content: Any, _: Any) -> Any:
            settings = dict(demand(content, dict))
            name = settings.pop("name", None)
            if not isinstance(name, str):
                raise InputError("name must be a word")
            return converter.structure(settings, registry.entry(name).config)

        return structure

    def unstructure_choice(registry: Registry) -> Any:
        return lambda config: {"name": registry.name_of(config)} | converter.unstructure(config)

    def structure_fields(cls: Any) -> Any:
        hooks: dict[str, Any] = {
            name: override(struct_hook=structure_choice(CHOICES[name])) for name in _choices_in(cls)
        }
        fill = make_dict_structure_fn(cls, converter, _cattrs_forbid_extra_keys=True, **hooks)
        return lambda content, _: fill(demand(content, dict), cls)

    def unstructure_fields(cls: Any) -> Any:
        hooks: dict[str, Any] = {
            name: override(unstruct_hook=unstructure_choice(CHOICES[name]))
            for name in _choices_in(cls)
        }
        return make_dict_unstructure_fn(cls, converter, **hooks)

    converter.register_structure_hook_factory(dataclasses.is_dataclass, structure_fields)
    converter.register_unstructure_hook_factory(dataclasses.is_dataclass, unstructure_fields)
    return converter


def _choices_in(cls: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(cls) if field.name in CHOICES]
