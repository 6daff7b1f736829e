"""A layout, whatever form it has: a file, an array with a domain, what a function returned."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np

from qdenv.api.results import Layout
from qdenv.domains.base import DOMAINS, find_domain
from qdenv.study.plans import Plan
from qdenv.study.plans import read_plan as read_file
from qdenv.types import InputError

# Path of a layout file, a `Plan`, a `Layout`, or int [H, W] with ``domain=`` beside it.
Source: TypeAlias = "str | Path | Plan | Layout | np.ndarray | Sequence[Sequence[int]]"


def read_plan(layout: Source, domain: str | None = None) -> Plan:
    """Read a layout, whatever form it has.

    Args:
        layout: path of a file, a `Plan`, a `Layout`, or an int array [H, W] of tiles.
        domain: whose layout; arrays do not say it, the others do.

    Raises:
        InputError: it is no layout, or of another domain.
    """
    if isinstance(layout, str | Path):
        return read_file(layout, domain)
    if isinstance(layout, Plan | Layout):
        if domain not in (None, layout.domain.name):
            raise InputError(f"this layout is of {layout.domain.name}: leave domain out")
        name = layout.name if isinstance(layout, Plan) else "layout"
        return Plan(name, layout.layout, layout.domain, assumed=False)
    if domain is None:
        names = ", ".join(repr(name) for name in DOMAINS.names())
        raise InputError(f"an array does not say whose layout it is: give domain, one of {names}")
    found, tiles = find_domain(domain), np.asarray(layout)
    if tiles.ndim != 2 or tiles.dtype.kind not in "iu" or not tiles.size:
        raise InputError("a layout is an array of whole numbers with rows and columns")
    if tiles.min() < 0 or tiles.max() >= len(found.tiles):
        raise InputError(f"tiles of {domain} are 0 to {len(found.tiles) - 1} ({found.tiles!r})")
    return Plan("layout", tiles.astype(np.int8), found, assumed=False)
