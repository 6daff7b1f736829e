"""Golden section: some of the fleets of traffic.py, driven by XLA to the same results."""

import traffic

PART = (10, 24)
_KINDS = ("hand-made", "repaired 0", "crowded")
CASES = [
    f"{p} {kind} / {one}"
    for p in (1, 2)
    for one in ("low", "high", "wait", "pibt")
    for kind in _KINDS
]


def run(name: str) -> dict:
    """Simulate one layout with XLA and on the host."""
    given = {"seeds": (3,)}
    found = traffic.run(name, backend="xla", **given)[0]
    host = traffic.run(name, backend="host", **given)[0]
    return found | {"same as on the host": {key: found[key] == host[key] for key in found}}
