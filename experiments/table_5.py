"""Table 5: success rates and throughput of layouts by CMA-ES and by CMA-MAE, at S and S_eval.

With the rows of Table 2 for alpha = 0 and 1.
"""

from itertools import product

from experiments.layouts import CMA_MAE, FIRST_ZOO, S_EVAL, S, SavedLayout
from experiments.lines import LOOKS
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.published import AGENTS, FLEETS, TRAFFIC
from experiments.traffic import SavedTraffic, describe

MAKERS, RUNS = ("cma-es", "cma-mae", "nca"), 50
HEAD = (
    *("domain", "algorithm", "size", "agents", "success (95 %)", "tasks / timestep"),
    *("success under PBS", "tasks / timestep under PBS", "paper (success)"),
)
PLANNERS = {"high": "ours, high effort", "published": "PBS, published rule"}
NOTE = (
    "Our planner under high effort, and PBS by the published rule. Throughput: mean of the "
    "successful runs, ± its standard error; T = 5000. Both zoos' were "
    "chosen for S_eval, but for the best at S, and some come from searches that began at elites; "
    "the others are the plain best at S of 10,000 evaluations, of seed 0 unless stated, and so is "
    "the first zoo's in manufacturing."
)


def runs_of(
    layout: SavedLayout, agents: int, planner: str = "high", runs: int = RUNS
) -> SavedTraffic:
    """Return runs of 5,000 timesteps with one number of agents."""
    return SavedTraffic(layout, f"makers-{layout.domain}", (agents,), 5000, runs, planner)


def has_row(domain: str, maker: str, shape: tuple[int, int]) -> bool:
    """Return True if Table 5 or Figure 22 has a row of a maker."""
    if maker in (*CMA_MAE, "a1", "a0"):  # the first zoo's best factory is CMA-MAE's plain best
        return domain.startswith("warehouse")
    return maker != "nca-s" or (shape == S and (FIRST_ZOO / f"{domain}-nca-s").exists())


# With N_a agents, by domain, maker, size and planner.
TABLE = {
    (domain, maker, shape, planner): runs_of(
        SavedLayout(domain, maker, shape), AGENTS[domain][shape], planner
    )
    for domain, shape, maker, planner in product(
        FLEETS, (S, S_EVAL), ("cma-es", *CMA_MAE, "a1", "a0", "nca", "nca-s", "zoo"), PLANNERS
    )
    if has_row(domain, maker, shape)
}


def draw(folders: Folders) -> Drawn:
    """Write the table: a row per domain, algorithm and size."""
    rows = []
    for domain, maker, shape in dict.fromkeys(key[:3] for key in TABLE):
        pair = [TABLE[domain, maker, shape, planner] for planner in PLANNERS]
        refusal, agents = pair[0].layout.refusal(folders), AGENTS[domain][shape]
        named = (domain, LOOKS[maker].label, "{} x {}".format(*shape), agents)
        moved = [cell for saved in pair for cell in describe(saved.outcomes(folders), refusal)]
        theirs = maker if (domain, maker, agents) in TRAFFIC else "nca"
        rows.append((*named, *moved, TRAFFIC.get((domain, theirs, agents), "")))
    return Drawn(None, (*table(HEAD, rows), "", NOTE))


EXPERIMENT = Experiment("success and throughput: CMA-ES, CMA-MAE", tuple(TABLE.values()), draw)
