"""Figure 23: what CMA-ES' best automata grow at size S_eval, unrepaired."""

from experiments.layouts import S_EVAL, SavedLayout
from experiments.panels import Panel, panels_of

PANELS = (
    Panel("warehouse (even)", SavedLayout("warehouse-even", "cma-es", S_EVAL), unrepaired=True),
    Panel("manufacturing", SavedLayout("manufacturing", "cma-es", S_EVAL), unrepaired=True),
)
EXPERIMENT = panels_of("what CMA-ES' automata grow at size S_eval", PANELS)
