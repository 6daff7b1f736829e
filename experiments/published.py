"""What the paper found, to be printed beside what we find; from its tables and its text."""

from typing import NamedTuple


class Found(NamedTuple):
    """A row of Table 4, over 5 runs.

    Attributes:
        qd_score: mean.
        qd_error: its standard error; NaN where it is not known.
        coverage: mean share of filled cells; NaN where it is not known.
    """

    qd_score: float
    qd_error: float
    coverage: float

    def __str__(self) -> str:
        """Write it as tables do."""
        return f"{self.qd_score:,.0f} ± {self.qd_error:,.0f}, {self.coverage:.2f}"


# By domain and algorithm: mean QD-score, its standard error, mean coverage. alpha = 5.
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
