"""Benchmark of pages in a headless browser: size, first paint, frames per second."""

import itertools
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

import qdenv
from experiments.benchmarks.common import Row, save, show
from qdenv.ranges import PositiveInt

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
# Milliseconds from the start of loading: first paint, and all scripts done.
PAINT = """() => {
  const [paint] = performance.getEntriesByName("first-contentful-paint");
  const [load] = performance.getEntriesByType("navigation");
  return [paint ? paint.startTime : null, load.loadEventEnd];
}"""
# Times at which frames were drawn during that many milliseconds.
FRAMES = """time => new Promise(done => {
  const drawn = [];
  const tick = now => {
    drawn.push(now);
    if (now - drawn[0] < time) requestAnimationFrame(tick); else done(drawn);
  };
  requestAnimationFrame(tick);
})"""


def pages(
    files: tyro.conf.Positional[tuple[Path, ...]],
    press: str = "",
    seconds: float = 5.0,
    width: int = 1280,
    height: int = 860,
    repeats: PositiveInt = 3,
    json: Path | None = None,
) -> Row:
    """Open pages in headless Chromium and measure them.

    Args:
        files: HTML files.
        press: a key to press before frames are counted, like Space to play a replay.
        seconds: over which frames are counted.
        width: of the window in pixels.
        height: of the window in pixels.
        repeats: number of times a page is opened; the median first paint is reported.
        json: file of the result.
    """
    for file in files:
        if not file.is_file():
            raise qdenv.InputError(f"{file}: no such file")

    def measure(file: Path) -> Row:
        views = [view(file, press, seconds, width, height) for _ in range(repeats)]
        return sorted(views, key=lambda row: row["first_paint_ms"] or 0)[repeats // 2]

    return save(json, pages=show("pages", map(measure, files)))


def view(file: Path, press: str, seconds: float, width: int, height: int) -> Row:
    """Open a page once: a row of the table, with the messages of its console."""
    with start_browser() as browser, open_page(browser, file, width, height) as (page, complaints):
        page.wait_for_load_state("load")
        page.wait_for_timeout(500)  # the paint is reported after it
        paint, loaded = page.evaluate(PAINT)
        if press:
            page.keyboard.press(press)
        drawn = page.evaluate(FRAMES, 1000 * seconds)
    gaps = [after - before for before, after in itertools.pairwise(drawn)]
    return {
        "page": str(file),
        "megabytes": file.stat().st_size / 1e6,
        "first_paint_ms": paint,
        "loaded_ms": loaded,
        "frames_per_second": 1000 * len(gaps) / sum(gaps),
        "slowest_frame_ms": max(gaps),
        "complaints": complaints,
    }


def find_browser() -> str | None:
    """Return the path of a Chromium on this machine, or None."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


@contextmanager
def start_browser() -> "Iterator[Browser]":
    """Start a headless browser of Playwright's.

    Raises InputError if there is no browser, or playwright is not installed.
    """
    program = find_browser()
    if program is None:
        raise qdenv.InputError("no Chromium on this machine (Debian: apt install chromium)")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise qdenv.InputError("browsers need playwright: pip install playwright") from error
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        yield browser
        browser.close()


@contextmanager
def open_page(
    browser: "Browser", file: Path, width: int = 1280, height: int = 860
) -> "Iterator[tuple[Page, list[str]]]":
    """Open a page from disk in a browser, without a network.

    Yields Playwright's page, and a list of complaints that grows while it is open: errors,
    messages on the console, requests to a network. The size is that of the window in pixels.
    """
    complaints: list[str] = []
    context = browser.new_context(
        viewport={"width": width, "height": height}, offline=True, accept_downloads=True
    )
    page = context.new_page()
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(f"{message.type}: {message.text}"))
    page.on("requestfailed", lambda request: complaints.append(f"request: {request.url[:80]}"))
    page.goto(file.resolve().as_uri())
    yield page, complaints
    context.close()
