"""Fast feasible layouts: simulated annealing in which the driving area never falls apart."""

import numpy as np

from qdenv.repair.board import begin, compile_board, settle
from qdenv.repair.kernels import cool
from qdenv.types import Rules


def anneal(
    layout: np.ndarray,
    rules: Rules,
    seed: int,
    moves: int,
    start: np.ndarray | None = None,
    heats: tuple[float, float] = (0.3, 0.1),
    pulls: tuple[float, float] = (0.6, 2.2),
) -> tuple[np.ndarray | None, float]:
    """Find a cheap layout that obeys every rule.

    Args:
        layout: int8 [H, W], the input from which changes are counted.
        rules: the constraints.
        seed: any integer; the same seed gives the same layout.
        moves: proposed moves.
        start: int8 [H, W], where to start instead of at the input.
        heats: first and last temperature, in units of the mean cell weight.
        pulls: first and last price of a broken demand, in units of the largest cell weight.

    Returns:
        The best feasible layout (int8 [H, W]) and its price, or (None, inf).
    """
    board, rng = compile_board(layout, rules), np.random.default_rng(abs(seed))
    state = begin(board, settle(board, layout if start is None else start, rng))
    prices = board.price[board.free]
    mean, top = (prices.mean(), prices.max()) if prices.any() else (1.0, 1.0)
    price = cool(
        board,
        state,
        rng.integers(1, 2**63, 1).astype(np.uint64),
        moves if board.free.size else 0,
        (heats[0] * mean, heats[1] * mean),
        (pulls[0] * top, pulls[1] * top),
    )
    if not np.isfinite(price):
        return None, float("inf")
    return state.best.reshape(layout.shape[0] + 2, -1)[1:-1, 1:-1].copy(), float(price)
