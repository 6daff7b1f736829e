"""Elites of a run as files for other programs: tables, and a layout file for each."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from qdenv.domains.base import DOMAINS
from qdenv.io.files import write_atomically, write_csv
from qdenv.io.layouts import write_layout
from qdenv.run.archive import Archive
from qdenv.types import InputError

TABLES = (".csv", ".parquet")


def write_table(archive: Archive, path: Path, solutions: bool = False) -> None:
    """Write `Archive.table`, one row per elite.

    Args:
        archive: of a run.
        path: a .csv or .parquet file.
        solutions: include the parameters.

    Raises:
        InputError: Parquet is asked for without its packages, or the place cannot be written to.
    """
    if path.suffix.lower() != ".parquet":
        table = archive.table(solutions)
        # Not as Python's numbers, which would tell apart what single precision does not hold.
        columns = [list(column) for column in table.values()]
        write_csv(path, list(table), zip(*columns, strict=True))
        return
    content = io.BytesIO()
    try:
        archive.to_pandas(solutions).to_parquet(content, index=False)
    except ImportError as error:
        raise InputError(
            f"{path}: Parquet needs pandas and pyarrow: pip install 'qdenv[data]', or write a .csv"
        ) from error
    write_atomically(path, content.getvalue())


def write_layouts(archive: Archive, folder: Path, settings: Any) -> int:
    """Write a layout file for each elite, named by its cell: 12_40.json.

    Args:
        archive: of a run.
        folder: where; made if need be.
        settings: of the run's domain.

    Returns:
        how many were written.

    Raises:
        InputError: the place cannot be written to.
    """
    domain = DOMAINS.name_of(settings)
    for cell in archive.cells:
        elite = archive.elite(tuple(cell))
        details = {"objective": elite.objective, "measures": dict(elite.measures)}
        path = folder / f"{'_'.join(map(str, elite.cell))}.json"
        write_layout(path, elite.layout, elite.meaning.tiles, domain=domain, **details)
    return len(archive)
