"""One self-contained HTML page: a template, scripts, facts and packed arrays in a single file.

A page opens from a disk and inside of a notebook, and asks no network for anything. Large arrays
travel as gzip in base64; `scripts/page.js` unpacks them when they are first needed.
"""

from __future__ import annotations

import base64
import gzip
import html
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources, util
from pathlib import Path
from typing import Any

import numpy as np

from qdenv.io.files import tidy, write_atomically
from qdenv.stats import Sample, margin
from qdenv.study.table import Row
from qdenv.types import InputError

_HEIGHT = 760  # pixels of a page inside of a notebook
_LEVEL = 9  # of gzip: pages are written once and sent around


def _listed(values: Sequence[Any]) -> str:
    words = [str(value) for value in values]
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _interval(row: Row, digits: int) -> str:
    """Write the 95 % interval of a row's mean throughput; "" for one run."""
    half = margin(Sample(row.mean_of_all, row.error_of_all, row.runs))
    if np.isnan(half):
        return ""
    return f"{max(row.mean_of_all - half, 0.0):.{digits}f} to {row.mean_of_all + half:.{digits}f}"


# How templates write numbers and lists.
FILTERS: dict[str, Callable[..., Any]] = {
    "listed": _listed,  # a, b and c
    "fixed": lambda value, digits=0: f"{value:,.{digits}f}",
    "percent": lambda value, digits=0: f"{value:.{digits}%}",
    "interval": _interval,
    # of a `Difference`
    "percent_range": lambda apart: f"{apart.low:+.1f} to {apart.high:+.1f} %",
    # of a table: whether each holds numbers, which are set right
    "numeric_columns": lambda rows: [
        all(re.match(r"[-+]?\d|$", cell) for cell in column) for column in zip(*rows, strict=True)
    ],
}


@dataclass(frozen=True, repr=False)
class Page:
    """A page that saves and shows itself."""

    title: str  # of the browser's window
    html: str  # the whole document
    facts: Mapping[str, Any] = field(default_factory=dict)  # as `--json` writes them

    def save(self, path: str | Path) -> Path:
        """Write the page as one file.

        Raises:
            InputError: the place cannot be written to.
        """
        write_atomically(Path(path), self.html.encode())
        return Path(path)

    def __repr__(self) -> str:
        """Say what it shows and how large it is."""
        return f"Page({self.title!r}, {len(self.html.encode()) / 1e6:.1f} MB)"

    def _repr_html_(self) -> str:
        """Show it in a frame of its own, so that its style and the notebook's do not mix."""
        style = f"width:100%;height:{_HEIGHT}px;border:0"
        return f'<iframe srcdoc="{html.escape(self.html)}" style="{style}"></iframe>'


def make_page(
    template: str,
    title: str,
    scripts: Sequence[str] = (),
    facts: Mapping[str, Any] | None = None,
    packed: Mapping[str, np.ndarray | bytes | str] | None = None,
    **words: Any,
) -> Page:
    """Fill a template.

    Args:
        template: name of a file in `templates` without its ending; it extends ``page.html``.
        title: of the browser's window.
        scripts: names of files in `scripts` without their endings, in order, after ``page``.
        facts: JSON-ready values, or numpy's, see `files.tidy`; scripts read them as ``facts``.
        packed: arrays and bytes by name; scripts await ``unpack(name)``. Text is what `pack` made.
        **words: whatever the template itself asks for.

    Raises:
        InputError: jinja2 is not installed.
    """
    try:
        import jinja2
        from markupsafe import Markup
    except ImportError as error:
        raise missing("pages", "jinja2") from error
    home = resources.files("qdenv.view")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(str(home / "templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(FILTERS, one_line=lambda text: Markup(" ".join(text.split())))
    whole = environment.get_template(f"{template}.html").render(
        title=title,
        style=(home / "templates" / "page.css").read_text(),
        scripts=[(home / "scripts" / f"{name}.js").read_text() for name in ("page", *scripts)],
        facts=tidy(facts or {}),
        packed={name: pack(content) for name, content in (packed or {}).items()},
        **words,
    )
    return Page(title, whole)


def pack(content: np.ndarray | bytes | str) -> str:
    """Turn bytes or an array (row-major, in its own byte order) into gzip in base64.

    What is packed already stays as it is.
    """
    if isinstance(content, str):
        return content
    raw = content if isinstance(content, bytes) else np.ascontiguousarray(content).tobytes()
    return base64.b64encode(gzip.compress(raw, _LEVEL, mtime=0)).decode()


def demand(what: str, package: str) -> None:
    """Refuse before any work what a package of the extra `viz` is needed for.

    Args:
        what: in the plural, like "pages".
        package: as pip knows it.

    Raises:
        InputError: it is not installed.
    """
    if util.find_spec(package.replace("-", "_")) is None:
        raise missing(what, package)


def missing(what: str, package: str) -> InputError:
    """Say which package of the extra `viz` is needed for something."""
    return InputError(f"{what} need {package}: pip install 'qdenv[viz]'")
