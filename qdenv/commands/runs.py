"""Commands about runs: train, resume, plot, presets, generate."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import tyro

from qdenv.formats.layouts import write_layout
from qdenv.plots.layouts import save_layout
from qdenv.plots.run import plot_run
from qdenv.plots.sizes import save_frames
from qdenv.presets import PRESETS, find_preset
from qdenv.study.elites import grow_elite, repair_grown
from qdenv.study.sizes import grow_frames
from qdenv.train import loop
from qdenv.train.config import RunConfig
from qdenv.train.records import RunDirectory
from qdenv.types import RepairStatus


@dataclass(frozen=True)
class Train:
    """Search generators: qdenv train [PRESET]; every setting of the preset can be overridden.

    Attributes:
        config: what to do; defaults from the preset.
        run_dir: folder of the run; a fresh one under runs/ unless given.
        progress: show a progress bar.
    """

    config: RunConfig
    run_dir: Path | None = None
    progress: bool = True


def train(arguments: list[str]) -> None:
    """Run `qdenv train [PRESET] ...`; the preset decides the defaults of the other arguments."""
    named = bool(arguments) and not arguments[0].startswith("-")
    preset = arguments[0] if named else "quick"
    asked = tyro.cli(
        Train,
        prog=f"qdenv train {preset}",
        args=arguments[named:],
        default=Train(find_preset(preset)),
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.AvoidSubcommands),
    )
    stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
    path = asked.run_dir or Path("runs") / f"{preset}-{stamp}"
    print(f"{preset}: {asked.config.evaluations} evaluations into {path}")
    report(loop.train(asked.config, path, progress=asked.progress))


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


def presets() -> None:
    """List the presets with their main numbers."""
    for name, preset in PRESETS.items():
        numbers = preset.evaluation
        print(
            f"{name:20} {numbers.domain:17} {numbers.rows}x{numbers.cols}, agents "
            f"{numbers.agents}, T {numbers.timesteps}, alpha {numbers.alpha:g}, "
            f"evaluations {preset.evaluations}"
        )


def generate(
    run_dir: tyro.conf.Positional[Path],
    elite: str = "best",
    rows: int | None = None,
    cols: int | None = None,
    steps: int | None = None,
    shelves: int | None = None,
    repair_seed: int | None = None,
    repair: bool = True,
    frames: int | None = None,
    out: Path = Path("layout.json"),
) -> None:
    """Grow an elite of a run at any size and repair it.

    Args:
        run_dir: the run directory.
        elite: "best", or the archive cell's indices like 12,40.
        rows: rows of the layout; the trained size unless given.
        cols: columns of the layout; the trained size unless given.
        steps: NCA steps; scaled with the size unless given.
        shelves: number of shelves; scaled with the area unless given.
        repair_seed: other seeds give other, equally good repairs; the run's own unless given.
        repair: --no-repair keeps what the NCA drew.
        frames: also draw the layout after every so many steps (Figure 6).
        out: layout file to write; a picture is drawn beside it.
    """
    run = RunDirectory.open(run_dir)
    config = run.config
    grown = grow_elite(run, elite, (rows, cols), steps, shelves)
    if frames is not None:
        numbers, drawn = grow_frames(run, grown, frames)
        picture = out.with_name(f"{out.stem}_frames.png")
        save_frames(picture, drawn, numbers, grown.domain.tiles)
        print(f"{picture}: after {', '.join(map(str, numbers))} steps")
    seed = config.seed if repair_seed is None else repair_seed
    repaired = repair_grown(grown, config.evaluation.repair, seed) if repair else None
    layout = grown.layout if repaired is None else repaired.layout
    details = {"domain": grown.domain.name, "elite": grown.elite.cell, "steps": grown.steps}
    if repaired is not None:
        details |= {
            "repair": RepairStatus(int(repaired.status)).name.lower(),
            "changed": float(repaired.cost),
        }
    write_layout(out, layout, grown.domain.tiles, **details)
    save_layout(out.with_suffix(".png"), layout, grown.domain.tiles)
    print(f"{out}: " + ", ".join(f"{name} {value}" for name, value in details.items()))
