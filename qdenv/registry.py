"""One way to find a domain, a planner, an algorithm: by its settings record or by its name.

A choice is a settings record: a frozen dataclass with defaults for all its fields, whose *type*
says what is chosen and whose values are its own numbers. A `Registry` pairs each type with a name
(for command lines and JSON) and with the function that makes the thing.

Three ways in, all equal: the package's own, entry points of installed packages, and
`Registry.register` in a notebook. An entry point names an `Entry`, which is imported when used::

    [project.entry-points."qdenv.planners"]
    greedy = "my_package:GREEDY"        # GREEDY = qdenv.Entry(GreedyConfig, make_greedy)
"""

import importlib
import inspect
from collections.abc import Callable, Mapping
from importlib import metadata
from typing import Any, NamedTuple

from qdenv.types import InputError, look_up


class Entry(NamedTuple):
    """One choice."""

    config: type  # frozen dataclass of its settings, with defaults for all of them
    # (settings, ...) -> the thing; each registry says what else it passes. Or where that function
    # is, as ``module:function``: then settings are known without its imports.
    make: Callable[..., Any] | str


class Registry:
    """Choices of one kind, by name and by the type of their settings."""

    def __init__(self, what: str, group: str, builtin: Mapping[str, Entry | str]) -> None:
        """Import nothing yet.

        A choice is called `what` in messages, like "planner". Installed packages add some by entry
        points of a `group`; `builtin` maps names to an `Entry`, or ``module:attribute`` of one.
        """
        self._what, self._group = what, group
        self.shipped = tuple(builtin)  # the package's own names
        self._references: dict[str, Entry | str] = dict(builtin)
        self._looked = False  # for plug-ins
        self._entries: dict[str, Entry] = {}

    def register(self, name: str, entry: Entry) -> None:
        """Add `entry` to the choices, or replace the one of this name."""
        self._entries[name] = entry

    def names(self) -> tuple[str, ...]:
        """List the names: the package's own, then those of plug-ins."""
        if not self._looked:
            self._looked = True
            for point in metadata.entry_points(group=self._group):
                self._references.setdefault(point.name, point.value)
        return tuple(dict.fromkeys((*self._references, *self._entries)))

    def entry(self, name: str) -> Entry:
        """Look a choice up by name; InputError if there is none, or it cannot be imported."""
        look_up(dict.fromkeys(self.names()), name, self._what)
        if name not in self._entries:
            reference = self._references[name]
            entry = self._import(name, reference) if isinstance(reference, str) else reference
            if not isinstance(entry, Entry):
                wrong = f"{reference} is not a qdenv.Entry(settings, make)"
                raise InputError(f"{self._what} {name!r}: {wrong}")
            self._entries[name] = entry
        return self._entries[name]

    def config(self, name: str) -> Any:
        """Make the settings of the choice of this name, with all defaults."""
        return self.entry(name).config()

    def name_of(self, config: Any) -> str:
        """Find the name under which the type of `config` is registered, or raise InputError."""
        for name in self.names():
            try:
                known = self.entry(name).config
            except InputError:  # a broken plug-in is no reason to fail here
                continue
            if type(config) is known:
                return name
        own = f"{type(config).__name__}: choose from {', '.join(self.names())}"
        raise InputError(f"no {self._what} is registered for {own}")

    def make(self, config: Any, *details: Any) -> Any:
        """Make what `config` chooses; `details` follow the settings as arguments of its maker."""
        return self._maker(config)(config, *details)

    def takes(self, config: Any, count: int) -> bool:
        """Return True if the maker of what `config` chooses takes `count` arguments."""
        try:
            inspect.signature(self._maker(config)).bind(*range(count))
        except TypeError:
            return False
        return True

    def _maker(self, config: Any) -> Callable[..., Any]:
        name = self.name_of(config)
        make = self.entry(name).make
        return self._import(name, make) if isinstance(make, str) else make

    def _import(self, name: str, reference: str) -> Any:
        """Import what ``module:attribute`` names."""
        module, _, attribute = reference.partition(":")
        try:
            return getattr(importlib.import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            cannot = f"{self._what} {name!r} cannot be loaded from {module}:{attribute} ({error})"
            cure = "mend or uninstall the package it comes from"
            raise InputError(f"{cannot}: {cure}") from error
