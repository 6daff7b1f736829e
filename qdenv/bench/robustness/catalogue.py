"""All attacks of the campaign."""

from qdenv.bench.robustness.attack import Attack
from qdenv.bench.robustness.audits import AUDITS
from qdenv.bench.robustness.inputs import COMMANDS, FILES
from qdenv.bench.robustness.kills import OPERATIONS
from qdenv.bench.robustness.repairs import REPAIRS
from qdenv.bench.robustness.signals import SIGNALS

ATTACKS: tuple[Attack, ...] = (FILES, COMMANDS, OPERATIONS, SIGNALS, REPAIRS, AUDITS)
