"""What a report is about: floor plans, given as files or as the best of a run, and their rival."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from qdenv.domains.base import make_domain
from qdenv.run.archive import Elite
from qdenv.run.directory import RunDirectory
from qdenv.shipped import PREFIX, file_name
from qdenv.study.plans import Plan, read_plan
from qdenv.types import InputError
from qdenv.view.page import FILTERS

_HAND_MADE = "hand-made"
_SHOWN = "At the right is what people draw by hand at this size."


class Subject(NamedTuple):
    """A floor plan that is reported on."""

    name: str  # how the page calls it
    source: str  # the file or run that it comes from, as the command line names it
    plan: Plan  # the layout and its domain
    run: RunDirectory | None = None  # the run whose best elite it is; None for a file
    elite: Elite | None = None  # that elite

    @property
    def layout(self) -> np.ndarray:
        """The layout, int8 [H, W]."""
        return self.plan.layout

    @property
    def size(self) -> str:
        """Say its rows and columns."""
        rows, cols = self.layout.shape
        return f"{rows} x {cols}"

    @property
    def contents(self) -> str:
        """Write its size and its numbers of tiles."""
        return name_contents(self.layout, self.numbers)

    @property
    def numbers(self) -> dict[str, int]:
        """Count the tiles of which the domain demands a number, by the settings' names."""
        return self.plan.domain.fitted(self.layout).numbers


def name_contents(layout: np.ndarray, numbers: Mapping[str, int]) -> str:
    """Write the size of a layout (int8 [H, W]) and its numbers of tiles."""
    rows, cols = layout.shape
    named = [f"{number:,} {name}" for name, number in numbers.items()]
    return f"{rows} x {cols} cells" + (f" with {FILTERS['listed'](named)}" if named else "")


class Rival(NamedTuple):
    """The layout that people draw by hand, to compare with."""

    name: str  # how the page calls it
    layout: np.ndarray | None  # int8 [H, W]; None where there is none
    about: str  # what it is, or why there is none


def is_run(source: str | Path) -> bool:
    """Tell a run from a layout file."""
    return str(source).startswith(PREFIX) or Path(source).is_dir()


def subject_of_run(run: RunDirectory) -> Subject:
    """Report on the best elite of a run.

    Raises:
        InputError: it has none.
    """
    elite, domain = run.best, make_domain(run.config.evaluation.domain)
    name = str(run.shipped).removeprefix(PREFIX) if run.shipped else file_name(run.path)
    plan = Plan(name, np.asarray(elite.layout), domain, assumed=False)
    return Subject(name, str(run), plan, run, elite)


def read_subjects(sources: Sequence[str | Path], domain: str | None = None) -> list[Subject]:
    """Read layout files and runs of one domain, each under a name of its own.

    Raises:
        InputError: nothing is given, something cannot be read, or they are of several domains.
    """
    subjects = []
    for source in sources:
        if is_run(source):
            subjects.append(subject_of_run(RunDirectory.open(source)))
        else:
            plan = read_plan(source, domain)
            subjects.append(Subject(plan.name, str(source), plan))
    return distinct(subjects)


def distinct(subjects: Sequence[Subject]) -> list[Subject]:
    """Check that all are of one domain, and give those of the same name their source's.

    Raises:
        InputError: there is none, or they are of several domains, or one is named twice.
    """
    if not subjects:
        raise InputError("give at least one layout file or run")
    kinds = list(dict.fromkeys(one.plan.domain.name for one in subjects))
    if len(kinds) > 1:
        raise InputError(f"these are of {' and '.join(kinds)}: report on one domain at a time")
    counts = Counter(one.name for one in subjects)
    named = [one if counts[one.name] == 1 else one._replace(name=one.source) for one in subjects]
    if len({one.name for one in named}) < len(named):
        raise InputError(f"{named[0].source}: name each layout and run once")
    return named


def find_rival(subject: Subject, subjects: Sequence[Subject]) -> Rival:
    """Draw what people design by hand at the size of a layout, and say how it compares.

    Args:
        subject: whose rival.
        subjects: all layouts of the report, among which the rival itself may be.
    """
    domain, size = subject.plan.domain, subject.size
    if domain.human is None:
        return Rival("", None, f"Nobody designs layouts of {domain.name} by hand.")
    rows, cols = subject.layout.shape
    from qdenv.study.elites import human_layout  # imports both compilers

    try:
        layout = human_layout(domain.resized(rows, cols))
    except InputError as error:
        return Rival("", None, f"Nobody draws {size} by hand: {error}.")
    if np.array_equal(layout, subject.layout):
        return Rival("", None, f"This is the very layout that people draw by hand at {size}.")
    same = [one.name for one in subjects if np.array_equal(one.layout, layout)]
    sizes = {one.layout.shape for one in subjects}
    name = same[0] if same else _HAND_MADE if len(sizes) == 1 else f"{_HAND_MADE} {size}"
    return Rival(name, layout, _compared(subject, domain.fitted(layout).numbers))


def _compared(subject: Subject, theirs: Mapping[str, int]) -> str:
    """Say whether the hand-made layout holds as many tiles of each kind."""
    own = subject.numbers
    if own == theirs:
        alike = ", ".join(f"{number} {name}" for name, number in own.items())
        return f"{_SHOWN} Both hold {alike}."
    others = [
        f"{theirs[name]} {name} where this one has {own[name]}"
        for name in own
        if own[name] != theirs[name]
    ]
    return f"{_SHOWN} It holds {', '.join(others)}: the design leaves no choice of that."
