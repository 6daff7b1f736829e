"""Who plans, in words: chosen by a name, an effort or settings, and named in reports."""

from dataclasses import asdict
from typing import Any

from qdenv.simulate.mapf.negotiated.settings import EFFORTS
from qdenv.simulate.mapf.settings import PLANNERS
from qdenv.types import InputError, look_up

OWN = "negotiated"  # the planner where none is named, and the only one with efforts
SILENT = "backend"  # a setting that decides no result: reports leave it out


def find_planner(effort: str | None = None, planner: Any = "", usual: str = "high") -> Any:
    """Choose a planner's settings.

    Args:
        effort: "low" or "high", of the negotiated planner; None for the usual one.
        planner: name of a registered planner, which stands for its defaults, or the settings
            themselves; "" for the negotiated one.
        usual: the effort where none is given.

    Raises:
        InputError: a word is unknown, settings are no planner's, or an effort is given with them
            or for another planner.
    """
    if isinstance(planner, str):
        if planner in ("", OWN):
            return look_up(EFFORTS, effort or usual, "effort")
        planner = PLANNERS.config(planner)
    name = PLANNERS.name_of(planner)
    if effort:
        reason = "its settings say all" if name == OWN else f"{name} has none"
        raise InputError(f"effort {effort} is for the {OWN} planner, and {reason}: leave it out")
    return planner


def describe_planner(settings: Any) -> str:
    """Name a planner and its settings for reports, like "pbs, rule plain, nodes per agent 10".

    The negotiated one by its effort, or the closest one, and what is other than there.
    """
    name, said = PLANNERS.name_of(settings), asdict(settings)
    words = [name]
    if name == OWN:
        others = {
            effort: {name: value for name, value in said.items() if value != asdict(known)[name]}
            for effort, known in EFFORTS.items()
        }
        effort = min(others, key=lambda effort: len(others[effort]))
        words, said = [name, f"{effort} effort"], others[effort]
    for key, value in said.items():
        number = f"{value:g}" if isinstance(value, float) else value
        words += [f"{key.replace('_', ' ')} {number}"] * (key != SILENT)
    return ", ".join(words)


def record_planner(settings: Any) -> dict[str, Any]:
    """List a planner's name and all its settings, for files."""
    return {"name": PLANNERS.name_of(settings), **asdict(settings)}
