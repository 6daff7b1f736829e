"""The negotiated planner: agents bargain for reservations until no two conflict.

Read `planner` for what it does and where the ideas come from, and `rules` for what both backends
share; then `numba`, which plans for one agent at a time and is the easier half: `search` finds the
best path of an agent past the reservations of the others, `rounds` decides which agents plan when,
and which of them win. `xla` does the same for several agents side by side, without a branch or a
host callback. Both give the same paths to the bit. What a search computes is specified by the
uniform-cost search over all states in the tests (`tests/mapf_oracle.py`).
"""
