"""Drawings of what must stay, from files: read beside a plan or without one."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.domains.base import DOMAINS, Domain, find_domain
from qdenv.domains.keep import FREE, SAME, check_shape
from qdenv.io.layouts import BLANKS, aliases, alphabet, read_drawing, respell, to_layout
from qdenv.repair.rules import impossible
from qdenv.types import InputError


def keep_from(path: str | Path, domain: Domain, layout: np.ndarray | None = None) -> Domain:
    """Read which cells must stay, and demand it of a domain.

    Args:
        path: a drawing of the layout's shape in any format of layout files. ``?`` is free to
            change, ``!`` stays as the plan has it, a tile stays this tile.
        domain: at the layout's size.
        layout: the plan int8 [H, W]; None where there is none.

    Raises:
        InputError: the file is no such drawing, asks for what the plan does not hold, or for what
            no layout can be.
    """
    rows = _read(path, domain)
    try:
        kept = domain.keeping(_resolve(rows, domain, layout))
        reason = None if kept.rules is None else impossible(kept.rules())
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    if reason:
        raise InputError(f"{path}: nothing can be built around what is kept: {reason}")
    return kept


def _read(path: str | Path, domain: Domain) -> list[str]:
    """Read a drawing, each tile by its own symbol; blanks are no second way to draw a tile."""
    known = aliases(domain.tiles, domain.meanings)
    table = {one: symbol for one, symbol in known.items() if one not in BLANKS + FREE + SAME}
    return respell(read_drawing(path).rows, table)


def _resolve(rows: list[str], domain: Domain, layout: np.ndarray | None) -> tuple[str, ...]:
    """Name the tile of every cell that stays."""
    check_shape(rows, domain.shape)
    return tuple(
        "".join(_resolve_cell(symbol, row, col, domain, layout) for col, symbol in enumerate(drawn))
        for row, drawn in enumerate(rows)
    )


def _resolve_cell(
    symbol: str, row: int, col: int, domain: Domain, layout: np.ndarray | None
) -> str:
    """Name the tile of a cell that stays, `FREE` of one that may change."""
    if symbol not in FREE + SAME + domain.tiles:
        raise InputError(
            f"row {row}, column {col}: {symbol!r} is no tile of {domain.name}: draw {FREE!r} where "
            f"anything may be, {SAME!r} for what the plan holds, or one of "
            f"{alphabet(domain.tiles, domain.meanings)}"
        )
    if symbol == SAME and layout is None:
        raise InputError(
            f"row {row}, column {col}: {SAME!r} keeps what a plan holds, and there is no plan "
            "here: draw the tile itself"
        )
    if symbol == FREE or layout is None:
        return symbol
    held = domain.tiles[layout[row, col]]
    if symbol not in (SAME, held):
        raise InputError(
            f"row {row}, column {col}: {symbol!r} is to stay, but the plan holds {held!r} there: "
            f"change one of the two, or draw {FREE!r}"
        )
    return held


USUAL = "warehouse-even"  # the domain where nothing says otherwise


class Plan(NamedTuple):
    """A layout with its domain."""

    name: str  # how tables and messages call it
    layout: np.ndarray  # int8 [H, W]
    domain: Domain  # whose layout; at its default size, not fitted to this one
    assumed: bool  # nothing but the tiles said whose layout it is
    # rows of a drawing of what must stay, as in `DomainConfig`; empty where nothing must
    keep: tuple[str, ...] = ()

    @property
    def whose(self) -> str:
        """Say whose layout it is, and how that is known, as commands print it."""
        how = " (assumed from the tiles; --domain chooses another)" if self.assumed else ""
        return f"domain {self.domain.name}{how}"

    def fitted(
        self, numbers: Mapping[str, int] | None = None, keep: str | Path | None = None
    ) -> Domain:
        """Make the domain that the plan is measured by: its size, its numbers, what must stay.

        Args:
            numbers: exact numbers of tiles; the plan's own where left out.
            keep: drawing of what must stay; what the plan's file says unless given.

        Raises:
            InputError: what must stay is drawn wrong, or can be in no layout.
        """
        domain = self.domain.fitted(self.layout, numbers)
        if keep is not None:
            return keep_from(keep, domain, self.layout)
        try:
            return domain.keeping(self.keep) if self.keep else domain
        except InputError as error:
            raise InputError(f'{self.name}: its file\'s key "keep": {error}') from error


def read_plan(path: str | Path, domain: str | None = None) -> Plan:
    """Read a layout and find its domain.

    Args:
        path: a .json, .txt, .csv or .map file.
        domain: name of its domain. Unless given: what the file says, else the usual one where its
            tiles fit, else the first one whose tiles do.

    Raises:
        InputError: the file holds no layout, or says that it is another domain's.
    """
    drawing = read_drawing(path)
    said = drawing.domain
    if said and domain and said != domain and said in DOMAINS.names():
        raise InputError(f"{path}: the file says {said}: leave --domain out, or change the file")
    if said and not domain and said not in DOMAINS.names():
        raise InputError(
            f"{path}: the file says domain {said!r}, which is unknown: "
            f"--domain chooses one of {', '.join(DOMAINS.names())}"
        )
    chosen = domain or said
    found = find_domain(chosen) if chosen else _guess_domain(set("".join(drawing.rows)))
    layout = to_layout(drawing.rows, path, found.tiles, found.meanings, found.name)
    return Plan(Path(path).stem, layout, found, assumed=not chosen, keep=drawing.keep)


def _guess_domain(symbols: set[str]) -> Domain:
    """Find whose tiles `symbols` are: drawn as they are, else with other symbols for the same."""
    for domain in _domains():
        if symbols <= set(domain.tiles):
            return domain
    for domain in _domains():
        if symbols <= {*domain.tiles, *aliases(domain.tiles, domain.meanings)}:
            return domain
    return find_domain(USUAL)


def _domains() -> Iterator[Domain]:
    """Make the domains one after the other, the usual one first."""
    for name in dict.fromkeys((USUAL, *DOMAINS.names())):
        with contextlib.suppress(InputError):  # somebody else's broken plug-in
            yield find_domain(name)
