"""What the golden corpus calls of qdenv: the one file that knows where things are."""

import contextlib
import dataclasses
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import qdenv
from qdenv.cli.main import run as run_command
from qdenv.repairs.recipe import repair_layout
from qdenv.run import loop
from qdenv.run.config import config_to_json
from qdenv.simulation.mapf.settings import find_planner
from qdenv.study.engine import run_seeds


def domain_of(name: str, rows: int, cols: int, **numbers: int) -> qdenv.Domain:
    """Make a domain of one size with exact numbers of tiles."""
    return qdenv.find_domain(name).resized(rows, cols, numbers)


def repair(layout: np.ndarray, domain: qdenv.Domain, polish: str, seed: int) -> tuple:
    """Repair a layout; return the layout, status, cost and lower bound."""
    from qdenv.repairs.settings import RepairConfig

    rules = domain.rules()
    result = repair_layout(layout, rules, seed, RepairConfig(polish=polish))
    return np.asarray(result.layout), int(result.status), result.cost, result.lower_bound


PLANNERS = {
    "low": lambda: find_planner("low"),
    "high": lambda: find_planner("high"),
    "wait": lambda: dataclasses.replace(find_planner("high"), last_resort="wait"),
    "pbs-published": lambda: qdenv.PbsConfig(rule="published"),
    "pbs-plain": lambda: qdenv.PbsConfig(rule="plain"),
    "pibt": lambda: qdenv.PibtConfig(),
}


def simulate(
    layout: np.ndarray, domain: qdenv.Domain, agents: int, timesteps: int, planner: str, **how: Any
) -> list[dict[str, np.ndarray]]:
    """Simulate a layout with each seed; return the leaves of Traffic.

    Args:
        layout: int8 [H, W].
        domain: whose tasks are done.
        agents: number of agents.
        timesteps: horizon T.
        planner: one of `PLANNERS`.
        **how: seeds; backend ("host" or "xla") of planners with two; room, the most agents that
            the program has room for.
    """
    settings = PLANNERS[planner]()
    if "backend" in how:
        settings = dataclasses.replace(settings, backend=how["backend"])
    config = qdenv.FleetConfig(how.get("room", agents), timesteps, planner=settings)
    done = run_seeds(layout, domain.simulator.tasks, config, how["seeds"], agents)
    return [run._asdict() for run in done.runs]


def search(preset: str, overrides: dict[str, Any]) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Run a short search; return the columns of its archive and its last row of metrics."""
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        run = qdenv.train(preset, Path(folder) / "run", progress=False, **overrides)
        return dict(run.archive.columns), run.read_metrics()[-1]._asdict()


@contextlib.contextmanager
def _caught() -> Any:
    """Collect the configurations that searches begin with, and run none of them."""
    found: list[Any] = []

    class Begun(Exception):  # noqa: N818
        pass

    def begin(config: Any, *_: Any, **__: Any) -> None:
        found.append(config)
        raise Begun

    train, loop.train = loop.train, begin
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(Begun):
            yield found
    finally:
        loop.train = train


def resolve_config(preset: str, overrides: dict[str, Any]) -> dict[str, Any] | str:
    """Resolve what `qdenv.train(preset, **overrides)` runs, or the message that refuses it."""
    with _caught() as found:
        try:
            qdenv.train(preset, "/tmp/qdenv-golden-run", progress=False, **overrides)
        except qdenv.InputError as error:
            return str(error)
    return config_to_json(found[0])


def resolve_command(preset: str, words: list[str]) -> dict[str, Any] | str:
    """Resolve what `qdenv train PRESET WORDS` runs, or the message that refuses it."""
    errors = io.StringIO()
    with _caught() as found, contextlib.redirect_stderr(errors):
        run_command(["train", preset, *words, "--run-dir", "/tmp/qdenv-golden-run"])
    return config_to_json(found[0]) if found else errors.getvalue()


def course_of(maze: np.ndarray, domain: qdenv.Domain) -> dict[str, int]:
    """Find the start and the goal of a maze; empty where it is unsolvable."""
    return dict(domain.marks(maze))


def float_fingerprint() -> np.ndarray:
    """Draw with automata that amplify the last bit of XLA's sums (int8 [8, 16, 16]).

    Another processor or another version of XLA sums in another order and draws something else:
    seven of the eight do so when their parameters change by 3e-8 of themselves.
    """
    import jax

    canvas = qdenv.Canvas(16, 16, ".@ew", (".@.", "@e@", ".@."))
    generator = qdenv.GENERATORS.make(qdenv.NcaConfig(arithmetic="float"), canvas)
    weights = np.random.default_rng(0).normal(scale=0.4, size=(8, generator.size))
    return np.asarray(jax.jit(lambda w: generator.grow(w, 50))(weights.astype(np.float32)))
