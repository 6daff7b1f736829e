"""What a report is about: floor plans, given as files or as the best of a run, and their rival."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from qdenv.run.directory import RunDirectory
from qdenv.study.plans import Plan
from qdenv.types import InputError
from qdenv.view.page import listed


class Subject(NamedTuple):
    """A floor plan that is reported on."""

    name: str  # how the page calls it
    source: str  # the file or run that it comes from, as the command line names it
    plan: Plan  # the layout and its domain
    run: RunDirectory | None = None  # the run whose best elite it is; None for a file


class Rival(NamedTuple):
    """The layout that people draw by hand, to compare with."""

    plan: Plan  # the layout, its domain and how the page calls it
    about: str  # what it holds, and where that differs


def distinct(subjects: Sequence[Subject]) -> list[Subject]:
    """Check that all are of one domain, and rename those of the same name after their source.

    Raises InputError if there is none, or they are of several domains, or one is named twice.
    """
    if not subjects:
        raise InputError("give at least one layout file or run")
    kinds = list(dict.fromkeys(one.plan.domain.name for one in subjects))
    if len(kinds) > 1:
        raise InputError(f"these are of {' and '.join(kinds)}: report on one domain at a time")
    # Two files of one name in different folders are named by their paths.
    counts = Counter(one.name for one in subjects)
    named = [one if counts[one.name] == 1 else one._replace(name=one.source) for one in subjects]
    if len({one.name for one in named}) < len(named):
        raise InputError("name each layout and run once")
    return named


def find_rival(subject: Subject, subjects: Sequence[Subject]) -> Rival | None:
    """Draw what people design by hand around the same stations; None where there is no such layout.

    Where stations stand decides much of what a floor plan moves: one with others says nothing about
    the rest. One of the `subjects` of the report is no rival: all are compared with the first one.
    """
    domain, layout = subject.plan.domain, subject.plan.layout
    try:
        design = domain.resized(*layout.shape).human
        human = design and design()
    except InputError:
        return None
    if human is None:
        return None
    # Tiles that no generator draws: stations, and walls.
    fixed = [kind for kind, tile in enumerate(domain.tiles) if tile not in domain.generated]
    theirs, ours = (np.where(np.isin(one, fixed), one, -1) for one in (human, layout))
    if not np.array_equal(theirs, ours):
        return None
    if any(np.array_equal(one.plan.layout, human) for one in subjects):
        return None
    sizes = {one.plan.layout.shape for one in subjects}
    size = "{} x {}".format(*layout.shape)
    name = "hand-made" if len(sizes) == 1 else f"hand-made {size}"
    while any(one.name == name for one in subjects):  # rows are found by name
        name += " design"
    own, other = domain.fitted(layout).numbers, domain.fitted(human).numbers
    differ = [f"{other[kind]} {kind}, not {own[kind]}" for kind in own if own[kind] != other[kind]]
    holds = f", with {listed(differ)}" if differ else ""
    about = f"What people draw by hand at {size}, around the same stations{holds}."
    return Rival(Plan(name, human, domain, assumed=False), about)
