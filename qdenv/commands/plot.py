"""The command plot: a run's pictures, or several runs side by side."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal, TypeAlias

import tyro

from qdenv.commands import output, words
from qdenv.commands.choices import RunFolders
from qdenv.run.directory import RunDirectory
from qdenv.study.groups import CURVES, band_of, group_runs
from qdenv.types import InputError
from qdenv.zoo import file_name

Form: TypeAlias = Literal["png", "svg", "pdf"]
NO_SIZE: Mapping[str, float] = MappingProxyType({})


def plot(
    run_dirs: RunFolders,
    out: Path | None = None,
    form: Annotated[Form, tyro.conf.arg(name="format")] = "png",
    width: words.Width = None,
) -> None:
    """Draw a run's archive, progress and best layout again, or several runs side by side.

    Args:
        run_dirs: folders of runs; of several the archives on one colour scale, and the progress as
            mean and interval over runs that differ by their seeds alone.
        out: folder for the pictures; a run's own unless given, for generators of the zoo one
            named after them, for several runs plots.
        form: of the pictures.
        width: column or page of a journal, or inches; what suits a screen unless given.
    """
    size = words.inches(width)
    if not run_dirs:
        raise InputError("give at least one folder of a run")
    runs = [RunDirectory.open(run_dir) for run_dir in run_dirs]
    folder = out
    if out is None and (runs[1:] or runs[0].shipped):
        folder = output.place(None, "plots" if runs[1:] else file_name(run_dirs[0])).path
    if folder is not None and folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: that is a file: name a folder")
    if folder is None or not runs[1:]:
        report(runs[0], folder, form, size)
    else:
        report_all(runs, folder, form, size)


def report(
    run: RunDirectory,
    folder: Path | None = None,
    form: str = "png",
    size: Mapping[str, float] = NO_SIZE,
) -> None:
    """Draw a run's pictures, into its own folder unless another is given, and say where."""
    rows = run.read_metrics()
    if not rows:
        raise InputError(f"{run}: nothing is done yet; `qdenv resume {run}` begins")
    from qdenv.view.runs import plot_run

    pictures, last = plot_run(run, folder, form, **size), rows[-1]
    print(
        f"QD-score {last.qd_score:.2f}, coverage {last.coverage:.1%}, best objective "
        f"{last.best_objective:.3f} after {last.evaluations} evaluations in {last.seconds:.0f} s"
    )
    print("\n".join(str(picture) for picture in pictures))


def report_all(
    runs: Sequence[RunDirectory], folder: Path, form: str, size: Mapping[str, float]
) -> None:
    """Draw several runs side by side, and say what they came to and where the pictures are."""
    groups = group_runs(runs)
    from qdenv.view.runs import plot_runs

    pictures = plot_runs(runs, folder, form, **size)
    for group in groups:
        said = []
        for name, word in CURVES.items():
            end = band_of(group.curves[name][:, -1:])
            spread = f" +- {end.half[0]:.2g}" if len(group.runs) > 1 else ""
            said.append(f"{word} {end.mean[0]:.4g}{spread}")
        print(f"{group.title}: {', '.join(said)} after {group.evaluations[-1]} evaluations")
    if len(groups) < len(runs):
        print("+-: half the width of the 95 % interval over runs")
    print("\n".join(str(picture) for picture in pictures))
