"""Facts about a plan that its drawing cannot hold: a few lines of TOML above it, or beside it.

Above the rows of a .txt, between two lines ``+++``; beside a plan of any format, in a file of its
name that ends in .toml. What is stated above counts more.
"""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from qdenv.io.files import MEGABYTE, parsing, read_text, write_atomically
from qdenv.io.records import structured
from qdenv.ranges import PositiveFloat, PositiveInt, Ranged, read_range
from qdenv.types import InputError, about

FENCE = "+++"  # a line before and after facts above a drawing
_HEAD = "# Written by qdenv beside the plan of this name.\n"  # such a file may be replaced


@dataclass(frozen=True)
class PlanFacts(Ranged):
    """What is stated about a plan beside its drawing."""

    domain: str | None = None  # name of a domain
    # further symbols, each with the tile it stands for: {S = "@", P = "w"}
    legend: Mapping[str, str] = field(default_factory=dict)
    # layers of a drawing of CAD, each with the tile that its shapes are: {RACKS = "@"}
    layers: Mapping[str, str] = field(default_factory=dict)
    shelves: int | str | None = None  # how many there are to be: 1100, or from "1000:1200"
    robots: PositiveInt | None = None  # how many drive where no option says so
    cell: PositiveFloat | None = None  # length of a cell's side [m]
    seconds_per_step: PositiveFloat | None = None  # of one timestep
    keep: str = ""  # what must stay, like --keep
    drawing: tuple[str, ...] = ()  # what must stay, as the rows of a drawing
    # of the plan's domain, like aisle = 2, by their names
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def details(self) -> dict[str, Any]:
        """What a plan made of this one states, too, as in a layout file: robots and units."""
        names = "robots", "cell", "seconds_per_step"
        facts = {name: one for name in names if (one := getattr(self, name)) is not None}
        return {"facts": facts} if facts else {}


# Names of facts; any other is a setting of the domain.
FACTS = tuple(one.name for one in fields(PlanFacts) if one.name != "settings")


def facts_beside(plan: Path) -> dict[str, Any]:
    """Read the facts in the file beside a plan; empty where there is none."""
    path = plan.with_suffix(".toml")
    if path == plan or not path.is_file():
        return {}
    with parsing(path, "TOML"):
        return tomllib.loads(read_text(path, MEGABYTE, "TOML"))


def make_facts(content: Mapping[str, Any], source: Path) -> PlanFacts:
    """Check the types of facts; what is none of their names is a setting of the domain.

    Raises InputError, which names the `source` and the fact.
    """
    own = {name: one for name, one in content.items() if name in FACTS}
    own["settings"] = {name: one for name, one in content.items() if name not in FACTS}
    facts = structured(own, PlanFacts, source)
    with about(str(source)):
        if facts.shelves is not None:
            read_range("shelves", facts.shelves)
        for sign, tile in facts.legend.items():
            if len(sign) != 1 or len(tile) != 1:
                raise InputError(f"legend: {sign} = {tile!r}: one sign stands for one tile")
    return facts


def write_facts(plan: Path, details: Mapping[str, Any], needed: bool) -> list[str]:
    """Write the facts beside a plan that its format cannot hold, if `needed` or some are there.

    Returns what to log. A file of this name that is not of qdenv stays.
    """
    path = plan.with_suffix(".toml")
    if older := path.exists():
        if not read_text(path, MEGABYTE, "TOML").startswith(_HEAD):
            return [f"{path} is not of qdenv: not replaced"]
    elif not needed:
        return []
    named = {"drawing" if name == "keep" else name: one for name, one in details.items()}
    facts = {"domain": named.pop("domain"), **named.pop("facts", {}), **named}
    # What is written here is the same in JSON and in TOML.
    lines = [f"{name} = {json.dumps(one, indent=1)}\n" for name, one in facts.items()]
    write_atomically(path, (_HEAD + "".join(lines)).encode())
    return [f"{path} (replaced)" if older else str(path)]
