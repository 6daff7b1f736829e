"""The settings of PIBT."""

from dataclasses import dataclass

from qdenv.devices import Backend
from qdenv.ranges import Ranged


@dataclass(frozen=True)
class PibtConfig(Ranged):
    """Priority inheritance with backtracking, one timestep at a time.

    Okumura et al. 2022, https://arxiv.org/abs/1901.11282.
    """

    # where to run: compiled host code (also "auto") or XLA; the results are the same
    backend: Backend = "auto"
    # whether agents change places where two have no room to pass (Okumura 2023): for floors with
    # dead ends and narrow passages; always computed on the host
    swap: bool = False
