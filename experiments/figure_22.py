"""Figure 22: throughput over agents, of layouts by CMA-ES and by CMA-MAE, at S and S_eval."""

from itertools import product

from experiments.layouts import S_EVAL, S, SavedLayout
from experiments.lines import LOOKS, draw_line, finish, new_panels
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.published import AGENTS, FLEETS
from experiments.table_5 import MAKERS, RUNS, has_row, runs_of
from experiments.traffic import SavedTraffic
from qdenv.stats import margin

SIZES = {S: "S", S_EVAL: "S_eval"}
# Of N_a: numbers of agents over which Figure 22 draws throughput.
SHARES = {S: (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0), S_EVAL: (0.4, 0.6, 0.8, 1.0, 1.2, 1.4)}
# A run of CMA-MAE's at S_eval takes five to ten times as long, and runs differ by few per mille.
CURVE_RUNS = {S: RUNS, S_EVAL: 10}
HEAD = ("domain", "size", "layout", "runs", "most tasks / timestep", "agents then", "success then")
NOTES = (
    "Our planner; the first zoo's were chosen for S_eval (manufacturing: the plain best, too). "
    "Mean of all runs, congested ones too, with its 95 % interval; dotted: N_a of Table 5. "
    f"{CURVE_RUNS[S]} runs for each number of agents at S; {CURVE_RUNS[S_EVAL]} at S_eval, "
    f"{RUNS} for N_a.",
    "The paper: at S both are alike; at S_eval CMA-ES's generators are far behind "
    "(warehouse-uneven), or their drawings cannot be repaired.",
)


def curve(domain: str, maker: str, shape: tuple[int, int]) -> tuple[SavedTraffic, ...]:
    """Return the runs of one curve: with N_a agents those of the table."""
    layout, own = SavedLayout(domain, maker, shape), AGENTS[domain][shape]
    counts = (round(share * own) for share in SHARES[shape])
    return tuple(runs_of(layout, n, runs=RUNS if n == own else CURVE_RUNS[shape]) for n in counts)


# With each number of agents, by domain, maker and size.
CURVES = {key: curve(*key) for key in product(FLEETS, MAKERS, SIZES) if has_row(*key)}


def draw(folders: Folders) -> Drawn:
    """Draw the mean of all runs over agents, a column per domain, a row per size."""
    figure, panels = new_panels(len(SIZES), len(FLEETS), FLEETS)
    rows: list[tuple[object, ...]] = []
    for (domain, maker, shape), saved in CURVES.items():
        axes = panels[list(SIZES).index(shape), FLEETS.index(domain)]
        named = (domain, "{} x {}".format(*shape), LOOKS[maker].label)
        found = [row for traffic in saved for row in traffic.outcomes(folders)]
        if not found:
            if refused := saved[0].layout.refusal(folders):
                said = f"{LOOKS[maker].label}: no repair found"
                axes.text(0.03, 0.93, said, transform=axes.transAxes, fontsize="small")
            rows.append((*named, f"N/A: {refused}" if refused else "not made yet", "", "", ""))
            continue
        means = [row.mean_of_all for row in found]
        halves = [margin(row.sample_of_all) for row in found]
        draw_line(axes, [row.agents for row in found], means, halves, maker)
        best = max(found, key=lambda row: row.mean_of_all)
        runs = f"{sum(row.runs for row in found)} of {sum(one.seeds for one in saved)}"
        moved = (f"{best.mean_of_all:.2f}", best.agents, f"{best.successes}/{best.runs}")
        rows.append((*named, runs, *moved))
    for line, (shape, name) in zip(panels, SIZES.items(), strict=True):
        line[0].set_ylabel(f"{name}: tasks / timestep")
        for axes, domain in zip(line, FLEETS, strict=True):
            axes.set_xlabel("agents")
            axes.axvline(AGENTS[domain][shape], color="grey", ls=":", lw=1)
    finish(figure, panels)
    return Drawn(figure, (*table(HEAD, rows), "", *NOTES))


PIECES = tuple(traffic for saved in CURVES.values() for traffic in saved)
EXPERIMENT = Experiment(f"throughput over agents: {' and '.join(MAKERS)}", PIECES, draw)
