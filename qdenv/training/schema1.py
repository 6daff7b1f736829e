"""Configurations of schema 1, in which one flat record held the numbers of every domain."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from qdenv.domains.base import DOMAINS
from qdenv.generate.generator import GENERATORS
from qdenv.simulate.mapf.negotiated.settings import EFFORTS
from qdenv.types import InputError, look_up

FLEET = ("agents", "timesteps")


def upgraded(content: dict[str, Any]) -> dict[str, Any]:
    """Turn the JSON of schema 1 into that of today; what is of today already stays as it is.

    Numbers that a domain does not have (shelves of a factory, the fleet of a maze) decided
    nothing and are dropped.

    Raises:
        InputError: the domain is unknown, or a number is missing.
    """
    flat = content["evaluation"]
    if not isinstance(flat.get("domain"), str):
        return content
    name = flat["domain"]
    domain = {"name": name} | _fields_of(DOMAINS.entry(name).config, flat)
    if "fleet" in {field.name for field in dataclasses.fields(DOMAINS.entry(name).config)}:
        effort = look_up(EFFORTS, str(flat.get("effort")), "effort")
        planner = {"name": "negotiated"} | dataclasses.asdict(effort)
        domain["fleet"] = _taken(flat, FLEET) | {"planner": planner}
    generator = {"name": "nca"} | _fields_of(GENERATORS.entry("nca").config, flat)
    kept = _taken(flat, ("simulations", "alpha", "repair"))
    return content | {"evaluation": kept | {"domain": domain, "generator": generator}}


def _fields_of(settings: type, flat: dict[str, Any]) -> dict[str, Any]:
    names = {field.name for field in dataclasses.fields(settings)}
    return {name: value for name, value in flat.items() if name in names}


def _taken(flat: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    for name in names:
        if name not in flat:
            raise InputError(f"evaluation.{name} is missing")
    return {name: flat[name] for name in names}
