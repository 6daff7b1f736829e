"""All attacks of the campaign."""

from qdenv.bench.robustness.attack import Attack
from qdenv.bench.robustness.kills import OPERATIONS, SIGKILLS

ATTACKS: tuple[Attack, ...] = (OPERATIONS, SIGKILLS)
