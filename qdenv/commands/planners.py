"""The options of planners: `--planner NAME`, and `--planner.SETTING` for each of its settings."""

import contextlib
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Annotated, Any

import tyro
from tyro.constructors import ConstructorRegistry, StructConstructorSpec, StructTypeInfo

from qdenv.commands.arguments import take
from qdenv.simulate.mapf.choosing import find_planner
from qdenv.simulate.mapf.settings import PLANNERS
from qdenv.types import InputError, choices

PREFIX = "planner."
NAMED = object()  # marks settings whose options have their names already

# Tells the parser how the options of planners are called, in whatever record they lie.
OPTIONS = ConstructorRegistry()


@OPTIONS.struct_rule
def _name_options(info: StructTypeInfo) -> StructConstructorSpec | None:
    """Call the options of a planner by its name: other settings may have options of the same."""
    if NAMED in info.markers or not PLANNERS.has_loaded(info.type):
        return None
    plain = ConstructorRegistry.get_struct_spec(replace(info, markers=(*info.markers, NAMED)))
    assert isinstance(plain, StructConstructorSpec)
    named = []
    for one in plain.fields:
        kind: Any = Annotated[one.type, tyro.conf.arg(name=f"{PREFIX}{one.name}")]
        named.append(replace(one, type=kind))
    return replace(plain, fields=tuple(named))


def stated_planner(arguments: Sequence[str], usual: str) -> Any:
    """Find the settings whose options a command line may state: those of the planner it chooses.

    Args:
        arguments: the command line.
        usual: effort where it names none.

    Raises:
        InputError: it chooses what there is not, or states a setting of another planner.
    """
    effort, rest = take(arguments, "--effort")
    settings = find_planner(effort, take(rest, "--planner")[0] or "", usual)
    check_options(arguments, settings)
    return settings


def check_options(arguments: Sequence[str], settings: Any) -> None:
    """Refuse settings of another planner; the parser would not say whose they are.

    Args:
        arguments: the command line.
        settings: of the planner that is chosen; None where no fleet drives.

    Raises:
        InputError: it has no such setting.
    """
    if settings is None:
        return
    planner, own = PLANNERS.name_of(settings), _settings_of(settings)
    for word in arguments:
        option = word.partition("=")[0]
        name = option.removeprefix(f"--{PREFIX}").replace("-", "_")
        if not option.startswith(f"--{PREFIX}") or {name, name.removeprefix("no_")} & set(own):
            continue
        homes = [home for home in PLANNERS.names() if name in _names_in(home)]
        known = [one.replace("_", "-") for one in own]
        advice = f"add --planner {homes[0]}" if homes else choices(name.replace("_", "-"), known)
        raise InputError(f"{option}: {planner} has no such setting: {advice}")


def _settings_of(kind: Any) -> list[str]:
    return [field.name for field in fields(kind)]


def _names_in(planner: str) -> list[str]:
    """List the names of a planner's settings; none where its package is broken."""
    with contextlib.suppress(InputError):
        return _settings_of(PLANNERS.entry(planner).config)
    return []
