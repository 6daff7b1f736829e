"""Table 5: success rates and throughput of layouts by CMA-ES and by CMA-MAE, at S and S_eval."""

from experiments.lines import LOOKS
from experiments.makers import TABLE
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.published import TRAFFIC
from experiments.traffic import describe

HEAD = (
    *("domain", "algorithm", "size", "agents", "planner", "success (95 %)", "tasks / timestep"),
    "paper (success)",
)
PLANNERS = {"high": "ours, high effort", "published": "PBS, published rule"}
NOTE = (
    "Throughput: mean of the successful runs, +- its standard error; T = 5000. Ours of CMA-MAE are "
    "the zoo's, of whom `qdenv zoo` says whether further searches began at elites and gave some."
)


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
