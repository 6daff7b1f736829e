"""A headless browser that opens a page from disk, offline, as the people who are sent one do."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from qdenv.types import InputError

if TYPE_CHECKING:
    from playwright.sync_api import Page

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


def find_browser() -> str | None:
    """Find a Chromium on this machine."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def opened(path: Path, width: int, height: int) -> "Iterator[tuple[Page, list[str]]]":
    """Open a page.

    Args:
        path: of the file.
        width: of the window in pixels.
        height: of the window in pixels.

    Returns:
        the page as Playwright knows it, and the list of what it complains about: errors, every
        word on the console, whatever it asks a network for. The list grows while it is open.

    Raises:
        InputError: there is no browser, or nothing to drive it with.
    """
    program = find_browser()
    if program is None:
        raise InputError("no Chromium on this machine (Debian: apt install chromium)")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise InputError("browsers need playwright: pip install playwright") from error
    complaints: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        context = browser.new_context(
            viewport={"width": width, "height": height}, offline=True, accept_downloads=True
        )
        page = context.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda said: complaints.append(f"{said.type}: {said.text}"))
        page.on("requestfailed", lambda asked: complaints.append(f"asked for {asked.url[:80]}"))
        page.goto(path.resolve().as_uri())
        yield page, complaints
        browser.close()
