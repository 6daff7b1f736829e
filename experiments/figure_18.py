"""Figure 18: the most that layouts of seven sizes move, and with how many agents."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import count, product
from math import inf, prod

from experiments.layouts import OfLayout, SavedLayout
from experiments.ledger import RATES, Outcome
from experiments.lines import LOOKS, draw_line, finish, new_panels
from experiments.pieces import Drawn, Experiment, Folders, say, table
from experiments.published import FLEETS
from experiments.traffic import SavedTraffic
from qdenv.stats import difference, margin
from qdenv.study.elites import SIZES

STEP = 1.05  # agents from one number to the next where the peak is located
COARSE = 4  # such steps at once on the way up: 22 %
FALLS = 2  # numbers in a row that move less than the best so far: beyond the peak
BEGIN = 0.03  # agents per cell
RUNGS = range(-20, 80)  # of the ladder of numbers: BEGIN / 2.7 to more agents than cells
# Where nothing is known yet: agents per cell at the peak, and the work of locating it, in runs
# with as many agents as there are at the peak.
LIKELY, RUNS = 0.25, 14.0


@dataclass(frozen=True)
class SavedPeak(OfLayout):
    """The peak of one layout (section E.3)."""

    kind = "peaks"
    label = "peak of {0.layout.stem}"
    table: str  # the file in which the runs stand, which peaks share
    timesteps: int  # horizon T
    seeds: int  # how many runs with each number of agents

    def traffic(self, agents: Iterable[int]) -> SavedTraffic:
        """Describe the runs with some numbers of agents."""
        counts = tuple(sorted(set(agents)))
        return SavedTraffic(self.layout, self.table, counts, self.timesteps, self.seeds)

    def outcomes(self, folders: Folders) -> list[Outcome]:
        """Condense the runs with each number of agents that was tried, few to many."""
        every = self.traffic(map(self.agents_at, RUNGS))
        return [row for row in every.outcomes(folders) if row.runs == self.seeds]

    def read(self, folders: Folders) -> Outcome | None:
        """Read the peak; None where it is not located yet."""
        if self.done(folders) < 1:
            return None
        return max(self.outcomes(folders), key=lambda row: row.mean_of_all, default=None)

    def agents_at(self, rung: int) -> int:
        """Return the number of agents on a rung of the ladder."""
        rows, cols = self.layout.shape
        return max(1, round(BEGIN * rows * cols * STEP**rung))

    def wanted(self, folders: Folders) -> list[int]:
        """List the numbers of agents to try next; none where the peak is located."""
        if self.layout.refusal(folders):
            return []
        free = self.layout.read(folders).free.sum()
        moved = {row.agents: row.mean_of_all for row in self.outcomes(folders)}
        fitting = {rung: n for rung in RUNGS if (n := self.agents_at(rung)) <= free}
        known = {rung: moved[n] for rung, n in fitting.items() if n in moved}
        return [fitting[rung] for rung in next_rungs(known, max(fitting))]

    def done(self, folders: Folders) -> float:
        """Return which share of the work is done, so far as that can be known."""
        if not self.layout.done(folders):
            return 0.0
        if not self.wanted(folders):
            return 1.0
        work = sum(row.agents for row in self.outcomes(folders))
        return min(work / (RUNS * LIKELY * prod(self.layout.shape)), 0.95)

    def seconds(self, folders: Folders) -> float:
        """Estimate the CPU seconds of all runs."""
        work = RUNS * LIKELY * prod(self.layout.shape)
        return RATES["high"] * self.timesteps * self.seeds * work

    def make(self, folders: Folders) -> None:
        """Climb in large steps until throughput falls, then locate the top in small ones."""
        while wanted := self.wanted(folders):
            self.traffic(wanted).make(folders)
        if (peak := self.read(folders)) is not None:
            say(f"{self.layout.stem}: {peak.mean_of_all:.3f} with {peak.agents} agents")


def next_rungs(known: Mapping[int, float], last: int) -> list[int]:
    """List the rungs to try next: one on the way up, those around the top, or none.

    `known`: throughput by rung; `last`: the highest rung that fits.
    """
    best, falls = -inf, 0
    for rung in count(0, COARSE):
        if rung > last or falls == FALLS:
            break
        if rung not in known:
            return [rung]
        falls = 0 if known[rung] > best else falls + 1
        best = max(best, known[rung])
    top = max(known, key=lambda rung: known[rung])
    around = range(max(top - COARSE + 1, RUNGS[0]), min(top + COARSE - 1, last) + 1)
    return [rung for rung in around if rung not in known]


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
    rows: list[tuple[object, ...]] = []
    for domain, shape in product(FLEETS, SIZES):
        both = [found.get((domain, shape, maker)) for maker in MAKERS]
        cells = [f"{one.mean_of_all:.2f}, {one.agents}" if one else "not made yet" for one in both]
        ours, theirs = both
        compared = ("", "")
        if ours and theirs:
            more = difference(ours.sample_of_all, theirs.sample_of_all)
            throughput = f"{more.percent:+.0f} % ({more.low:+.0f} to {more.high:+.0f})"
            compared = (throughput, f"{100 * (ours.agents / theirs.agents - 1):+.0f} %")
        rows.append((domain, "{} x {}".format(*shape), *cells, *compared))
    return Drawn(figure, (*table(HEAD, rows), "", *NOTES))


EXPERIMENT = Experiment("peaks of layouts of seven sizes", tuple(PEAKS.values()), draw)
