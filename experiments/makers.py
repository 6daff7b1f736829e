"""What CMA-MAE's and CMA-ES's layouts move: the runs of Figure 22 and of Table 5."""

from itertools import product

from experiments.generators import most_at_s
from experiments.layouts import S_EVAL, S, SavedLayout
from experiments.published import AGENTS, FLEETS
from experiments.traffic import SavedTraffic
from qdenv.shipped import USUAL, names

MAKERS = ("cma-es", "nca")
SIZES = {S: "S", S_EVAL: "S_eval"}
# Of N_a: numbers of agents over which Figure 22 draws throughput.
SHARES = {S: (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0), S_EVAL: (0.4, 0.6, 0.8, 1.0, 1.2, 1.4)}
RUNS = 50
# A run at S_eval takes ten times as long or more; where nothing jams they differ by few per mille.
CURVE_RUNS = {S: RUNS, S_EVAL: 10}


def own_agents(domain: str, shape: tuple[int, int]) -> int:
    """Return the paper's number of agents, N_a."""
    return AGENTS[domain][list(SIZES).index(shape)]


def runs_at(
    domain: str,
    maker: str,
    shape: tuple[int, int],
    agents: int,
    planner: str = "high",
    runs: int = RUNS,
) -> SavedTraffic:
    """Return runs of 5,000 timesteps with one number of agents."""
    layout = SavedLayout(domain, maker, shape)
    return SavedTraffic(layout, f"makers-{domain}", (agents,), 5000, runs, planner)


def curve(domain: str, maker: str, shape: tuple[int, int]) -> tuple[SavedTraffic, ...]:
    """Return the runs of one curve: with N_a agents those of the table, with others fewer."""
    own = own_agents(domain, shape)
    return tuple(
        runs_at(domain, maker, shape, agents, runs=RUNS if agents == own else CURVE_RUNS[shape])
        for agents in (round(share * own) for share in SHARES[shape])
    )


# With N_a agents, by domain, maker, size and planner. The best generator is the one that moves most
# at S_eval; where another moves more at S, it has rows of its own there.
TABLE = {
    (domain, maker, shape, planner): runs_at(
        domain, maker, shape, own_agents(domain, shape), planner
    )
    for domain, maker, (shape, planner) in product(
        FLEETS, (*MAKERS, "nca-s"), ((S, "high"), (S, "published"), (S_EVAL, "high"))
    )
    if maker in MAKERS or (shape == S and domain in names() and most_at_s(domain) != USUAL)
}
# With each number of agents, by domain, maker and size.
CURVES = {key: curve(*key) for key in product(FLEETS, MAKERS, SIZES)}
