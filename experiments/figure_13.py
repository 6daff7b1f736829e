"""Figure 13: a factory of size S_eval, as it was grown and repaired."""

from experiments.layouts import S_EVAL, SavedLayout
from experiments.panels import Panel, panels_of

PANELS = (
    Panel("as it was grown", SavedLayout("manufacturing", "nca", S_EVAL), unrepaired=True),
    Panel("repaired", SavedLayout("manufacturing", "nca", S_EVAL)),
)
EXPERIMENT = panels_of("a grown factory of size S_eval", PANELS)
