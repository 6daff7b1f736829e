"""How the annealer's inner functions are compiled: without counting references."""

from collections.abc import Callable
from typing import Any, TypeVar

from qdenv.native import compiled

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Compile a function that borrows its arrays: it makes none, keeps none and returns none.

    numba counts references, atomically, whenever an array is taken out of a record or a record is
    handed on: more than half of the time of an annealing move. Here the caller holds all arrays
    until the call ends, so nothing needs counting. A function that does make an array in spite of
    its promise is refused when it is compiled.
    """
    made: Any = compiled(function)
    # An inner option of numba, which a later version may drop: the kernels are then only slower.
    options = getattr(getattr(made, "targetdescr", None), "options", None)
    if hasattr(options, "_nrt"):
        made.targetoptions["_nrt"] = False
    result: Function = made
    return result
