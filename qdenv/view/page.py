"""One self-contained HTML page: a template, scripts, facts and packed arrays in a single file.

A page opens from a disk and inside of a notebook, without any network. Large arrays travel as gzip
in base64; `scripts/page.js` unpacks them when they are first needed.
"""

from __future__ import annotations

import base64
import gzip
import html
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.io.files import tidy, write_atomically
from qdenv.stats import margin
from qdenv.study.table import Row
from qdenv.types import require_package


def listed(values: Sequence[Any]) -> str:
    """Write a list in a sentence: "a, b and c"."""
    words = [str(value) for value in values]
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _interval(row: Row, digits: int) -> str:
    """Write the 95 % interval of a row's mean throughput; "" for one run."""
    half = margin(row.sample_of_all)
    if np.isnan(half):
        return ""
    return f"{max(row.mean_of_all - half, 0.0):.{digits}f} to {row.mean_of_all + half:.{digits}f}"


# How templates write numbers and lists.
_FILTERS: dict[str, Callable[..., Any]] = {
    "listed": listed,
    "fixed": lambda value, digits=0: f"{value:,.{digits}f}",
    "percent": lambda value, digits=0: f"{value:.{digits}%}",
    "interval": _interval,
    "percent_range": lambda apart: f"{apart.low:+.1f} to {apart.high:+.1f} %",  # of a `Difference`
}


@dataclass(frozen=True, repr=False)
class Page:
    """A page that saves and shows itself."""

    title: str  # of the browser's window
    html: str  # the whole document
    facts: Mapping[str, Any] = field(default_factory=dict)  # as `--json` writes them

    def save(self, path: str | Path) -> Path:
        """Write the page as one file at `path`, which is returned.

        Raises InputError if the place cannot be written to.
        """
        write_atomically(Path(path), self.html.encode())
        return Path(path)

    def __repr__(self) -> str:
        """Show the title and the size."""
        return f"Page({self.title!r}, {len(self.html.encode()) / 1e6:.1f} MB)"

    def _repr_html_(self) -> str:
        """Show the page in a frame, so that its style and the notebook's do not mix."""
        style = "width:100%;height:760px;border:0"
        return f'<iframe srcdoc="{html.escape(self.html)}" style="{style}"></iframe>'


def make_page(
    template: str,
    title: str,
    scripts: Sequence[str] = (),
    facts: Mapping[str, Any] | None = None,
    packed: Mapping[str, np.ndarray | bytes | str] | None = None,
    **content: Any,
) -> Page:
    """Fill a template, named without its ending as the scripts are, with the variables `content`.

    Scripts read ``facts``, which are JSON-ready values, or numpy's, and await ``unpack(name)`` of
    the packed arrays, bytes, or texts that `pack` returned. Raises InputError if jinja2 is not
    installed.
    """
    require_package("pages", "jinja2")
    import jinja2
    from markupsafe import Markup

    home = resources.files("qdenv.view")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(str(home / "templates")),
        # Names of layouts and messages are text, whatever they contain.
        autoescape=True,
        # A misspelt variable is an error, not an empty sentence.
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(_FILTERS, one_line=lambda text: Markup(" ".join(text.split())))
    environment.tests["nan"] = math.isnan
    whole = environment.get_template(f"{template}.html").render(
        title=title,
        style=(home / "templates" / "page.css").read_text(),
        scripts=[(home / "scripts" / f"{name}.js").read_text() for name in ("page", *scripts)],
        facts=tidy(facts or {}),
        packed={name: pack(values) for name, values in (packed or {}).items()},
        **content,
    )
    return Page(title, whole, facts or {})


def pack(content: np.ndarray | bytes | str) -> str:
    """Turn bytes or an array (row-major, in its own byte order) into gzip in base64.

    Text is packed already, and returned as it is.
    """
    if isinstance(content, str):
        return content
    raw = content if isinstance(content, bytes) else np.ascontiguousarray(content).tobytes()
    # The highest level, because pages are written once and sent around; no time, so that the same
    # content always gives the same page.
    return base64.b64encode(gzip.compress(raw, 9, mtime=0)).decode()
