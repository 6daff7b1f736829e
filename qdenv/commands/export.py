"""The command export: a run's elites for other programs."""

from pathlib import Path

from qdenv.commands import output
from qdenv.commands.choices import RunFolder
from qdenv.domains.base import DOMAINS
from qdenv.run.directory import RunDirectory
from qdenv.zoo import file_name


def export(
    run_dir: RunFolder,
    out: Path | None = None,
    layouts: Path | None = None,
    solutions: bool = False,
) -> None:
    """Write the elites of a run as a table, and all their layouts.

    The table has a row for each elite: its cell (as --elite takes it), its objective, each measure
    by its name, and what was counted in its simulations.

    Args:
        run_dir: the run directory.
        out: table to write, .csv or .parquet; RUN_elites.csv unless given.
        layouts: folder to write a layout file for each elite into, named by its cell.
        solutions: add the parameters of the generators to the table.
    """
    run = RunDirectory.open(run_dir)
    place = output.place(out, f"{file_name(run_dir)}_elites.csv", (".csv", ".parquet"))
    archive = run.archive
    archive.write_table(place.path, solutions)
    print(f"{place}: {len(archive)} elites")
    if layouts is not None:
        archive.write_layouts(layouts, DOMAINS.name_of(run.config.evaluation.domain))
        print(f"{layouts}: {len(archive)} layouts")
