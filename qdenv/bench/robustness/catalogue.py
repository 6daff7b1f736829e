"""All attacks of the campaign."""

from qdenv.bench.robustness.attack import Attack
from qdenv.bench.robustness.audits import AUDITS
from qdenv.bench.robustness.repairs import REPAIRS

ATTACKS: tuple[Attack, ...] = (REPAIRS, AUDITS)
