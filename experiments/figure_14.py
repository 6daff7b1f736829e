"""Figure 14: a warehouse and a factory of size S_eval as people design them."""

from experiments.layouts import S_EVAL, SavedLayout
from experiments.panels import Panel, panels_of

PANELS = (
    Panel("warehouse", SavedLayout("warehouse-even", "human", S_EVAL)),
    Panel("factory", SavedLayout("manufacturing", "human", S_EVAL)),
)
EXPERIMENT = panels_of("layouts designed by hand, of size S_eval", PANELS)
