"""Figure 12: grown warehouses of size S_eval, for three alphas."""

from experiments.layouts import S_EVAL, SavedLayout
from experiments.panels import Panel, panels_of

PANELS = (
    Panel("even, alpha = 0", SavedLayout("warehouse-even", "a0", S_EVAL)),
    Panel("even, alpha = 1", SavedLayout("warehouse-even", "a1", S_EVAL)),
    Panel("even, alpha = 5", SavedLayout("warehouse-even", "nca", S_EVAL)),
    Panel("uneven, alpha = 0", SavedLayout("warehouse-uneven", "a0", S_EVAL)),
    Panel("uneven, alpha = 1", SavedLayout("warehouse-uneven", "a1", S_EVAL)),
    Panel("uneven, alpha = 5", SavedLayout("warehouse-uneven", "nca", S_EVAL)),
)
EXPERIMENT = panels_of("grown warehouses of size S_eval", PANELS)
