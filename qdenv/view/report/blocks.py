"""What a report is made of: sections of paragraphs, tables and figures, which a template sets."""

from __future__ import annotations

import io
import platform
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.metadata import version
from typing import NamedTuple

from matplotlib import rc_context
from matplotlib.figure import Figure

from qdenv import devices
from qdenv.run.manifest import package_versions
from qdenv.view.style import FONTS


class Text(NamedTuple):
    """A paragraph."""

    words: str  # of it
    kind: str = "plain"  # "plain", "answer" for what the reader came for, "faint" for a side note
    block: str = "text"


class Table(NamedTuple):
    """A table."""

    head: Sequence[str]  # names of the columns
    rows: Sequence[Sequence[str]]  # cells as they are read, at least one row
    name: str  # identifies it in the page
    block: str = "table"

    @property
    def numeric(self) -> list[bool]:
        """Tell for each column whether it holds numbers, which are set right."""
        columns = zip(*self.rows, strict=True)
        return [all(re.match(r"[-+]?\d|$", cell) for cell in column) for column in columns]


class Drawing(NamedTuple):
    """A figure."""

    svg: str  # drawing, inline
    caption: str  # below it
    name: str  # identifies it in the page
    half: bool = False  # two of its kind stand side by side where there is room
    block: str = "drawing"


class Section(NamedTuple):
    """A part of the report."""

    title: str  # its heading
    blocks: Sequence[Text | Table | Drawing]  # in order

    @property
    def lead(self) -> int:
        """Count the first blocks that stay with the heading on paper: up to a first large one."""
        count = 0
        for block in self.blocks:
            count += 1
            beside = isinstance(block, Drawing) and block.half
            if not (isinstance(block, Text) or beside):
                break
        return count


def drawing(
    figure: Figure, caption: str, name: str, half: bool = False, crop: bool = False
) -> Drawing:
    """Turn a figure into vector graphics for the page.

    Args:
        figure: what to draw.
        caption: below it; what it shows to who cannot see it, too.
        name: identifies it in the page, and all that it refers to inside itself.
        half: stands beside another one.
        crop: cut the picture to what is drawn.
    """
    content = io.StringIO()
    with rc_context(FONTS):
        box = "tight" if crop else None
        figure.savefig(content, format="svg", bbox_inches=box, metadata={"Date": None})
    svg = content.getvalue()
    svg = svg[svg.index("<svg") :]
    # Every figure of the page has names of its own for what is referred to within it.
    svg = re.sub(r'\bid="', f'id="{name}-', svg)
    svg = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", svg)
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    return Drawing(svg, caption, name, half)


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
    machine = f"{platform.system()} on {platform.machine()}, {devices.threads()} threads"
    return {**package_versions(PACKAGES), "Python": platform.python_version(), "machine": machine}
