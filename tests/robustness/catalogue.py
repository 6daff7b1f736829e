"""All attacks of the campaign."""

from robustness.attack import Attack
from robustness.audits import AUDITS
from robustness.inputs import COMMANDS, FILES
from robustness.kills import OPERATIONS
from robustness.repairs import REPAIRS
from robustness.signals import SIGNALS

ATTACKS: tuple[Attack, ...] = (FILES, COMMANDS, OPERATIONS, SIGNALS, REPAIRS, AUDITS)
