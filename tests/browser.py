"""A headless browser for tests of pages: what it shows, what it complains about."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from experiments.benchmarks.pages import find_browser, open_page


@contextmanager
def opened(path: Path, width: int = 1280, height: int = 860, ready: str = "true") -> Iterator[Any]:
    """Open a page from disk, offline; a word on its console or a request fails the test.

    Gives a page of Playwright, once `ready` holds; skips the test where no browser is.
    """
    if find_browser() is None:
        pytest.skip("no Chromium on this machine (Debian: apt install chromium)")
    with open_page(path, width, height) as (page, complaints):
        page.wait_for_function(ready)
        yield page
    assert not complaints, complaints
