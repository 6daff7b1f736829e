"""The options that depend on a choice in the same command line: of a planner, a preset, a domain.

The types of operations mark them (`qdenv.ops.options`); here the parser learns which options a mark
stands for. Every one of them is left out of the call unless the command line states it, so that an
operation knows what was stated; help shows the default all the same.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    TypedDict,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

import tyro
from tyro.constructors import (
    MISSING_NONPROP,
    ConstructorRegistry,
    PrimitiveConstructorSpec,
    PrimitiveTypeInfo,
    StructConstructorSpec,
    StructTypeInfo,
)

from qdenv.domains.base import DOMAINS, Domain, find_domain, make_domain
from qdenv.ops.options import (
    PlannerOptions,
    PresetOptions,
    RunOptions,
    SurrogateOptions,
    TileNumbers,
)
from qdenv.presets import find_preset
from qdenv.registry import Registry
from qdenv.run.config import choose_algorithm, choose_domain, choose_planner, planner_of
from qdenv.run.directory import RunDirectory
from qdenv.search.registry import ALGORITHMS
from qdenv.search.settings import check_strategy
from qdenv.shipped import PREFIX
from qdenv.simulate.mapf.settings import PLANNERS, find_planner
from qdenv.study.plans import USUAL, read_plan
from qdenv.types import InputError, choices

_PLANNER = "planner."  # begins the options of a planner: other settings may have the same names
_WORKERS = "evaluation__repair__workers"  # which `Execution` has, too
_LONGEST_NAME = 255  # bytes of a file's name


@dataclasses.dataclass(frozen=True)
class Choices:
    """What a command line chooses by name; read first, as other options depend on it."""

    domain: str | None = None  # name of a domain
    effort: str | None = None  # of the negotiated planner
    planner: str | None = None  # name of a planner
    algorithm: str | None = None  # name of a search algorithm
    strategy: str | None = None  # of the search


def make_rules(chosen: Choices, rest: Sequence[str]) -> ConstructorRegistry:
    """Make the rules by which the parser reads the types of operations.

    Args:
        chosen: what the command line chooses by name.
        rest: its other words.
    """
    # The parser finds the comments behind the fields of a dictionary itself, not in its bases.
    helps = {
        field.name: field.helptext
        for kind in (RunOptions, SurrogateOptions)
        for field in _spec_of(kind).fields
    }
    rules = ConstructorRegistry()
    rules.primitive_rule(_number_rule)

    @rules.struct_rule
    def marked(info: StructTypeInfo) -> StructConstructorSpec | None:
        kind, keywords = info.type, get_args(info.type)[1:]
        if is_typeddict(kind) and kind.__name__ != "Options":
            return _with_help(_options(get_type_hints(kind, include_extras=True)), helps)
        if kind is PlannerOptions:
            return _planner_options(chosen, rest)
        if get_origin(kind) is not dict or get_origin(keywords[0]) is not Annotated:
            return None
        value, mark, *_ = get_args(keywords[0])
        if mark is PresetOptions:
            return _preset_options(chosen, rest)
        if mark is TileNumbers:
            return _tile_numbers(_domain_of(chosen, rest), value)
        return None

    return rules


def _number_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec | None:
    """Read an integer or a number; the parser's own rule has no plain words for a mistake."""
    parts = get_args(info.type) if get_origin(info.type) in (Union, UnionType) else (info.type,)
    kinds = [get_args(one)[0] if get_origin(one) is Annotated else one for one in parts]
    kind = next((one for one in kinds if one is not type(None)), None)
    if kind not in (int, float) or len(kinds) > 2:
        return None

    def read(words: list[str]) -> Any:
        try:
            return kind(words[0])
        except ValueError:
            noun = "an integer" if kind is int else "a number"
            raise ValueError(f"must be {noun}, not {words[0]!r}") from None

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=kind.__name__.upper(),
        instance_from_str=read,
        is_instance=lambda value: isinstance(value, kind),
        str_from_instance=lambda value: [str(value)],
    )


def _spec_of(kind: Any, default: Any = MISSING_NONPROP) -> StructConstructorSpec:
    spec = ConstructorRegistry.get_struct_spec(StructTypeInfo.make(kind, default, False))
    assert isinstance(spec, StructConstructorSpec)
    return spec


def _options(fields: Mapping[str, Any]) -> StructConstructorSpec:
    """Make options of the types in `fields`, which are left out unless they are stated."""
    plain = tyro.conf.arg(prefix_name=False)
    kinds = {name: Annotated[kind, plain] for name, kind in fields.items()}
    return _spec_of(TypedDict("Options", kinds, total=False))  # type: ignore[operator]


