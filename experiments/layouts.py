"""Saved layouts: grown by an elite, drawn as people do, or tiled; with what the repair changed."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.archives import note
from experiments.pieces import Drawn, Experiment, Folders, Say, table
from experiments.runs import SavedRun
from qdenv.domains.base import Domain, find_domain
from qdenv.files import write_json
from qdenv.formats.layouts import write_layout
from qdenv.grid import draw, parse
from qdenv.plots.figure import new_figure
from qdenv.plots.layouts import draw_layout
from qdenv.repair.settings import RepairConfig
from qdenv.study import sizes
from qdenv.study.elites import Grown, grow_elite
from qdenv.training.records import RunDirectory
from qdenv.types import InputError

S, S_EVAL = (33, 36), (101, 102)
MAZE_S, MAZE_S_EVAL = (18, 18), (66, 66)
COLUMNS = 3  # panels side by side
SECONDS = {S: 10.0, S_EVAL: 90.0}  # CPU seconds of growing and repairing


class Made(NamedTuple):
    """A saved layout.

    Attributes:
        layout: int8 [H, W], as it is simulated.
        unrepaired: int8 [H, W], as it was grown or tiled; the same where nothing was repaired.
        domain: at its size.
        facts: what its file says else: steps, cells changed, CPU seconds of growth and repair.
    """

    layout: np.ndarray
    unrepaired: np.ndarray
    domain: Domain
    facts: dict


class SavedLayout(NamedTuple):
    """A layout of one domain, maker and size.

    Attributes:
        domain: its name.
        maker: "human", "tiled", "nca" (the zoo's best), or the end of a preset's name: "a0",
            "a1", "cma-es", "dsage", whose run's best elite draws it.
        shape: rows and columns.
    """

    domain: str
    maker: str
    shape: tuple[int, int] = S

    @property
    def stem(self) -> str:
        """Name of its file, and of its rows in tables."""
        return "{}-{}-{}x{}".format(self.domain, self.maker, *self.shape)

    @property
    def name(self) -> str:
        """How lists call it."""
        return f"layout {self.stem}"

    def path(self, folders: Folders) -> Path:
        """Find its file."""
        return folders.results / "layouts" / f"{self.stem}.json"

    def done(self, folders: Folders) -> float:
        """Say whether it is saved."""
        return float(self.path(folders).exists())

    def run(self) -> SavedRun:
        """Name the run whose best elite draws it."""
        return SavedRun(f"{self.domain}-{self.maker}")

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds of making it, its run included."""
        if self.done(folders):
            return 0.0
        own = 0.0 if self.maker == "human" else SECONDS.get(self.shape, 40.0)
        searched = self.maker not in ("human", "tiled", "nca")
        return own + (self.run().cost(folders) if searched else 0.0)

    def make(self, folders: Folders, say: Say) -> None:
        """Grow, draw or tile it, repair it, and write it with what it was before."""
        say(f"{self.stem}: is being made")
        before, made = self._create(folders, say)
        domain = find_domain(self.domain)
        write_layout(
            self.path(folders),
            made.layout,
            domain.tiles,
            domain=self.domain,
            maker=self.maker,
            **{name: value for name, value in sizes.details(made).items() if name != "domain"},
            unrepaired=draw(before, domain.tiles),
        )

    def _create(self, folders: Folders, say: Say) -> tuple[np.ndarray, sizes.Sized]:
        domain = find_domain(self.domain).resized(*self.shape)
        if self.maker == "human":
            layout = sizes.human_layout(domain)
            numbers = domain.fitted(layout).numbers
            return layout, sizes.Sized(layout, 0, numbers, "none", 0, 0.0)
        if self.maker == "tiled":
            small = SavedLayout(self.domain, "nca", S)
            if not small.done(folders):
                small.make(folders, say)
            layout = sizes.tile_layout(domain, small.read(folders).layout)
            return layout, sizes.finish(Grown(domain, None, layout, 0), RepairConfig(), 0)
        if self.maker == "nca":
            run = RunDirectory.open(f"zoo:{self.domain}/best")
        else:
            run = self.run().whole(folders, say)
        grown = grow_elite(run, "best", self.shape)
        return grown.layout, sizes.finish(grown, run.config.evaluation.repair, run.config.seed)

    def read(self, folders: Folders) -> Made:
        """Read it.

        Raises:
            InputError: it is not saved.
        """
        try:
            content = json.loads(self.path(folders).read_text())
        except OSError as error:
            raise InputError(f"{self.path(folders)}: not saved yet") from error
        domain = find_domain(self.domain).resized(*self.shape)
        layout, unrepaired = (
            parse(content.pop(key), domain.tiles) for key in ("layout", "unrepaired")
        )
        return Made(layout, unrepaired, domain.fitted(layout), content)


class SavedGrowth(NamedTuple):
    """How an automaton of the zoo grows a layout of its trained size.

    Attributes:
        domain: whose best generator.
        every: steps from one frame to the next.
    """

    domain: str
    every: int = 10

    @property
    def name(self) -> str:
        """How lists call it."""
        return f"growth of {self.domain}"

    def path(self, folders: Folders) -> Path:
        """Find its file."""
        return folders.results / "layouts" / f"{self.domain}-growth.json"

    def done(self, folders: Folders) -> float:
        """Say whether it is saved."""
        return float(self.path(folders).exists())

    def cost(self, folders: Folders) -> float:
        """Estimate the CPU seconds of growing once more."""
        return 0.0 if self.done(folders) else 10.0

    def make(self, folders: Folders, say: Say) -> None:
        """Grow it and keep the frames."""
        run = RunDirectory.open(f"zoo:{self.domain}/best")
        grown = grow_elite(run, "best")
        steps, frames = sizes.grow_frames(run, grown, self.every)
        tiles = grown.domain.tiles
        drawn = [draw(frame, tiles) for frame in frames]
        write_json(self.path(folders), {"steps": steps, "frames": drawn})

    def read(self, folders: Folders) -> tuple[list[int], list[np.ndarray], Domain]:
        """Read the numbers of steps, the frames (int8 [H, W]) and their domain."""
        content, domain = json.loads(self.path(folders).read_text()), find_domain(self.domain)
        return content["steps"], [parse(one, domain.tiles) for one in content["frames"]], domain


class Panel(NamedTuple):
    """One layout of a figure.

    Attributes:
        title: above it.
        saved: which.
        unrepaired: show what it was before its repair.
    """

    title: str
    saved: SavedLayout
    unrepaired: bool = False


def panels_of(shows: str, panels: Sequence[Panel]) -> Experiment:
    """Make an experiment that shows layouts side by side, and says what the repair changed."""

    def draw_all(folders: Folders) -> Drawn:
        rows = []
        for saved in dict.fromkeys(panel.saved for panel in panels if panel.saved.done(folders)):
            made = saved.read(folders)
            size, steps = "{} x {}".format(*made.layout.shape), made.facts["steps"] or ""
            share = f"{made.facts['changed'] / made.layout.size:.1%}" if steps else ""
            rows.append((saved.domain, saved.maker, size, steps, made.facts["changed"], share))
        head = ("domain", "maker", "size", "steps of growth", "cells the repair changed", "share")
        return Drawn(draw_panels(panels, folders), table(head, rows))

    pieces = tuple(dict.fromkeys(panel.saved for panel in panels))
    return Experiment(shows, pieces, draw_all)


def draw_panels(panels: Sequence[Panel], folders: Folders) -> Figure:
    """Draw those layouts that are saved side by side; the others leave a note."""
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(4.2 * columns, 4.4 * rows, dpi=100)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, panel in zip(axes, panels, strict=False):
        if not panel.saved.done(folders):
            note(place, f"{panel.saved.stem}\nnot made yet")
            continue
        made = panel.saved.read(folders)
        shown = made.unrepaired if panel.unrepaired else made.layout
        draw_layout(shown, made.domain.tiles, place, made.domain.names)
        place.set_title(panel.title, fontsize="small")
    for place in axes[len(panels) :]:
        place.remove()
    return figure
