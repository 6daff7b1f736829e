"""All experiments by name: scripts that define an `EXPERIMENT`, and the figures of `panels`."""

from importlib import import_module
from pathlib import Path

from experiments.panels import FIGURES
from experiments.pieces import Experiment
from qdenv.types import look_up


def names() -> list[str]:
    """Return the names of the experiments."""
    scripts = ("figure_*.py", "table_*.py", "maze_success.py", "runtimes.py")
    folder = Path(__file__).parent
    return sorted([*FIGURES, *(path.stem for form in scripts for path in folder.glob(form))])


def find(name: str) -> Experiment:
    """Find an experiment; raise InputError if none has this name."""
    look_up(dict.fromkeys(names()), name, "experiment")
    if name in FIGURES:
        return FIGURES[name]
    found: Experiment = import_module(f"experiments.{name}").EXPERIMENT
    return found
