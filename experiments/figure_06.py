"""Figure 6: how an automaton grows a warehouse from the seed block in 50 steps."""

import json
from dataclasses import dataclass

import numpy as np

from experiments.layouts import best_of, open_generator
from experiments.pieces import Drawn, Experiment, Folders, Piece
from qdenv.domains.base import Domain, find_domain
from qdenv.grid import draw as draw_rows
from qdenv.grid import parse
from qdenv.io.files import write_json
from qdenv.study.elites import grow_elite, grow_frames
from qdenv.view.layouts import draw_frames


@dataclass(frozen=True)
class SavedGrowth(Piece):
    """How an automaton of the first zoo grows a layout of its trained size."""

    kind = "growths"
    label = "growth of {0.domain}"
    file = "layouts/{0.domain}-growth.json"
    domain: str  # whose best generator

    def done(self, folders: Folders) -> float:
        """Return 1 if it is saved, and the generator is the one that drew it."""
        path = self.path(folders)
        origin = json.loads(path.read_text())["origin"] if path.exists() else ""
        return float(origin == best_of(self.domain))

    def seconds(self, folders: Folders) -> float:
        """Estimate the CPU seconds of growing once more."""
        return 10.0

    def make(self, folders: Folders) -> None:
        """Grow it and keep the frames."""
        run = open_generator(self.domain, "nca")
        grown = grow_elite(run, "best")
        steps, frames = grow_frames(run, grown, 10)
        drawn = [draw_rows(frame, grown.domain.tiles) for frame in frames]
        facts = {"origin": best_of(self.domain), "steps": steps, "frames": drawn}
        write_json(self.path(folders), facts)

    def read(self, folders: Folders) -> tuple[list[int], list[np.ndarray], Domain]:
        """Read the numbers of steps, the frames (int8 [H, W]) and their domain."""
        content, domain = json.loads(self.path(folders).read_text()), find_domain(self.domain)
        return content["steps"], [parse(one, domain.tiles) for one in content["frames"]], domain


GROWTH = SavedGrowth("warehouse-even")


def draw(folders: Folders) -> Drawn:
    """Draw the frames side by side."""
    steps, frames, domain = GROWTH.read(folders)
    return Drawn(draw_frames(frames, steps, domain.tiles))


EXPERIMENT = Experiment("growth of a warehouse", (GROWTH,), draw)
