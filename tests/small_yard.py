"""A warehouse without a frame, for tests of the repair: no cell drives in every layout."""

import numpy as np

from qdenv.types import Adjacency, Count, Rules


def yard(rows: int, cols: int, low: int, high: int | None, **changes) -> Rules:
    rules = Rules(
        tiles=".@e",
        counts=(Count("@", low, high),),
        adjacency=(Adjacency("@", "e"), Adjacency("e", "@")),
        connected=".e",
        allowed=np.ones((rows, cols, 3), bool),
        change_cost=np.ones((rows, cols)),
    )
    return rules._replace(**changes)
