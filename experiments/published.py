"""What the paper found, to be printed beside what we find; from its tables and its text."""

from math import isnan, nan
from typing import NamedTuple

FLEETS = ("warehouse-even", "warehouse-uneven", "manufacturing")  # domains that fleets drive in
# N_a by domain and size; of the larger size as many as fit the throughputs.
AGENTS = {
    "warehouse-even": {(33, 36): 200, (101, 102): 1400},
    "warehouse-uneven": {(33, 36): 200, (101, 102): 1000},
    "manufacturing": {(33, 36): 200, (101, 102): 1800},
}


class Found(NamedTuple):
    """A row of Table 4, over 5 runs."""

    qd_score: float  # mean
    qd_error: float  # its standard error
    coverage: float  # mean share of filled cells

    def __str__(self) -> str:
        """Write it as tables do."""
        return f"{self.qd_score:,.0f} ± {self.qd_error:,.0f}, {self.coverage:.2f}"


# By domain and algorithm; alpha = 5.
TABLE_4 = {
    ("maze-walls", "cma-mae"): Found(22299.00, 612.46, 0.54),
    ("maze-walls", "dsage"): Found(16446.60, 42.27, 0.40),
    ("maze-walls", "map-elites"): Found(12446.80, 2207.08, 0.30),
    ("maze-entropy", "cma-mae"): Found(12468.20, 342.09, 0.77),
    ("maze-entropy", "dsage"): Found(1444.20, 52.60, 0.09),
    ("maze-entropy", "map-elites"): Found(9288.80, 590.13, 0.57),
    ("warehouse-even", "cma-mae"): Found(20366.07, 653.46, 0.33),
    ("warehouse-even", "dsage"): Found(914.60, 33.09, 0.02),
    ("warehouse-even", "map-elites"): Found(6893.49, 1291.68, 0.15),
    ("warehouse-uneven", "cma-mae"): Found(19985.23, 493.98, 0.33),
    ("warehouse-uneven", "dsage"): Found(926.69, 23.42, 0.02),
    ("warehouse-uneven", "map-elites"): Found(5906.86, 1027.29, 0.14),
    ("manufacturing", "cma-mae"): Found(6449.56, 1106.83, 0.18),
    ("manufacturing", "dsage"): Found(378.33, 4.69, 0.02),
    ("manufacturing", "map-elites"): Found(2398.99, 422.61, 0.14),
}


class Moved(NamedTuple):
    """What fleets made of a layout, over 50 or 20 runs of 5,000 timesteps."""

    # tasks per timestep, mean of the successful runs; NaN where none is given
    throughput: float = nan
    success: float = nan  # share of runs that never congested; NaN where it is not given
    words: str = ""  # what is said where there are no numbers

    def __str__(self) -> str:
        """Write it as tables do."""
        rate = "" if isnan(self.success) else f"{self.success:.0%}".replace("%", " %")
        if isnan(self.throughput):
            return self.words or rate
        return f"{self.throughput:.2f}" + (f" ({rate})" if rate else "")


# Tables 2 and 5 and section E.4 by domain, maker (see `layouts.SavedLayout`) and agents; alpha 0
# and 1 with 1,000 and 1,400 agents are of the authors' repository (its README, "Results").
TRAFFIC = {
    ("warehouse-even", "a0", 200): Moved(6.79),
    ("warehouse-even", "a1", 200): Moved(6.73),
    ("warehouse-even", "nca", 200): Moved(6.74, 1.0),
    ("warehouse-even", "cma-es", 200): Moved(6.51, 1.0),
    ("warehouse-even", "dsage", 200): Moved(6.35),
    ("warehouse-even", "human", 200): Moved(words="congests"),
    ("warehouse-uneven", "a0", 200): Moved(6.89),
    ("warehouse-uneven", "a1", 200): Moved(6.70),
    ("warehouse-uneven", "nca", 200): Moved(6.82, 1.0),
    ("warehouse-uneven", "cma-es", 200): Moved(6.62, 1.0),
    ("warehouse-uneven", "dsage", 200): Moved(6.40),
    ("warehouse-uneven", "human", 200): Moved(words="congests"),
    ("manufacturing", "nca", 200): Moved(6.82, 0.94),
    ("manufacturing", "cma-es", 200): Moved(6.81, 0.98),
    ("manufacturing", "dsage", 200): Moved(5.61),
    ("manufacturing", "human", 200): Moved(5.92),
    ("warehouse-even", "nca", 1400): Moved(16.01, 0.90),
    ("warehouse-even", "a0", 1400): Moved(words="N/A"),
    ("warehouse-even", "a1", 1400): Moved(words="N/A"),
    ("warehouse-even", "cma-es", 1400): Moved(words="N/A"),
    ("warehouse-even", "tiled", 1400): Moved(success=0.0),
    ("warehouse-uneven", "nca", 1000): Moved(12.03, 0.84),
    ("warehouse-uneven", "a0", 1000): Moved(12.32),
    ("warehouse-uneven", "a1", 1000): Moved(11.56),
    ("warehouse-uneven", "cma-es", 1000): Moved(success=0.0),
    ("warehouse-uneven", "tiled", 1000): Moved(success=0.23),
    ("manufacturing", "nca", 1800): Moved(23.11, 1.0),
    ("manufacturing", "cma-es", 1800): Moved(words="N/A"),
    ("manufacturing", "tiled", 1800): Moved(22.73, 1.0),
}

# Success of the maze agent by size: on the grown maze over 100 runs, on random mazes like it.
MAZES = {(66, 66): "93 %, 22.3 ± 3.0 %"}
