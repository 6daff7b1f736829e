"""Figure 11: factories of size S: designed by hand, grown and repaired, and as they were grown."""

from experiments.layouts import SavedLayout
from experiments.panels import Panel, panels_of

PANELS = (
    Panel("designed by hand", SavedLayout("manufacturing", "human")),
    Panel("grown and repaired", SavedLayout("manufacturing", "nca")),
    Panel("as it was grown", SavedLayout("manufacturing", "nca"), unrepaired=True),
)
EXPERIMENT = panels_of("factories of size S", PANELS)
