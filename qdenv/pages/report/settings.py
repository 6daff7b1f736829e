"""The end of a report: settings and versions, and the command that makes it again."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version

from qdenv import devices
from qdenv.pages.report.blocks import Section, Table, Text

PACKAGES = ("qdenv", "jax", "numpy", "numba", "highspy", "matplotlib")


def made_line() -> str:
    """Say who made the page, and when."""
    return f"Made by qdenv {version('qdenv')} on {datetime.now():%d %B %Y}"


def settings_section(settings: Mapping[str, str], again: str) -> Section:
    """List all that decides the numbers.

    Args:
        settings: in words, by their names.
        again: the command line that makes the page again; "" where there is none.
    """
    rows: Sequence[tuple[str, str]] = [*settings.items(), *versions().items()]
    blocks: list[Text | Table] = [Table(("setting", "value"), rows, "settings")]
    if again:
        blocks.append(Text(f"The same again: {again}", "faint"))
    return Section("Settings and versions", blocks)


def versions() -> dict[str, str]:
    """List what computed the numbers."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    machine = f"{platform.system()} on {platform.machine()}, {devices.threads()} threads"
    return {**found, "Python": platform.python_version(), "machine": machine}
