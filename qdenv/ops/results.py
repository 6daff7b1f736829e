"""What operations return: records that display themselves in a notebook, with facts for JSON."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.domains.base import Domain
from qdenv.io.layouts import write_layout
from qdenv.types import InputError

_DIGITS = 4  # significant ones of a number in a notebook


@dataclass(frozen=True, repr=False)
class Layout:
    """A layout that was drawn, repaired or read."""

    layout: np.ndarray  # int8 [H, W]
    domain: Domain  # whose layout, at its size
    details: Mapping[str, Any] = field(default_factory=dict)  # of its making; saved in its file
    facts: Mapping[str, Any] = field(default_factory=dict)  # as `--json` writes them

    def save(self, path: str | Path) -> Path:
        """Write a layout file with the domain and the details in it.

        Raises:
            InputError: the place cannot be written to.
        """
        details = {**self.domain.details, **self.details}
        write_layout(path, self.layout, self.domain.tiles, self.domain.meanings, **details)
        return Path(path)

    def draw(self, path: str | Path) -> Path:
        """Draw the layout as a picture, PNG, SVG or PDF by the ending of its name."""
        from qdenv.view.layouts import save_layout  # imports matplotlib

        save_layout(path, self.layout, self.domain.tiles, self.domain.names)
        return Path(path)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Return the tiles as an array."""
        return np.array(self.layout, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        """Return size, domain and facts in one line."""
        rows, cols = self.layout.shape
        facts = "".join(f", {name} {_shown(value)}" for name, value in _plain(self.facts).items())
        return f"Layout({rows} x {cols} of {self.domain.name}{facts})"

    def _repr_html_(self) -> str:
        from qdenv.view.notebook import layout_html  # imports matplotlib

        picture = layout_html(self.layout, self.domain.tiles, self.domain.names)
        return picture + _table_html([_plain(self.facts)])


class Facts(dict):
    """Findings by name, as `--json` writes them."""

    def _repr_html_(self) -> str:
        return _table_html([_plain(self)])


class Table(list):
    """Rows of one kind, each a `NamedTuple`, and the facts that `--json` writes."""

    def __init__(self, rows: Iterable[Any], facts: Mapping[str, Any]) -> None:
        """Make a table of rows."""
        super().__init__(rows)
        self.facts = facts

    def to_pandas(self) -> Any:
        """Make a pandas data frame."""
        import pandas

        return pandas.DataFrame([row._asdict() for row in self])

    def _repr_html_(self) -> str:
        return _table_html([row._asdict() for row in self])


class UnsolvedError(InputError):
    """A task without a solution, and the facts that `--json` writes of it."""

    def __init__(self, message: str, facts: Mapping[str, Any]) -> None:
        """Fail with one line."""
        super().__init__(message)
        self.facts = facts


class Broken(NamedTuple):
    """A broken rule."""

    message: str  # which rule
    row: int  # of the first cell that breaks it
    column: int  # of that cell


def _table_html(rows: Sequence[Mapping[str, Any]]) -> str:
    """Draw records as a table: one as a list of its entries, several with a row for each."""
    if len(rows) == 1:
        lines: Iterable[Iterable[Any]] = rows[0].items()
    else:
        lines = [list(rows[0]), *(row.values() for row in rows)] if rows else []
    cells = ["".join(f"<td>{html.escape(_shown(cell))}</td>" for cell in line) for line in lines]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in cells) + "</table>"


def _plain(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Leave out what is no single value; the cell of an elite, a tuple, is one."""
    return {key: one for key, one in facts.items() if not isinstance(one, list | dict)}


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return ",".join(map(str, value))
    return f"{value:.{_DIGITS}g}" if isinstance(value, float | np.floating) else str(value)
