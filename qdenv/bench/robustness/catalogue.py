"""All attacks of the campaign."""

from qdenv.bench.robustness.attack import Attack

ATTACKS: tuple[Attack, ...] = ()
