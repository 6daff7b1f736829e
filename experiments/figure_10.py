"""Figure 10: warehouses of size S: designed by hand, and grown with three alphas."""

from experiments.layouts import SavedLayout
from experiments.panels import Panel, panels_of

PANELS = (
    Panel("designed by hand", SavedLayout("warehouse-even", "human")),
    Panel("even, alpha = 0", SavedLayout("warehouse-even", "a0")),
    Panel("even, alpha = 1", SavedLayout("warehouse-even", "a1")),
    Panel("even, alpha = 5", SavedLayout("warehouse-even", "nca")),
    Panel("uneven, alpha = 0", SavedLayout("warehouse-uneven", "a0")),
    Panel("uneven, alpha = 1", SavedLayout("warehouse-uneven", "a1")),
    Panel("uneven, alpha = 5", SavedLayout("warehouse-uneven", "nca")),
)
EXPERIMENT = panels_of("warehouses of size S", PANELS)
