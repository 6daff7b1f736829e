"""Commands about runs: resume, plot, generate."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from qdenv.commands.choices import Numbers
from qdenv.formats.layouts import write_layout
from qdenv.plots.layouts import save_frames, save_layout
from qdenv.plots.run import plot_run
from qdenv.study.changes import describe_changes, list_changes
from qdenv.study.elites import find_elite, grow_elite, repair_grown
from qdenv.study.sizes import grow_frames
from qdenv.training import loop
from qdenv.training.records import RunDirectory
from qdenv.types import RepairStatus


def resume(
    run_dir: tyro.conf.Positional[Path], evaluations: int | None = None, progress: bool = True
) -> None:
    """Continue a run where it stopped.

    Args:
        run_dir: the run directory.
        evaluations: a new total, to go on beyond the configured one.
        progress: show a progress bar.
    """
    report(loop.resume(run_dir, progress=progress, evaluations=evaluations))


def plot(run_dir: tyro.conf.Positional[Path]) -> None:
    """Draw a run's archive and best layout again.

    Args:
        run_dir: the run directory.
    """
    report(RunDirectory.open(run_dir))


def report(run: RunDirectory) -> None:
    """Draw a run's pictures and say where they are."""
    pictures = plot_run(run)
    last = run.read_metrics()[-1]
    print(
        f"QD-score {last.qd_score:.2f}, coverage {last.coverage:.1%}, best objective "
        f"{last.best_objective:.3f} after {last.evaluations} evaluations in {last.seconds:.0f} s"
    )
    print("\n".join(str(picture) for picture in pictures))


@dataclass(frozen=True)
class Growth:
    """How far an elite grows.

    Attributes:
        rows: rows of the layout; the trained size unless given.
        cols: columns of the layout; the trained size unless given.
        steps: NCA steps; scaled with the size unless given.
        keep: drawing of the layout's shape: ? is free, a tile must be this tile; what the run
            kept, at its size, unless given.
    """

    rows: int | None = None
    cols: int | None = None
    steps: int | None = None
    keep: Path | None = None


def generate(
    run_dir: tyro.conf.Positional[Path],
    numbers: Numbers,
    growth: Annotated[Growth, tyro.conf.arg(name="")] = Growth(),
    elite: str = "best",
    repair_seed: int | None = None,
    repair: bool = True,
    frames: int | None = None,
    out: Path = Path("layout.json"),
) -> None:
    """Grow an elite of a run at any size and repair it.

    Args:
        run_dir: the run directory.
        numbers: exact numbers of tiles; scaled with the area unless given.
        growth: size and steps.
        elite: "best", or the archive cell's indices like 12,40.
        repair_seed: other seeds give other, equally good repairs; the run's own unless given.
        repair: --no-repair keeps what the NCA drew.
        frames: also draw the layout after every so many steps (Figure 6).
        out: layout file to write; a picture is drawn beside it.
    """
    run = RunDirectory.open(run_dir)
    config = run.config
    found = find_elite(run, elite)
    shape = growth.rows, growth.cols
    grown = grow_elite(run, found, shape, growth.steps, numbers.given(), growth.keep)
    if frames is not None:
        after, drawn = grow_frames(run, grown, frames)
        picture = out.with_name(f"{out.stem}_frames.png")
        save_frames(picture, drawn, after, grown.domain.tiles)
        print(f"{picture}: after {', '.join(map(str, after))} steps")
    seed = config.seed if repair_seed is None else repair_seed
    repaired = repair_grown(grown, config.evaluation.repair, seed) if repair else None
    layout = grown.layout if repaired is None else np.asarray(repaired.layout)
    details: dict[str, Any] = {
        "domain": grown.domain.name,
        "elite": found.cell,
        "steps": grown.steps,
    }
    if repaired is not None:
        details |= {
            "repair": RepairStatus(int(repaired.status)).name.lower(),
            "changed": float(repaired.cost),
        }
    write_layout(out, layout, grown.domain.tiles, **details)
    save_layout(out.with_suffix(".png"), layout, grown.domain.tiles, grown.domain.names)
    if repaired is not None:
        print("\n".join(describe_changes(list_changes(grown.layout, layout, grown.domain))))
    print(f"{out}: " + ", ".join(f"{name} {value}" for name, value in details.items()))
