"""Commands about runs: resume, generate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from qdenv.commands.choices import Numbers, RunFolder
from qdenv.commands.mazes import is_agent_run, resume_agent
from qdenv.commands.output import JsonFile, place, write_facts
from qdenv.commands.plot import report
from qdenv.io.layouts import check_size, endings_for, write_layout
from qdenv.progress import Bar
from qdenv.ranges import PositiveInt, Ranged
from qdenv.run.directory import RunDirectory
from qdenv.run.executors.base import Execution
from qdenv.types import InputError, RepairStatus

if TYPE_CHECKING:
    from qdenv.domains.base import Domain
    from qdenv.study.elites import Grown


def resume(
    run_dir: RunFolder,
    evaluations: int | None = None,
    execution: Annotated[Execution, tyro.conf.arg(name="")] = Execution(),  # noqa: B008 (frozen)
    progress: bool = True,
) -> None:
    """Continue a run where it stopped, of a search or of an agent's training.

    Args:
        run_dir: folder of the run.
        evaluations: a new total, to go on beyond the configured one.
        execution: where layouts are repaired and simulated; the same is found everywhere.
        progress: show a progress bar.
    """
    if is_agent_run(run_dir):
        return resume_agent(run_dir)
    run = RunDirectory.open(run_dir)
    run.demand_own()
    config = run.config
    if evaluations is not None and evaluations < config.evaluations:
        raise InputError(
            f"{run_dir}: {config.evaluations} evaluations are asked for already: ask for more, or "
            "leave --evaluations out"
        )
    from qdenv.run import loop  # imports both compilers

    report(loop.resume(run_dir, progress, evaluations, execution))


@dataclass(frozen=True)
class Growth(Ranged):
    """How far an elite grows."""

    rows: int | None = None  # rows of the layout; the trained size unless given
    cols: int | None = None  # columns of the layout; the trained size unless given
    # steps of growth; unless given what is known of the size, or else scaled with it
    steps: PositiveInt | None = None
    # drawing of the layout's shape: ? is free, a tile must be this tile; what the run kept, at its
    # size, unless given
    keep: Path | None = None
    frames: PositiveInt | None = None  # also draw the layout after every so many steps (Figure 6)

    def __post_init__(self) -> None:
        """Refuse what nothing could grow to."""
        super().__post_init__()
        check_size(1 if self.rows is None else self.rows, 1 if self.cols is None else self.cols)


@dataclass(frozen=True)
class Choice:
    """Which elite of the archive."""

    # "best" or another name in the zoo, or the archive cell's indices like 12,40
    elite: str = "best"
    # in place of that a value for each measure, like 200 0.8; the nearest elite
    measures: tuple[float, ...] = ()


def generate(
    run_dir: RunFolder,
    numbers: Numbers,
    growth: Annotated[Growth, tyro.conf.arg(name="")] = Growth(),
    choice: Annotated[Choice, tyro.conf.arg(name="")] = Choice(),
    seed: Annotated[int | None, tyro.conf.arg(aliases=("--repair-seed",))] = None,
    repair: bool = True,
    out: Path | None = None,
    json_file: JsonFile = None,
) -> None:
    """Grow an elite of a run at any size and repair it.

    Args:
        run_dir: folder of the run.
        numbers: exact numbers of tiles; unless given what is known of the size, or else scaled with
            the area.
        growth: size and steps.
        choice: which elite.
        seed: other seeds give other, equally good repairs; the run's own unless given.
        repair: --no-repair keeps what the automaton drew.
        out: layout file to write (.json, .txt, .csv), a picture is drawn beside it; layout.json
            unless given.
        json_file: where to write the facts; - for standard output.
    """
    run = RunDirectory.open(run_dir)
    config, found = run.config, run.archive.elite(choice.elite, choice.measures or None)
    # Only now: who is refused need not wait for what these import.
    from qdenv.domains.base import make_domain
    from qdenv.study.changes import describe_changes, list_changes
    from qdenv.study.elites import grow_elite, repair_grown

    trained = make_domain(config.evaluation.domain)
    target = place(out, "layout.json", endings_for(trained.tiles, trained.meanings))
    with Bar("growing") as bar:
        shape = (growth.rows, growth.cols)
        grown = grow_elite(run, found, shape, growth.steps, numbers.given(), growth.keep)
        if growth.frames is not None:
            _draw_frames(run, grown, growth.frames, target.beside(".png", "_frames").path)
        chosen = config.seed if seed is None else seed
        repaired = repair_grown(grown, config.evaluation.repair, chosen, bar) if repair else None
    _say_size(trained, grown.domain, [*numbers.given(), *(["steps"] if growth.steps else [])])
    layout = grown.layout if repaired is None else np.asarray(repaired.layout)
    details: dict[str, Any] = {"domain": grown.domain.name, "elite": found.cell}
    details["steps"] = grown.steps
    if repaired is not None:
        status = RepairStatus(int(repaired.status)).name.lower()
        details |= {"repair": status, "changed": float(repaired.cost)}
        print("\n".join(describe_changes(list_changes(grown.layout, layout, grown.domain))))
    kept = grown.domain.details | details
    write_layout(target.path, layout, grown.domain.tiles, grown.domain.meanings, **kept)
    picture = target.beside(".png")
    from qdenv.view.layouts import save_layout

    save_layout(picture.path, layout, grown.domain.tiles, grown.domain.names)
    rows, cols = layout.shape
    facts = {"rows": rows, "cols": cols, **grown.domain.numbers, **details}
    write_facts(json_file, "generate", facts, run=run_dir, elite=found.cell, seed=chosen)
    print(f"{target}: " + ", ".join(f"{name} {value}" for name, value in facts.items()))
    print(picture)


def _say_size(trained: Domain, grown: Domain, stated: Sequence[str]) -> None:
    """Say which numbers a size brought along, and whether what the run kept does not fit it."""
    from qdenv.study.options import describe_growth  # imports the domains

    if known := describe_growth(trained, grown.shape, stated):
        print(known)
    if trained.config.keep and not grown.config.keep:
        print(
            "WARNING: what the run kept is drawn for {} x {}, so nothing is kept at this size: "
            "--keep FILE draws what shall be".format(*trained.shape)
        )


def _draw_frames(run: RunDirectory, grown: Grown, every: int, picture: Path) -> None:
    """Draw how a layout grows, and say where and when."""
    from qdenv.study.sizes import grow_frames
    from qdenv.view.layouts import draw_frames
    from qdenv.view.style import save_figure

    after, drawn = grow_frames(run, grown, every)
    save_figure(draw_frames(drawn, after, grown.domain.tiles), picture)
    print(f"{picture}: after {', '.join(map(str, after))} steps")
