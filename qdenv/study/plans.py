"""A layout file and the domain it belongs to."""

import contextlib
import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.domains.base import Domain, find_domain
from qdenv.formats.layouts import read_layout
from qdenv.types import InputError

USUAL = "warehouse-even"  # the domain where nothing says otherwise


class Plan(NamedTuple):
    """A layout with its domain.

    Attributes:
        name: how tables and messages call it.
        layout: int8 [H, W].
        domain: whose layout; at its default size, not fitted to this one.
        assumed: nothing but the tiles said whose layout it is.
    """

    name: str
    layout: np.ndarray
    domain: Domain
    assumed: bool


def read_plan(path: str | Path, domain: str | None = None) -> Plan:
    """Read a layout and find its domain.

    Args:
        path: the file.
        domain: name of its domain; what the file says unless given.

    Raises:
        InputError: the file holds no layout, or says that it is another domain's.
    """
    said = None
    with contextlib.suppress(OSError, ValueError, AttributeError):  # what is wrong is said below
        said = json.loads(Path(path).read_text(encoding="utf-8-sig")).get("domain")
    if said and domain and said != domain:
        raise InputError(f"{path}: the file says {said}: leave --domain out, or change the file")
    found = find_domain(domain or said or USUAL)
    assumed = not (domain or said)
    return Plan(Path(path).stem, read_layout(path, found.tiles), found, assumed)
