"""All experiments by name, and the script of each."""

from importlib import import_module
from pathlib import Path

from experiments.pieces import Experiment
from qdenv.types import look_up

_SCRIPTS = ("figure_*.py", "table_*.py", "maze_success.py", "runtimes.py")


def names() -> list[str]:
    """List the experiments: a script of that name each."""
    folder = Path(__file__).parent
    return sorted(path.stem for pattern in _SCRIPTS for path in folder.glob(pattern))


def find(name: str) -> Experiment:
    """Find an experiment.

    Raises:
        InputError: no experiment has this name.
    """
    look_up(dict.fromkeys(names()), name, "experiment")
    found: Experiment = import_module(f"experiments.{name}").EXPERIMENT
    return found
