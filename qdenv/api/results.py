"""What the functions return: records that show themselves in a notebook."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qdenv.domains.base import Domain
from qdenv.io.layouts import write_layout

DIGITS = 4  # significant ones of a number that is shown


@dataclass(frozen=True, repr=False)
class Layout:
    """A layout that was drawn, repaired or read."""

    layout: np.ndarray  # int8 [H, W]
    domain: Domain  # whose layout, at its size
    facts: Mapping[str, Any] = field(default_factory=dict)  # what is known of it, JSON-ready

    def save(self, path: str | Path) -> Path:
        """Write a layout file with the domain and the facts in it.

        Raises:
            InputError: the place cannot be written to.
        """
        details = {**self.domain.details, **self.facts}
        write_layout(path, self.layout, self.domain.tiles, self.domain.meanings, **details)
        return Path(path)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Give the tiles where numpy asks for them."""
        return np.array(self.layout, dtype=dtype, copy=copy)

    def __repr__(self) -> str:
        """Say what it is in one line."""
        rows, cols = self.layout.shape
        facts = "".join(f", {name} {shown(value)}" for name, value in self.facts.items())
        return f"Layout({rows} x {cols} of {self.domain.name}{facts})"

    def _repr_html_(self) -> str:
        """Draw it, with the facts below."""
        # Only here: matplotlib takes half a second to import.
        from qdenv.view.notebook import layout_html

        picture = layout_html(self.layout, self.domain.tiles, self.domain.names)
        return picture + table_html([self.facts])


class Facts(dict):
    """What was found out, by name, as JSON files of the commands hold it."""

    def _repr_html_(self) -> str:
        """List what is a single number or word."""
        plain = {
            name: one for name, one in self.items() if not isinstance(one, list | tuple | dict)
        }
        return table_html([plain])


class Table(list):
    """Rows of one kind, each a `NamedTuple`."""

    def to_pandas(self) -> Any:
        """Make a pandas data frame."""
        import pandas

        return pandas.DataFrame([row._asdict() for row in self])

    def _repr_html_(self) -> str:
        """Draw the table."""
        return table_html([row._asdict() for row in self])


def shown(value: Any) -> str:
    """Write a value as people read it."""
    return f"{value:.{DIGITS}g}" if isinstance(value, float | np.floating) else str(value)


def table_html(rows: Sequence[Mapping[str, Any]]) -> str:
    """Draw records as a table: one as a list of its entries, several with a row for each."""
    if len(rows) == 1:
        lines: Iterable[Iterable[Any]] = rows[0].items()
    else:
        lines = [list(rows[0]), *(row.values() for row in rows)] if rows else []
    cells = ["".join(f"<td>{html.escape(shown(cell))}</td>" for cell in line) for line in lines]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in cells) + "</table>"


class Broken(NamedTuple):
    """A broken rule."""

    message: str  # which rule
    row: int  # of the first cell that breaks it
    column: int  # of that cell
