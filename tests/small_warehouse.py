"""A warehouse of 7 x 11 that obeys every rule, for tests of whole commands."""

TILES = ".@ew"
ROWS = [
    "...........",
    "w..@e.e@..w",
    "...@e.e@...",
    "...........",
    "w..e@.@e..w",
    "...........",
    "...........",
]
