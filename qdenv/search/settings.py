"""The settings of the search algorithms: what a user may choose."""

import math
from dataclasses import dataclass, field, replace
from typing import Annotated, ClassVar, Literal

from annotated_types import Interval

from qdenv.ranges import (
    OPEN,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    Ranged,
    Share,
    check_range,
)
from qdenv.surrogates.settings import PUBLISHED, SurrogateConfig
from qdenv.types import InputError

# Names of `strategies.STRATEGIES`, which a user may add to, of `cma_mae.RANKERS` and of
# `cma_mae.SELECTIONS`, repeated so that a command line has them without importing jax.
StrategyName = Annotated[Literal[
    "iso", "sep", "full", "lm_ma",
    "CMA_ES", "CR_FM_NES", "DiscoveredES", "Open_ES", "PGPE", "SimpleES", "SNES",
], OPEN]  # fmt: skip
Ranker = Annotated[Literal["imp", "2imp", "obj", "2obj"], OPEN]
Selection = Annotated[Literal["mu", "filter"], OPEN]

# Strategies of evosax that would run and mislead (read and measured with evosax 0.3.2).
_REMEMBERS = "it compares fitness across generations, which ranks do not allow"
UNSOUND = {
    "ASEBO": "it multiplies matrices of all parameters; use Open_ES",
    "GradientlessDescent": f"{_REMEMBERS}; use iso",
    "GuidedES": "it needs gradients, a simulation has none; use Open_ES",
    "HillClimbing": f"{_REMEMBERS}; use iso",
    "iAMaLGaM_Full": f"{_REMEMBERS}; use full",
    "iAMaLGaM_Univariate": f"{_REMEMBERS}; use sep",
    "LM_MA_ES": "its matrix update ignores the ranking; use lm_ma",
    "MA_ES": "its rank-mu update ignores the ranking; use full",
    "Rm_ES": f"{_REMEMBERS}; use lm_ma",
    "Sep_CMA_ES": "it keeps the rates of the full matrix, so its diagonal hardly moves; use sep",
    "SimulatedAnnealing": f"{_REMEMBERS}; use iso",
    "xNES": "it exponentiates its matrix element by element; use SNES or full",
}


def check_strategy(name: str) -> None:
    """Raise InputError for a strategy of evosax that is known to be unsound, with the reason."""
    if name in UNSOUND:
        raise InputError(f"the evosax strategy {name} is not offered: {UNSOUND[name]}")


def check_rates(learning_rate: float, threshold_min: float) -> None:
    """Raise InputError for thresholds that are out of range or do not go together."""
    check_range("learning_rate", learning_rate, Share)
    if math.isnan(threshold_min) or threshold_min == math.inf:
        raise InputError(f"threshold_min must be a number or -inf, not {threshold_min}")
    if threshold_min == -math.inf and learning_rate != 1:
        raise InputError("threshold_min = -inf needs an archive learning rate of 1")


_Ahead = Annotated[int, Interval(ge=0, le=1000)]  # no cluster needs more than the upper limit


@dataclass(frozen=True)
class CmaMaeConfig(Ranged):
    """Settings of CMA-MAE; the defaults are the paper's for all but mazes (Table 1)."""

    emitters: PositiveInt = 5  # evolution strategies E running side by side
    batch: PositiveInt = 10  # solutions b of each emitter per iteration
    sigma0: PositiveFloat = 0.2  # initial step size
    learning_rate: Share = 0.01  # of the learning archive's thresholds, in [0, 1]
    threshold_min: float = 0.0  # threshold of an empty cell
    # sort rows by improvement (imp), status then improvement (2imp), objective (obj) or status then
    # objective (2obj)
    ranker: Ranker = "imp"
    # parents are the better half (mu) or as many as were accepted (filter)
    selection: Selection = "mu"
    # when nothing was accepted, never (basic), or every N iterations
    restart: Literal["no_improvement", "basic"] | PositiveInt = "no_improvement"
    # how each emitter adapts: isotropic (iso), separable (sep), the full matrix (full), its
    # limited-memory form (lm_ma), or one of evosax's
    strategy: StrategyName = "iso"
    # populations drawn before the scores of the previous one are known, for many workers: the
    # emitters become ahead + 1 groups that take turns
    ahead: _Ahead = 0

    def __post_init__(self) -> None:
        """Raise InputError for values that do not go together."""
        super().__post_init__()
        check_rates(self.learning_rate, self.threshold_min)
        check_strategy(self.strategy)


@dataclass(frozen=True)
class CmaMeConfig(CmaMaeConfig):
    """Settings of CMA-ME: CMA-MAE with an elitist archive (Fontaine et al. 2020)."""

    learning_rate: Share = 1.0
    threshold_min: float = -math.inf
    ranker: Ranker = "2imp"
    selection: Selection = "filter"


@dataclass(frozen=True)
class ScreenedConfig(CmaMaeConfig):
    """Settings of CMA-MAE whose offspring a surrogate screens."""

    screen: PositiveInt = 4  # offspring drawn for each that is evaluated; 1 screens nothing
    refit: PositiveInt = 1  # iterations from one fit of the surrogate to the next
    # its size, and how it learns
    surrogate: SurrogateConfig = field(default_factory=SurrogateConfig)

    def __post_init__(self) -> None:
        """Raise InputError for values that do not go together."""
        super().__post_init__()
        if self.ahead:
            raise InputError("cma-mae-screened draws no population ahead: leave ahead at 0")
        if self.strategy in ("lm_ma", "CR_FM_NES", "PGPE"):
            raise InputError(f"{self.strategy} learns from unevaluated draws, too: use iso")


