"""How the generators that ship are chosen among the elites of a run: rules as data."""

from collections.abc import Mapping
from typing import NamedTuple

from qdenv.shipped import USUAL

ENTROPY, ACTIONS = "environment entropy", "mean agent path length"
GOOD, SURE = ("objective", 0.5), ("success", 0.5)


class Rule(NamedTuple):
    """How a generator is chosen: steps narrow the elites down, and a number orders the rest."""

    name: str  # of the generator
    about: str  # what it is
    # the number, a measure or a mean over simulations; the largest comes first, or the smallest
    # where a minus stands before it
    order: str
    # (number, share): keep this share of what is left, the first in this order
    steps: tuple[tuple[str, float], ...] = (GOOD,)
    tried: int = 5  # elites that are grown at the largest size, the first in this order
    # try one elite, the first, in each square of so many cells of the archive: those beside each
    # other grow much alike; 0 tries them all
    apart: int = 0


def with_fleets(things: str, noun: str, few: str, many: str) -> tuple[Rule, ...]:
    """List the rules of a domain whose elites differ in entropy and in a number of `things`."""
    tenth, third = ((f"-{ENTROPY}", 0.1),), (f"-{ENTROPY}", 0.3)
    best = "of those tried that flow at the largest size under both planners, moved most in a trial"
    regular = f"one of the best regular ones with few {noun}"
    clean = "chosen by similarity to its drawing, as the search measures it"
    alike = "few different patterns of tiles at the trained size: of low entropy"
    unlike = "many different patterns of tiles at the trained size: of high entropy"
    return (
        Rule(USUAL, best, "objective", tried=24, apart=8),
        Rule("regular", alike, f"-{ENTROPY}"),
        Rule("varied", unlike, ENTROPY),
        Rule(f"few-{noun}", few, f"-{things}"),
        Rule(f"many-{noun}", many, things),
        Rule("orderly", "one of the best of the most regular tenth", "objective", tenth),
        Rule(f"orderly-few-{noun}", regular, "objective", (third, (f"-{things}", 0.3))),
        Rule("clean", clean, "similarity"),
        Rule("calm", "robots wait little", "-waiting"),
        Rule("short-ways", "short ways from task to task", "-path_length"),
    )


def in_mazes(thing: str, names: tuple[str, str], much: tuple[str, str]) -> tuple[Rule, ...]:
    """List the rules of mazes that differ in a measure, and in how far the agent walks.

    The pairs name generators with much and with little of it, and much and little.
    """
    more, less = names
    far, near = (SURE, ("shortest", 0.2)), (SURE, ("-shortest", 0.3))
    dense, sparse = (SURE, (thing, 0.1)), (SURE, (f"-{thing}", 0.1))
    missed = (("shortest", 0.2), ("success", 0.7))
    best = "a long way that the agent finds at the largest size, too"
    slow = "many actions of the agent, which mostly arrives (at 18 x 18)"
    return (
        Rule(USUAL, best, "shortest", (SURE,), tried=8),
        Rule("straight", "a far goal, found with few detours (at 18 x 18)", f"-{ACTIONS}", far),
        Rule("winding", "a goal that is near and found late", ACTIONS, near),
        Rule("wandering", slow, ACTIONS, (SURE,)),
        Rule(more, f"{much[0]} that leave a long way", thing, far),
        Rule(less, f"{much[1]} that leave a long way", f"-{thing}", far),
        Rule(f"{more}-long", f"{much[0]} above all, then a long way", "shortest", dense),
        Rule(f"{less}-long", f"{much[1]} above all, then a long way", "shortest", sparse),
        Rule("hard", "a long way that the agent sometimes misses", "-success", missed),
    )


_WAREHOUSE = with_fleets(
    "connected shelf components",
    "blocks",
    "long shelves: few connected blocks",
    "short shelves: many connected blocks",
)
# By domain: the rule of the best, which orders its candidates, and those of the others.
RULES: Mapping[str, tuple[Rule, ...]] = {
    "warehouse-even": _WAREHOUSE,
    # Few of its elites move much at the largest size: more are tried.
    "warehouse-uneven": (_WAREHOUSE[0]._replace(tried=72, apart=3), *_WAREHOUSE[1:]),
    "manufacturing": with_fleets("workstations", "stations", "few stations", "many stations"),
    "maze-walls": in_mazes("number of walls", ("dense", "open"), ("many walls", "few walls")),
    "maze-entropy": in_mazes(ENTROPY, ("varied", "regular"), ("irregular walls", "regular walls")),
}
