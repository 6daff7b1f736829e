"""Figure 15: random mazes of size S_eval with about as long a way as a grown one, beside that."""

from experiments.layouts import MAZE_S_EVAL, SavedLayout
from experiments.panels import Panel, panels_of

PANELS = (
    Panel("grown", SavedLayout("maze-walls", "nca", MAZE_S_EVAL)),
    Panel("random", SavedLayout("maze-walls", "random-0", MAZE_S_EVAL)),
    Panel("random", SavedLayout("maze-walls", "random-1", MAZE_S_EVAL)),
)
EXPERIMENT = panels_of("random mazes like a grown one", PANELS)
