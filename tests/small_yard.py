"""A warehouse without a frame, for tests of the repair: no cell drives in every layout."""

import numpy as np

from qdenv.types import Adjacency, Count, Rules


def yard(rows: int, cols: int, low: int, high: int | None, tiles=".@e", **changes) -> Rules:
    """State rules; of further `tiles` none may stand anywhere."""
    rules = Rules(
        tiles=tiles,
        counts=(Count("@", low, high),),
        adjacency=(Adjacency("@", "e"), Adjacency("e", "@")),
        connected=tiles.replace("@", ""),
        allowed=np.tile(np.arange(len(tiles)) < 3, (rows, cols, 1)),
        change_cost=np.ones((rows, cols)),
    )
    return rules._replace(**changes)