def _settings(record: Any, prefix: str = "", path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """List the settings in a record, those inside of its records as well.

    Args:
        record: a dataclass.
        prefix: begins the names of its options.
        path: fields that lead to it, each followed by two underscores.

    Returns:
        for each setting its path, its type with the name and default of its option, and its help.
    """
    for field in _spec_of(type(record), record).fields:
        value = getattr(record, field.name)
        if dataclasses.is_dataclass(value):
            yield from _settings(
                value, _PLANNER if field.name == "planner" else prefix, f"{path}{field.name}__"
            )
        elif tyro.conf.Fixed not in getattr(field.type, "__metadata__", ()):
            shown = " ".join(map(str, _flat(value)))
            about = tyro.conf.arg(
                name=f"{prefix}{field.name}", help_behavior_hint=f"(default: {shown})"
            )
            yield f"{path}{field.name}", Annotated[field.type, about], field.helptext


def _flat(value: Any) -> Iterator[Any]:
    if isinstance(value, tuple):
        for one in value:
            yield from _flat(one)
    else:
        yield value


def _with_help(spec: StructConstructorSpec, helps: Mapping[str, Any]) -> StructConstructorSpec:
    fields = [
        dataclasses.replace(field, helptext=helps.get(field.name, field.helptext))
        for field in spec.fields
    ]
    return dataclasses.replace(spec, fields=tuple(fields))


def _name(registry: Registry, about: str) -> Any:
    metavar = "{" + ",".join(registry.names()) + "}"
    return Annotated[
        str, tyro.conf.arg(metavar=metavar, help=about, help_behavior_hint="(default: None)")
    ]


def _planner_options(chosen: Choices, rest: Sequence[str]) -> StructConstructorSpec:
    """Make ``--planner NAME`` and the options of that planner: a name and what is stated."""
    settings = find_planner(chosen.effort, chosen.planner or "")
    _check_planner_options(rest, settings)
    listed = list(_settings(settings, _PLANNER))
    planner = _name(PLANNERS, "who plans, with the defaults below")
    options = _options({"planner": planner} | {path: kind for path, kind, _ in listed})
    spec = _with_help(options, {path: text for path, _, text in listed})
    return dataclasses.replace(spec, instantiate=lambda planner=None, **stated: (planner, stated))


def _check_planner_options(words: Sequence[str], settings: Any) -> None:
    """Refuse settings of another planner, and name the planner that has them."""
    planner = PLANNERS.name_of(settings)
    own = {field.name for field in dataclasses.fields(settings)}
    for word in words:
        option = word.partition("=")[0]
        name = option.removeprefix(f"--{_PLANNER}").replace("-", "_")
        if not option.startswith(f"--{_PLANNER}") or {name, name.removeprefix("no_")} & own:
            continue
        homes = [home for home in PLANNERS.names() if name in _names_in(home)]
        known = sorted(one.replace("_", "-") for one in own)
        advice = f"add --planner {homes[0]}" if homes else choices(name.replace("_", "-"), known)
        raise InputError(f"{option}: {planner} has no such setting: {advice}")


def _names_in(planner: str) -> list[str]:
    with contextlib.suppress(InputError):  # a plug-in that is broken
        return [field.name for field in dataclasses.fields(PLANNERS.entry(planner).config)]
    return []


def _preset_options(chosen: Choices, rest: Sequence[str]) -> StructConstructorSpec:
    """Make an option for each setting of the chosen preset, and for each choice by name."""
    config = find_preset(rest[0] if rest and rest[0][:1] != "-" else "quick")
    if chosen.domain is not None:
        config = choose_domain(config, chosen.domain)
    if chosen.algorithm is not None:
        config = choose_algorithm(config, chosen.algorithm)
    config = choose_planner(config, chosen.effort, chosen.planner)
    if (planner := planner_of(config)) is not None:
        _check_planner_options(rest, planner)
    check_strategy(chosen.strategy or "")  # the parser would not say why
    effort = "of the negotiated planner: low inside a search, high for numbers to report"
    listed = [one for one in _settings(config) if one[0] != _WORKERS]
    named = {
        "domain": _name(DOMAINS, "another domain in place of the preset's, at its size"),
        "effort": Annotated[
            Literal["low", "high"], tyro.conf.arg(help=effort, help_behavior_hint="(default: None)")
        ],
        "planner": _name(PLANNERS, "another planner, with its defaults, which are listed below"),
        "algorithm": _name(ALGORITHMS, "another search algorithm, with its defaults"),
    }
    options = _options(named | {path: kind for path, kind, _ in listed})
    spec = _with_help(options, {path: text for path, _, text in listed})
    # An algorithm comes with the generator that it searches.
    implied = {} if chosen.algorithm is None else {"generator": config.evaluation.generator}
    return dataclasses.replace(spec, instantiate=lambda **stated: implied | stated)


def _tile_numbers(domain: Domain, kind: Any) -> StructConstructorSpec:
    """Make an option for each number of tiles that a domain counts."""
    many = get_origin(kind) is not None
    return _options(
        {
            name: Annotated[
                tuple[int, ...] if many else int,
                tyro.conf.arg(
                    help=f"exact number of tiles {symbol!r}",
                    help_behavior_hint="(default: )" if many else "(default: None)",
                ),
            ]
            for name, symbol in domain.counted.items()
        }
    )


def _domain_of(chosen: Choices, rest: Sequence[str]) -> Domain:
    """Find the domain that a command line is about: by name, a run, a layout, or the usual one.

    Raises:
        InputError: the domain is unknown, or the run cannot be read.
    """
    if chosen.domain is not None:
        return find_domain(chosen.domain)
    for word in rest:
        if max(map(len, word.split("/"))) > _LONGEST_NAME:  # a list of numbers, perhaps
            continue
        if word.startswith(PREFIX) or (Path(word) / "config.json").exists():
            return make_domain(RunDirectory.open(word).config.evaluation.domain)
        if Path(word).is_file():
            with contextlib.suppress(InputError):  # no layout, or one that the command refuses
                return read_plan(word).domain
    return find_domain(USUAL)
