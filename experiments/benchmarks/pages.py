"""Benchmark of pages: size, first paint, frames per second of explorers, replays and reports."""

import itertools
import json
from pathlib import Path
from typing import Annotated, Any

import tyro

from experiments.benchmarks.browser import opened
from qdenv.io.files import write_json
from qdenv.types import InputError

# Milliseconds from the start of loading: first paint, and all scripts done.
PAINT = """() => {
  const [paint] = performance.getEntriesByName("first-contentful-paint");
  const [load] = performance.getEntriesByType("navigation");
  return [paint ? paint.startTime : null, load.loadEventEnd];
}"""
# Times at which frames were drawn, for so many milliseconds.
FRAMES = """time => new Promise(done => {
  const drawn = [];
  const tick = now => {
    drawn.push(now);
    if (now - drawn[0] < time) requestAnimationFrame(tick); else done(drawn);
  };
  requestAnimationFrame(tick);
})"""


def run(
    pages: tyro.conf.Positional[tuple[Path, ...]],
    press: str = "",
    seconds: float = 5.0,
    width: int = 1280,
    height: int = 860,
    repeats: int = 3,
    json_file: Annotated[Path | None, tyro.conf.arg(name="json")] = None,
) -> list[dict[str, Any]]:
    """Open pages in headless Chromium and measure them.

    Args:
        pages: HTML files.
        press: a key to press before frames are counted, like Space to play a replay.
        seconds: over which frames are counted.
        width: of the window in pixels.
        height: of the window in pixels.
        repeats: the page is opened so often; the median counts.
        json_file: where to write the result.
    """
    for page in pages:
        if not page.is_file():
            raise InputError(f"{page}: no such file")
    rows = []
    for page in pages:
        tries = sorted(
            (measure(page, press, seconds, (width, height)) for _ in range(repeats)),
            key=lambda one: one["first_paint_ms"] or 0,
        )
        rows.append(
            {"page": str(page), "megabytes": page.stat().st_size / 1e6} | tries[repeats // 2]
        )
    print(json.dumps(rows, indent=1))
    if json_file:
        write_json(json_file, rows)
    return rows


def measure(page: Path, press: str, seconds: float, window: tuple[int, int]) -> dict[str, Any]:
    """Open a page once.

    Returns:
        first_paint_ms and loaded_ms since the start of loading, frames_per_second, slowest_frame_ms
        while the key that was pressed has its effect, complaints of the console.
    """
    with opened(page, *window) as (shown, complaints):
        shown.wait_for_load_state("load")
        shown.wait_for_timeout(500)  # the paint is reported after it
        paint, loaded = shown.evaluate(PAINT)
        if press:
            shown.keyboard.press(press)
        drawn = shown.evaluate(FRAMES, 1000 * seconds)
    gaps = [after - before for before, after in itertools.pairwise(drawn)]
    return {
        "first_paint_ms": paint,
        "loaded_ms": loaded,
        "frames_per_second": 1000 * len(gaps) / sum(gaps),
        "slowest_frame_ms": max(gaps),
        "complaints": complaints,
    }
