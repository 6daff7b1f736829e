"""Figure 6: how an automaton grows a warehouse from the seed block in 50 steps."""

from experiments.layouts import SavedGrowth
from experiments.pieces import Drawn, Experiment, Folders
from qdenv.plots.layouts import draw_frames

GROWTH = SavedGrowth("warehouse-even")


def draw(folders: Folders) -> Drawn:
    """Draw the frames side by side."""
    steps, frames, domain = GROWTH.read(folders)
    return Drawn(draw_frames(frames, steps, domain.tiles))


EXPERIMENT = Experiment("growth of a warehouse", (GROWTH,), draw)
