"""The settings of PIBT."""

from dataclasses import dataclass

from qdenv.devices import Backend, check_backend
from qdenv.registry import Entry


@dataclass(frozen=True)
class PibtConfig:
    """Priority inheritance with backtracking, one timestep at a time."""

    # "host" for compiled code in a callback, "xla" for code without a callback, "auto" for the host
    # where jax computes on a CPU. The results are the same.
    backend: Backend = "auto"

    def __post_init__(self) -> None:
        """Refuse an unknown backend."""
        check_backend(self.backend)


PIBT = Entry(PibtConfig, "qdenv.simulate.mapf.pibt.planner:pibt")
