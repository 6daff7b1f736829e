"""What the benchmarks share: timing, tables, the file of results."""

import resource
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Self

import jax

from qdenv.io.files import write_json

Row = dict[str, Any]


class Stopwatch:
    """Adds up the CPU seconds of all threads, and the wall seconds, of its `with` blocks."""

    def __init__(self) -> None:
        """Start at zero."""
        self.cpu = self.wall = 0.0

    def __enter__(self) -> Self:
        """Start a block."""
        self._begin = time.process_time(), time.perf_counter()
        return self

    def __exit__(self, *error: object) -> None:
        """Add the block."""
        self.cpu += time.process_time() - self._begin[0]
        self.wall += time.perf_counter() - self._begin[1]

    def per(self, items: int, prefix: str = "") -> Row:
        """Return the milliseconds per item."""
        cpu, wall = 1000 * self.cpu / items, 1000 * self.wall / items
        return {f"{prefix}cpu_ms": cpu, f"{prefix}wall_ms": wall}


def best_of(repeats: int, call: Callable[[], Any], items: int = 1) -> Row:
    """Time a call that compiles the first time.

    Return cpu_ms and wall_ms per item of the fastest of `repeats` calls, worst_cpu_ms of the
    slowest, first_cpu_s: CPU seconds of the call before them, compilation included.
    """
    first, *calls = (Stopwatch() for _ in range(repeats + 1))
    for watch in (first, *calls):
        with watch:
            jax.block_until_ready(call())
    calls.sort(key=lambda watch: watch.cpu)
    worst = calls[-1].per(items)["cpu_ms"]
    return calls[0].per(items) | {"worst_cpu_ms": worst, "first_cpu_s": first.cpu}


def show(title: str, rows: Iterable[Row]) -> list[Row]:
    """Print a table, each row as soon as it is measured, and return the rows.

    The columns are the numbers and texts of the first row; lists are for the file alone.
    """
    shown: list[Row] = []
    for row in rows:
        if not shown:
            columns = [name for name, value in row.items() if not isinstance(value, list | tuple)]
            print(f"\n{title}\n" + _line(columns, columns))
        print(_line(columns, [row[name] for name in columns]), flush=True)
        shown.append(row)
    return shown


def _line(columns: list[str], values: list[Any]) -> str:
    """Align values under the names of their columns."""
    cells = [f"{value:.4g}" if isinstance(value, float) else str(value) for value in values]
    aligned = [f"{cell:>{max(len(name), 8)}}" for name, cell in zip(columns, cells, strict=True)]
    return "  ".join([f"{cells[0]:36}", *aligned[1:]])


def save(path: Path | None, **tables: list[Row]) -> dict[str, Any]:
    """Return the tables with the device and its peak of memory in GB; write them to a file."""
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    device = jax.devices()[0]
    peak = (device.memory_stats() or {}).get("peak_bytes_in_use", resident)
    result = {"device": device.device_kind, "peak_gb": peak / 1e9, **tables}
    print(f"\n{result['device']}, peak of memory {result['peak_gb']:.2f} GB")
    if path:
        write_json(path, result)
    return result
