"""The negotiated planner: agents bargain for reservations until no two conflict.

How to read it:

1. `planner` says what it does and where the ideas come from; `settings` has its numbers.
2. `rules` holds the rules that both backends share. What the search computes, the
   best path of one agent past the reservations of the others, is specified by the uniform-cost
   search over all states in the tests (`tests/mapf_oracle.py`).
3. `numba` computes it for one agent at a time and is the easier half to read: `search` (which
   agent holds which cells, what an agent can reach, the cheapest end and the way there), `rounds`
   (which agents plan when, and which of them win).
4. `xla` does the same for several agents side by side, without a branch or a host callback:
   `search` (what an agent sees and can reach, the cheapest end and the way there), `rounds` (and
   how reservations are packed in bits).

Both backends give the same paths to the bit.
"""
