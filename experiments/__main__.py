"""List the paper's figures and tables, draw them from saved results, make what is missing."""

import contextlib
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from qdenv import interrupt

if __name__ == "__main__":
    interrupt.watch("python -m experiments")

from importlib import import_module

import tyro

from experiments.archives import RUNS
from experiments.panels import FIGURES
from experiments.pieces import RESULTS, Experiment, Folders
from experiments.program import run_program
from qdenv.io.files import write_atomically
from qdenv.ops.output import format_duration
from qdenv.ranges import PositiveInt
from qdenv.run.executors import Execution, ExecutorName
from qdenv.types import InputError, look_up
from qdenv.view.style import save_figure, styled


def names() -> list[str]:
    """Return the names of the experiments: scripts with an `EXPERIMENT`, and those of `panels`."""
    scripts = ("figure_*.py", "table_*.py", "maze_success.py", "runtimes.py")
    folder = Path(__file__).parent
    return sorted([*FIGURES, *(path.stem for form in scripts for path in folder.glob(form))])


def find(name: str, seeds: int = 1) -> Experiment:
    """Find an experiment, of `seeds` searches each; raise InputError if none has this name."""
    look_up(dict.fromkeys(names()), name, "experiment")
    found: Experiment = FIGURES.get(name) or import_module(f"experiments.{name}").EXPERIMENT
    runs = RUNS if found.pieces is RUNS else ()  # others show one search of each kind
    further = [replace(run, seed=seed) for run, seed in product(runs, range(1, seeds))]
    return replace(found, pieces=(*found.pieces, *further))


def list_all(folders: Folders, seeds: int) -> None:
    """Print what is there of each experiment, and what is missing, by kind."""
    for name in names():
        found = find(name, seeds)
        missing, every = found.missing(folders), len(found.everything)
        print(f"{name:13} {found.shows}: {every - len(missing)} of {every} pieces")
        costs: dict[str, list[float]] = {}
        for piece in missing:
            costs.setdefault(piece.kind, []).append(piece.cost(folders))
        kinds = (
            f"{kind}: {len(some)} ({format_duration(sum(some))})" for kind, some in costs.items()
        )
        if missing:
            print(f"{'':13} missing, with the time of one core: {', '.join(kinds)}")
    print("--missing NAME lists the missing pieces of one, --make NAME makes them")


def list_missing(experiment: Experiment, folders: Folders) -> None:
    """Print a line per piece that is missing, in the order in which they can be made."""
    missing = experiment.missing(folders)
    if not missing:
        print("nothing is missing")
    for piece in missing:
        share = f"{piece.done(folders):.0%} there, " if piece.done(folders) else ""
        print(f"{piece.name}: {share}about {format_duration(piece.cost(folders))} of one core")


def make(experiment: Experiment, folders: Folders) -> None:
    """Make what is missing, the cheapest pieces first, so that soon there is something to see."""
    while ready := experiment.ready(folders):
        missing = experiment.missing(folders)
        left = sum(piece.cost(folders) for piece in missing)
        print(f"{len(missing)} pieces, about {format_duration(left)} of one core: {ready[0].name}")
        ready[0].make(folders)
        if ready[0].done(folders) < 1:
            raise InputError(f"{ready[0].name}: was made and is still not whole")


def draw(name: str, experiment: Experiment, folders: Folders, out: Path) -> None:
    """Draw one experiment and print its table."""
    if not experiment.drawable(folders):
        raise InputError(f"{name}: nothing is saved to draw from; --make {name} makes it")
    drawn = styled(experiment.draw)(folders)
    print(f"{name}: {experiment.shows}")
    if drawn.lines:
        print("\n".join(drawn.lines))
        path = out / f"{name}.md"
        write_atomically(path, ("\n".join(drawn.lines) + "\n").encode())
        print(path)
    if drawn.figure is not None:
        save_figure(drawn.figure, out / f"{name}.png", crop=True)
        print(out / f"{name}.png")


def share_certificate(client: Any) -> contextlib.AbstractContextManager:
    """Let further clients connect to the same cluster by its address."""
    import dask

    own = client.security.get_tls_config_for_role("client")
    names = {"ca_file": "ca-file", "cert": "client.cert", "key": "client.key"}
    return dask.config.set({f"distributed.comm.tls.{names[one]}": own[one] for one in names})


def main(
    experiments: Annotated[tuple[str, ...], tyro.conf.Positional] = (),
    making: Annotated[str | None, tyro.conf.arg(name="make", metavar="NAME")] = None,
    missing: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    seeds: PositiveInt = 1,
    runs: Path = Path("runs"),
    results: Path = RESULTS,
    out: Path | None = None,
    executor: ExecutorName = "threads",
    scheduler: str | None = None,
    workers: int | None = None,
) -> None:
    """Draw experiments from saved results; without a name list all of them.

    Args:
        experiments: which to draw; all for all that can be drawn.
        making: make what this one is still missing, then draw it; an interruption loses little.
        missing: list what this one is still missing and what making it costs.
        seeds: number of searches of each kind in Table 4, seeds 0, 1, 2, ...; it shows up to five.
        runs: folder of whole runs, which are begun or continued here.
        results: folder of what is kept of them.
        out: folder for the pictures and tables; that of the results unless given.
        executor: who searches and simulates: threads of this process, or a Dask cluster; on this
            machine with --workers processes, or
        scheduler: where the scheduler of a running cluster answers, like tcp://10.0.0.1:8786.
        workers: processes of a cluster on this machine; one per core unless given.
    """
    folders, execution = Folders(results, runs), Execution(executor, scheduler, workers)
    chosen = list(experiments)
    if chosen == ["all"]:
        chosen = [name for name in names() if find(name).drawable(folders)]
    if making is not None:
        interrupt.advise()
        with contextlib.ExitStack() as stack:
            if executor != "threads":
                client = stack.enter_context(execution.connect())
                execution = Execution("dask", scheduler=client.scheduler_info()["address"])
                stack.enter_context(share_certificate(client))
                folders = folders._replace(client=client)
            make(find(making, seeds), folders._replace(execution=execution))
        chosen = [making, *chosen]
    if missing is not None:
        list_missing(find(missing, seeds), folders)
    elif not chosen:
        list_all(folders, seeds)
    for name in chosen:
        draw(name, find(name, seeds), folders, out or results)


if __name__ == "__main__":
    run_program(main, "python -m experiments")
