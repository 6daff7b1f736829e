"""All attacks of the campaign."""

from qdenv.bench.robustness.attack import Attack
from qdenv.bench.robustness.inputs import COMMANDS, FILES

ATTACKS: tuple[Attack, ...] = (FILES, COMMANDS)
