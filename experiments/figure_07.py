"""Figure 7: example layouts of all domains at size S, grown and repaired."""

from experiments.layouts import MAZE_S, SavedLayout
from experiments.panels import Panel, panels_of

PANELS = (
    Panel("warehouse", SavedLayout("warehouse-even", "nca")),
    Panel("manufacturing", SavedLayout("manufacturing", "nca")),
    Panel("maze", SavedLayout("maze-walls", "nca", MAZE_S)),
)
EXPERIMENT = panels_of("example layouts of size S", PANELS)
