"""The options that depend on a choice in the same command line: of a planner, a preset, a domain.

The types of operations mark them (`qdenv.ops.options`); here the parser learns which options a mark
stands for. Every one of them is left out of the call unless the command line states it, so that an
operation knows what was stated; help shows the default all the same.
"""

import contextlib
import dataclasses
import functools
import os.path
from collections.abc import Iterable, Iterator, Sequence
from typing import (
    Annotated,
    Any,
    Literal,
    TypedDict,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

from tyro.conf import Fixed, arg
from tyro.constructors import (
    MISSING_NONPROP,
    ConstructorRegistry,
    StructConstructorSpec,
    StructTypeInfo,
)

from qdenv.cli.parser import help_of, number_rules
from qdenv.domains.base import DOMAINS, Domain, find_domain, make_domain
from qdenv.ops import options as args
from qdenv.registry import Registry
from qdenv.shipped import PREFIX
from qdenv.simulation.mapf.settings import PLANNERS, find_planner
from qdenv.study.options import find_surrogate
from qdenv.study.plans import USUAL, read_plan
from qdenv.types import InputError, choices

_PLANNER = "planner."  # begins the options of a planner: other settings may have the same names


@dataclasses.dataclass(frozen=True)
class Choices:
    """What a command line chooses by name; read first, as other options depend on it."""

    domain: str | None = None  # name of a domain
    effort: str | None = None  # of the negotiated planner
    planner: str | None = None  # name of a planner
    algorithm: str | None = None  # name of a search algorithm
    generator: str | None = None  # name of a generator
    strategy: str | None = None  # of the search


def make_rules(chosen: Choices, rest: Sequence[str]) -> ConstructorRegistry:
    """Make the rules by which the parser reads the types of operations.

    They depend on what the command line chooses by name, and on the `rest` of its words.
    """
    helps, rules = _helps(), number_rules()

    @rules.struct_rule
    def marked(info: StructTypeInfo) -> StructConstructorSpec | None:
        kind, keywords = info.type, get_args(info.type)[1:]
        if is_typeddict(kind) and kind.__name__ != "Options":
            kinds = get_type_hints(kind, include_extras=True)
            own = helps[args.RunOptions] | helps[args.FleetOptions] | helps[kind]
            return _options((name, one, own[name]) for name, one in kinds.items())
        if kind in (args.PlannerOptions, args.PibtOptions):
            usual = "" if chosen.effort else kind.usual
            # Of several, take the first one's: `each_planner` refuses them.
            settings = find_planner(chosen.effort, (chosen.planner or usual).partition(",")[0])
            _check_planner_options(rest, settings)
            about = "planner of the paths; --help-all lists its settings"
            planner = ("planner", _name(PLANNERS, settings), about)
            spec = _options([planner, *_settings(settings, _PLANNER)])
            # A name and what is stated, as `Fleet` takes them.
            return dataclasses.replace(
                spec, instantiate=lambda planner=usual, **stated: (planner, stated)
            )
        if kind is args.TaskOptions:
            if chosen.domain not in (None, *DOMAINS.names()):  # the command refuses it
                return _options(())
            domain = _domain_of(chosen, rest)
            stated = [one for one in _settings(domain.config) if one[0] in domain.task_settings]
            return _options([*stated, *_demand(domain)])
        if get_origin(kind) is not dict or get_origin(keywords[0]) is not Annotated:
            return None
        value, mark, *_ = get_args(keywords[0])
        if mark is args.Mark.PRESET:
            return _preset_options(chosen, rest)
        if mark is args.Mark.SURROGATE:
            named = ("channels", "blocks", "epochs", "minibatch", "rate")
            return _options(
                one for one in _settings(find_surrogate("small", {})) if one[0] in named
            )
        return _tile_numbers(chosen, rest, value) if mark is args.Mark.TILES else None

    return rules


@functools.cache  # reads sources
def _helps() -> dict[Any, dict[str, str]]:
    """Return the help of the fields of each dictionary of options, without those of its base."""
    return {
        kind: {one.name: text for one in _spec_of(kind).fields if (text := help_of(one))}
        for kind in filter(is_typeddict, vars(args).values())
    }


def _spec_of(kind: Any, default: Any = MISSING_NONPROP) -> StructConstructorSpec:
    spec = ConstructorRegistry.get_struct_spec(StructTypeInfo.make(kind, default, False))
    assert isinstance(spec, StructConstructorSpec)
    return spec


def _options(listed: Iterable[tuple[str, Any, Any]]) -> StructConstructorSpec:
    """Make options of names, types and help (None: that of the type), left out unless stated."""
    kinds, helps = {}, {}
    for name, kind, helps[name] in listed:
        bare, *marks = get_args(kind) if get_origin(kind) is Annotated else (kind,)
        # Of several marks the last one counts: a default that the type states.
        unset = arg(prefix_name=False, help_behavior_hint="(default: None)")
        kinds[name] = Annotated[bare, unset, *marks]
    spec = _spec_of(TypedDict("Options", kinds, total=False))  # type: ignore[operator]
    fields = [
        dataclasses.replace(field, helptext=helps[field.name] or field.helptext)
        for field in spec.fields
    ]
    return dataclasses.replace(spec, fields=tuple(fields))


def _settings(record: Any, prefix: str = "", path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """List the settings in a dataclass, those inside of its records as well, for `_options`.

    The names of options begin with `prefix`; `path` are the fields that lead to the record, each
    followed by two underscores.
    """
    for field in _spec_of(type(record), record).fields:
        value = getattr(record, field.name)
        if dataclasses.is_dataclass(value):
            own = _PLANNER if field.name == "planner" else prefix
            yield from _settings(value, own, f"{path}{field.name}__")
        elif Fixed not in getattr(field.type, "__metadata__", ()):
            robots = ("--robots",) * (field.name == "agents")
            hint = f"(default: {' '.join(map(str, flat(value)))})"
            about = arg(name=f"{prefix}{field.name}", aliases=robots, help_behavior_hint=hint)
            yield f"{path}{field.name}", Annotated[field.type, about], field.helptext


def flat(value: Any) -> Iterator[Any]:
    """List the values in nested sequences, dictionaries and dataclasses."""
    if dataclasses.is_dataclass(value):
        value = vars(value)
    if isinstance(value, list | tuple | dict):
        for one in value.values() if isinstance(value, dict) else value:
            yield from flat(one)
    else:
        yield value


def _name(registry: Registry, default: Any) -> Any:
    """Make the type of an option that chooses a registered name; `default` holds its settings."""
    metavar = "{" + ",".join(registry.names()) + "}"
    hint = f"(default: {None if default is None else registry.name_of(default)})"
    return Annotated[str, arg(metavar=metavar, help_behavior_hint=hint)]


def _check_planner_options(words: Sequence[str], settings: Any) -> None:
    """Refuse settings of another planner, and name the planner that has them."""
    own = {field.name for field in dataclasses.fields(settings)}
    for word in words:
        option = word.partition("=")[0]
        name = option.removeprefix(f"--{_PLANNER}").replace("-", "_")
        if not option.startswith(f"--{_PLANNER}") or {name, name.removeprefix("no_")} & own:
            continue
        homes = []
        for home in PLANNERS.names():
            with contextlib.suppress(InputError):  # a plug-in that is broken
                fields = dataclasses.fields(PLANNERS.entry(home).config)
                homes += [home] * any(field.name == name for field in fields)
        known = sorted(one.replace("_", "-") for one in own)
        advice = f"add --planner {homes[0]}" if homes else choices(name.replace("_", "-"), known)
        raise InputError(f"{option}: {PLANNERS.name_of(settings)} has no such setting: {advice}")


def _preset_options(chosen: Choices, rest: Sequence[str]) -> StructConstructorSpec:
    """Make an option for each setting of the chosen preset, and for each choice by name."""
    # Only a search needs these: other refusals are faster without them.
    from qdenv.configurations import find_preset
    from qdenv.generators import GENERATORS
    from qdenv.run import config as configs
    from qdenv.search.registry import ALGORITHMS
    from qdenv.search.settings import check_strategy

    # The preset comes first, before any option.
    config = find_preset(rest[0] if rest and rest[0][:1] != "-" else "quick")
    if chosen.domain is not None or any(word.partition("=")[0] == "--plan" for word in rest):
        config = configs.choose_domain(config, _domain_of(chosen, rest[1:]).name)
    if chosen.algorithm is not None:
        config = configs.choose_algorithm(config, chosen.algorithm)
    if chosen.generator is not None:
        config = configs.choose_generator(config, chosen.generator)
    config = configs.choose_planner(config, chosen.effort, chosen.planner)
    domain = make_domain(config.evaluation.domain)
    ranged = {name for name in domain.counted if hasattr(domain.config, f"spare_{name}")}
    if (planner := configs.planner_of(config)) is not None:
        _check_planner_options(rest, planner)
    check_strategy(chosen.strategy or "")  # the parser would not say why
    effort = "effort of the negotiated planner: low for a search, high for numbers to report"
    about = "replaces the preset's domain, at the same size"
    draws = "generator; guided-nca also draws costs of moves"
    listed = [
        ("domain", _name(DOMAINS, config.evaluation.domain), about),
        ("effort", Literal["low", "high"], effort),
        ("planner", _name(PLANNERS, planner), "planner, with its defaults, which --help-all lists"),
        ("algorithm", _name(ALGORITHMS, config.algorithm), "algorithm, with its defaults"),
        ("generator", _name(GENERATORS, config.evaluation.generator), draws),
        # `Execution` has the number of workers, too.
        *(
            (name, Annotated[args.Range, get_args(kind)[-1]], text)
            if name.rpartition("__")[2] in ranged
            else (name, kind, text)
            for name, kind, text in _settings(config)
            if name != "evaluation__repair__workers"
        ),
        *_demand(domain),
    ]
    # An algorithm comes with the generator that it searches.
    implied = {} if chosen.algorithm is None else {"generator": config.evaluation.generator}
    return dataclasses.replace(_options(listed), instantiate=lambda **stated: implied | stated)


def _tile_numbers(chosen: Choices, rest: Sequence[str], kind: Any) -> StructConstructorSpec:
    """Make an option for each number of tiles, and setting of rules, of a command's domain."""
    many = Annotated[tuple[int, ...], arg(help_behavior_hint="(default: )")]
    one, domain, listed = get_origin(kind) is None, _domain_of(chosen, rest), []
    for name, tile in domain.counted.items():
        about = f"exact number of {domain.names.get(tile, '')} tiles ({tile})"
        ranged = one and hasattr(domain.config, f"spare_{name}")
        number = args.Range if ranged else int if one else many
        listed.append((name, number, about + ", or 1000:1200" * ranged))
    listed += [one for one in _settings(domain.config) if one[0] in domain.rule_settings]
    return _options(listed)


def _demand(domain: Domain) -> Iterator[tuple[str, Any, Any]]:
    """Make the option for where goals are, if a domain has it: files and zones become its map."""
    if "demand" in domain.task_settings:
        about = "odds that each place is a goal: a CSV file, goals of a .scen, zones as 0:9,0:20=3"
        about += '; "shelves": all shelves equally likely' if "shelves" in domain.counted else ""
        yield "demand", Annotated[str, arg(metavar="FILE|ZONES")], about


def _domain_of(chosen: Choices, rest: Sequence[str]) -> Domain:
    """Find the domain chosen by name, of a plan, a run or a layout, or the usual one."""
    if chosen.domain:
        return find_domain(chosen.domain)
    words: list[str] = []
    for word in rest:
        words += word.split("=", 1) if word.startswith("--plan=") else [word]
    if "--plan" in words:  # whose rules hold, whatever the run's are
        words = words[words.index("--plan") + 1 :] + words
    for word in words:  # `Path` raises for a long one, a list of numbers perhaps
        if word.startswith(PREFIX) or os.path.exists(os.path.join(word, "config.json")):
            return make_domain(args.open_run(word).config.evaluation.domain)
        if os.path.isfile(word):
            with contextlib.suppress(InputError):  # no layout, or one that the command refuses
                return read_plan(word).domain
    return find_domain(USUAL)
