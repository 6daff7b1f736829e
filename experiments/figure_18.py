"""Figure 18: the most that layouts of seven sizes move, and with how many agents."""

from itertools import product

from experiments.layouts import SavedLayout
from experiments.ledger import Outcome
from experiments.lines import LOOKS, draw_line, finish, new_panels
from experiments.peaks import SavedPeak
from experiments.pieces import Drawn, Experiment, Folders, table
from experiments.published import FLEETS
from qdenv.stats import difference, margin
from qdenv.study.elites import SIZES

# The paper: 5,000 timesteps and 50 runs.
TIMESTEPS, SEEDS = 1000, 3
MAKERS = ("nca", "human")
PEAKS = {
    (domain, shape, maker): SavedPeak(
        SavedLayout(domain, maker, shape), f"peaks-{domain}", TIMESTEPS, SEEDS
    )
    for domain, shape, maker in product(FLEETS, SIZES, MAKERS)
}
HEAD = (
    *("domain", "size"),
    *(f"{LOOKS[maker].label}: tasks / timestep, agents" for maker in MAKERS),
    *("throughput (95 %)", "agents"),
)
NOTES = (
    f"T = {TIMESTEPS}, {SEEDS} runs with each number of agents, high effort; the paper has "
    "T = 5000 and 50 runs.",
    "The paper: both rise with the size, and automata draw the better layouts but for the "
    "throughput at 69 x 69 of warehouse-uneven and for both at 57 x 58 of manufacturing.",
)


def draw(folders: Folders) -> Drawn:
    """Draw peak throughput above and the agents at the peak below, a column per domain."""
    found = {key: one for key, peak in PEAKS.items() if (one := peak.read(folders)) is not None}
    figure, panels = new_panels(2, len(FLEETS), FLEETS)
    for (column, domain), maker in product(enumerate(FLEETS), MAKERS):
        places = [place for place, shape in enumerate(SIZES) if (domain, shape, maker) in found]
        if places:
            peaks = [found[domain, SIZES[place], maker] for place in places]
            halves = [margin(peak.sample_of_all) for peak in peaks]
            moved = [peak.mean_of_all for peak in peaks]
            draw_line(panels[0, column], places, moved, halves, maker)
            agents = [peak.agents for peak in peaks]
            draw_line(panels[1, column], places, agents, [0.0] * len(peaks), maker)
    names = [f"{rows} x {cols}" for rows, cols in SIZES]
    for axes in panels.flat:
        axes.set_xticks(range(len(SIZES)), names, rotation=30, ha="right", fontsize="small")
    panels[0, 0].set_ylabel("tasks / timestep at the peak")
    panels[1, 0].set_ylabel("agents at the peak")
    finish(figure, panels)
    rows = [row_of(domain, shape, found) for domain in FLEETS for shape in SIZES]
    return Drawn(figure, (*table(HEAD, rows), "", *NOTES))


def row_of(domain: str, shape: tuple[int, int], found: dict[tuple, Outcome]) -> tuple[object, ...]:
    """Write the peaks of one size."""
    peaks = [found.get((domain, shape, maker)) for maker in MAKERS]
    cells = [f"{peak.mean_of_all:.2f}, {peak.agents}" if peak else "not made yet" for peak in peaks]
    ours, theirs = peaks
    compared = ("", "")
    if ours and theirs:
        more = difference(ours.sample_of_all, theirs.sample_of_all)
        throughput = f"{more.percent:+.0f} % ({more.low:+.0f} to {more.high:+.0f})"
        compared = (throughput, f"{100 * (ours.agents / theirs.agents - 1):+.0f} %")
    return (domain, "{} x {}".format(*shape), *cells, *compared)


EXPERIMENT = Experiment("peaks of layouts of seven sizes", tuple(PEAKS.values()), draw)
