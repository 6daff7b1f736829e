"""Table 5: success rates and throughput of layouts by CMA-ES and by CMA-MAE, at S and S_eval."""

from itertools import product

from experiments.layouts import S_EVAL, S, SavedLayout, most_at_s
from experiments.lines import LOOKS
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.published import AGENTS, FLEETS, TRAFFIC
from experiments.traffic import SavedTraffic, describe
from qdenv.shipped import USUAL, names

MAKERS, RUNS = ("cma-es", "nca"), 50
HEAD = (
    *("domain", "algorithm", "size", "agents", "planner", "success (95 %)", "tasks / timestep"),
    "paper (success)",
)
PLANNERS = {"high": "ours, high effort", "published": "PBS, published rule"}
NOTE = (
    "Throughput: mean of the successful runs, +- its standard error; T = 5000. Ours of CMA-MAE are "
    "the zoo's, of whom `qdenv zoo` says whether further searches began at elites and gave some."
)


def runs_of(
    layout: SavedLayout, agents: int, planner: str = "high", runs: int = RUNS
) -> SavedTraffic:
    """Return runs of 5,000 timesteps with one number of agents."""
    return SavedTraffic(layout, f"makers-{layout.domain}", (agents,), 5000, runs, planner)


# With N_a agents, by domain, maker, size and planner. The best generator is the one that moves most
# at S_eval; where another moves more at S, it has rows of its own there.
TABLE = {
    (domain, maker, shape, planner): runs_of(
        SavedLayout(domain, maker, shape), AGENTS[domain][shape], planner
    )
    for domain, maker, (shape, planner) in product(
        FLEETS, (*MAKERS, "nca-s"), ((S, "high"), (S, "published"), (S_EVAL, "high"))
    )
    if maker in MAKERS or (shape == S and domain in names() and most_at_s(domain) != USUAL)
}


def draw(folders: Folders) -> Drawn:
    """Write the table: a row per domain, algorithm, size and planner."""
    rows = []
    for (domain, maker, shape, planner), saved in TABLE.items():
        (agents,), found = saved.agents, saved.outcomes(folders)
        named = (domain, LOOKS[maker].label, "{} x {}".format(*shape), agents, PLANNERS[planner])
        moved = describe(found, saved.layout.refusal(folders))
        rows.append((*named, *moved, TRAFFIC[domain, maker.removesuffix("-s"), agents]))
    return Drawn(None, (*table(HEAD, rows), "", NOTE))


EXPERIMENT = Experiment("success and throughput: CMA-ES, CMA-MAE", tuple(TABLE.values()), draw)
