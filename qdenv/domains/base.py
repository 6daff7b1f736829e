"""The `Domain` record: everything that differs between warehouse, manufacturing and maze."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from qdenv.repair.recipe import RepairConfig
from qdenv.types import Array, Measure, Rules, TaskRule


class Simulator(NamedTuple):
    """How one layout is simulated; the pipeline batches it.

    Attributes:
        prepare: layout int8 [H, W] -> tables shared by all runs of this layout.
        run: (tables, key) -> one run (a record of arrays); consumes the key.
        lanes: how many runs to compute side by side (vmap); the rest wait in line (scan). 1 is
            best where the work per run is data-dependent and the device has few cores.
    """

    prepare: Callable[[Array], Any]
    run: Callable[[Any, Array], Any]
    lanes: int = 1


@dataclass(frozen=True)
class EvaluationConfig:
    """The numbers of one evaluation (Table 1 of the paper).

    Attributes:
        domain: name of a registered domain.
        rows: rows of the whole layout, frame included.
        cols: columns of the whole layout, frame included.
        steps: NCA steps C.
        kernel_sizes: kernel widths of the NCA's convolutions.
        hidden: channels of the NCA's hidden layers.
        shelves: exact number of shelves N_s (warehouse only).
        agents: agents N_a.
        timesteps: horizon T.
        simulations: simulations per layout N_e.
        effort: planner effort, "low" inside a search, "high" for reported numbers.
        alpha: weight of the similarity score in the objective.
        agent: an .npz agent for mazes; the shipped one unless given.
        repair: limits of the repair.
    """

    domain: str = "warehouse-even"
    rows: int = 33
    cols: int = 36
    steps: int = 50
    kernel_sizes: tuple[int, ...] = (3, 3, 3)
    hidden: int = 32
    shelves: int = 240
    agents: int = 200
    timesteps: int = 1000
    simulations: int = 5
    effort: str = "low"
    alpha: float = 5.0
    agent: str = ""
    repair: RepairConfig = field(default_factory=RepairConfig)


@dataclass(frozen=True)
class Domain:
    """A domain is a value: data and plain functions, no subclass.

    Attributes:
        name: how the domain is asked for.
        tiles: alphabet of framed layouts.
        generated: symbols the NCA draws, in channel order; the first tiles of `tiles`.
        seed_block: rows of the fixed block in the middle of the NCA's start canvas.
        margin: (rows, columns) that the frame adds to each side of the generated area.
        frame: generated area int8 [H - 2 dr, W - 2 dc] -> framed layout int8 [H, W].
        rules: (rows, cols, shelves) -> the repair's `Rules`; None where nothing is repaired.
        simulator: config -> `Simulator`.
        objective: (repaired layout, runs with leading axis S) -> float32, the objective f_res of
            the result archive; the learning objective adds alpha times the similarity.
        price: unrepaired layout int8 [H, W] -> float32 [H, W], p_i / max p of the similarity.
        measures: axes of the archive.
        design: (rows, cols) -> hand-made layout int8 [rows, cols], the baseline of appendix D.2;
            raises `InputError` where nothing fits; None where people design none.
        tasks: what a fleet does; None where no fleet drives.
    """

    name: str
    tiles: str
    generated: str
    seed_block: tuple[str, ...]
    margin: tuple[int, int]
    frame: Callable[[Array], Array]
    rules: Callable[[int, int, int], Rules] | None
    simulator: Callable[[EvaluationConfig], Simulator]
    objective: Callable[[Array, Any], Array]
    price: Callable[[Array], Array]
    measures: tuple[Measure, ...]
    design: Callable[[int, int], Array] | None = None
    tasks: TaskRule | None = None
