"""Saved layouts: grown by an elite, drawn as people do, or tiled; with what the repair changed."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.pieces import Folders, Piece, Say
from experiments.runs import SavedRun
from qdenv.domains.base import Domain, find_domain
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

    @property
    def refused(self) -> str:
        """Why no repair was found, and it cannot be simulated therefore; "" where there was one."""
        return str(self.facts.get("refused", ""))


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

    @property
    def needs(self) -> tuple[Piece, ...]:
        """The run whose elite draws it, or the layout that is tiled."""
        if self.maker == "tiled":
            return (SavedLayout(self.domain, "nca", S),)
        return () if self.maker in ("human", "nca") else (self.run(),)

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
        """Estimate the CPU seconds of making it."""
        if self.done(folders):
            return 0.0
        return 0.0 if self.maker == "human" else SECONDS.get(self.shape, 40.0)

    def make(self, folders: Folders, say: Say) -> None:
        """Grow, draw or tile it, repair it, and write it with what it was before.

        Where no repair is found the file says so, and holds what could not be repaired.
        """
        say(f"{self.stem}: is being made")
        grown, config, seed = self._draw(folders, say)
        try:
            made = sizes.finish(grown, config, seed)
        except InputError as error:
            say(f"{self.stem}: {error}")
            made = sizes.Sized(grown.layout, grown.steps, {}, "failed", 0, 0.0)
            facts = sizes.details(made) | {"refused": str(error)}
        else:
            facts = sizes.details(made)
        write_layout(
            self.path(folders),
            made.layout,
            grown.domain.tiles,
            domain=self.domain,
            maker=self.maker,
            **facts,
            unrepaired=draw(grown.layout, grown.domain.tiles),
        )

    def _draw(self, folders: Folders, say: Say) -> tuple[Grown, RepairConfig, int]:
        """Make the unrepaired layout, and say with which limits and seed to repair it."""
        domain = find_domain(self.domain).resized(*self.shape)
        if self.maker == "human":
            # People obey the rules: nothing is repaired.
            layout = sizes.human_layout(domain)
            return Grown(replace(domain, rules=None), None, layout, 0), RepairConfig(), 0
        if self.maker == "tiled":
            small = SavedLayout(self.domain, "nca", S).read(folders)
            layout = sizes.tile_layout(domain, small.layout)
            return Grown(domain, None, layout, 0), RepairConfig(), 0
        if self.maker == "nca":
            run = RunDirectory.open(f"zoo:{self.domain}/best")
        else:
            run = self.run().whole(folders, say)
        return (
            grow_elite(run, "best", self.shape),
            run.config.evaluation.repair,
            run.config.seed,
        )

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


def draw_panels(panels: Sequence[Panel], folders: Folders) -> Figure:
    """Draw those layouts that are saved side by side; the others leave a note."""
    columns = min(COLUMNS, len(panels))
    rows = -(-len(panels) // columns)
    figure = new_figure(4.2 * columns, 4.4 * rows, dpi=100)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for place, panel in zip(axes, panels, strict=False):
        if not panel.saved.done(folders):
            place.text(0.5, 0.5, f"{panel.saved.stem}\nnot made yet", ha="center", va="center")
            place.set_axis_off()
            continue
        made = panel.saved.read(folders)
        shown = made.unrepaired if panel.unrepaired else made.layout
        draw_layout(shown, made.domain.tiles, place, made.domain.names)
        place.set_title(panel.title, fontsize="small")
    for place in axes[len(panels) :]:
        place.remove()
    return figure