@dataclass(frozen=True)
class MapElitesConfig(Ranged):
    """Settings of MAP-Elites."""

    emitters: PositiveInt = 5  # times `batch`, so that algorithms compare at equal settings
    batch: PositiveInt = 10  # an iteration makes ``emitters * batch`` solutions
    sigma_iso: PositiveFloat = 0.01  # standard deviation of the isotropic noise
    # standard deviation of the step along the line to another elite
    sigma_line: NonNegativeFloat = 0.2
    # of the parents' archive. 1 with a `threshold_min` of -inf is the plain elitist archive; the
    # published runs drew their parents from the soft archive of CMA-MAE (0.01 and 0).
    learning_rate: Share = 1.0
    threshold_min: float = -math.inf  # threshold of an empty cell of the parents' archive
    # populations drawn before the scores of the previous one are known, for many workers
    ahead: _Ahead = 0

    def __post_init__(self) -> None:
        """Raise InputError for values that do not go together."""
        super().__post_init__()
        check_rates(self.learning_rate, self.threshold_min)


@dataclass(frozen=True)
class CmaEsConfig(Ranged):
    """Settings of the single-objective search.

    The default strategy, `iso`, is what CMA-ES is at the size of a layout's generator, at linear
    cost: by pyribs' rule (`refresh_gap`) the covariance matrix is first decomposed after the
    paper's budget of evaluations (of fleets, with kernels (3, 3, 3)).
    """

    emitters: PositiveInt = 1  # independent evolution strategies
    batch: PositiveInt = 50  # solutions of each strategy per iteration
    sigma0: PositiveFloat = 0.2  # initial step size
    # never (basic), when no cell improved, or every N iterations. A strategy whose
    # distribution is degenerate restarts anyway, from a random elite.
    restart: Literal["no_improvement", "basic"] | PositiveInt = "basic"
    # how each emitter adapts: isotropic (iso), separable (sep), the full matrix (full), its
    # limited-memory form (lm_ma), or one of evosax's, of which CMA_ES decomposes its full matrix at
    # every step: for some hundreds of parameters at most
    strategy: StrategyName = "iso"
    # populations drawn before the scores of the previous one are known, for many workers: the
    # emitters become ahead + 1 groups that take turns
    ahead: _Ahead = 0

    def __post_init__(self) -> None:
        """Raise InputError for values that do not go together."""
        super().__post_init__()
        check_strategy(self.strategy)


@dataclass(frozen=True)
class RandomSearchConfig(Ranged):
    """Settings of random search."""

    batch: PositiveInt = 50  # solutions per iteration
    sigma: PositiveFloat = 0.2  # standard deviation of every parameter
    # populations drawn before the scores of the previous one are known, for many workers
    ahead: _Ahead = 0


@dataclass(frozen=True)
class RearrangeConfig(Ranged):
    """Settings of the evolution of a plan, parts of which are moved."""

    encoding: ClassVar[str] = "direct"  # the generator that it searches

    population: PositiveInt = 8  # layouts that are evaluated again in each iteration
    batch: PositiveInt = 32  # layouts per iteration, those among them
    shifts: Share = 0.5  # of the changes, those that move the tiles of a rectangle on
    copies: Share = 0.25  # those that draw a rectangle once more; the others exchange two cells

    def __post_init__(self) -> None:
        """Raise InputError for values that do not go together."""
        super().__post_init__()
        if (both := self.shifts + self.copies) > 1 + 1e-9:  # 1 but for rounding
            raise InputError(f"shifts and copies are {both:g} of the changes: give 1 at most")


@dataclass(frozen=True)
class DsageConfig(Ranged):
    """Settings of DSAGE; the defaults suit a CPU, `DSAGE_PUBLISHED` is the paper's."""

    encoding: ClassVar[str] = "direct"  # the generator that it searches

    batch: PositiveInt = 50  # true evaluations per iteration
    # random solutions that are evaluated first, rounded up to whole iterations
    initial: PositiveInt = 100
    inner_iterations: PositiveInt = 500  # of MAP-Elites on the surrogate, each time it has learnt
    inner_batch: PositiveInt = 50  # solutions of each of these iterations
    inner_random: PositiveInt = 2  # number of them, at first, that draw random solutions
    # tiles that a mutation draws again; 0 draws their number, 2 on average
    mutations: NonNegativeInt = 0
    # blocks of the archive along each measure, from each of which one elite of the inner loop is
    # evaluated truly; by default half, then a quarter of the cells
    downsample: tuple[PositiveInt, ...] = ()
    # its size, and how it learns
    surrogate: SurrogateConfig = field(default_factory=SurrogateConfig)


DSAGE_PUBLISHED = DsageConfig(
    inner_iterations=10_000,
    downsample=(50, 25),
    # The published loss; the result objective is ours and weighs like the objective.
    surrogate=replace(PUBLISHED, standardise=False, weights=(1.0, 1.0, 1.0, 10.0)),
)
