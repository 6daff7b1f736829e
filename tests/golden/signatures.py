"""The public names of the package: what each is, and how it is called."""

import inspect
import re
from typing import Any

import qdenv

PART = (0, 1)
CASES = list(qdenv.__all__)


def signature_of(function: Any) -> dict[str, str]:
    """Return the parameters with their defaults, and the types as text without bounds."""
    signature = inspect.signature(function)
    bare = [one.replace(annotation=one.empty) for one in signature.parameters.values()]
    types = {key: one.annotation for key, one in signature.parameters.items()}
    types["return"] = signature.return_annotation
    text = "; ".join(
        f"{key}: {getattr(one, '__forward_arg__', None) or inspect.formatannotation(one)}"
        for key, one in types.items()
        if one is not signature.empty
    )
    plain = inspect.Signature(bare)
    return {
        "signature": re.sub(r" at 0x\w+", "", str(plain)),
        "types": re.sub(r"\d+(\.\d+)?", "#", text.replace("'", "")),
    }


def run(name: str) -> Any:
    """Return the kind of a public name, its signature, and the public names of a class."""
    value = getattr(qdenv, name)
    function = getattr(value, "__wrapped__", value)  # a package that is also a function
    kind = "module, " * inspect.ismodule(value) + (
        "class" if inspect.isclass(function) else
        "function" if callable(function) else type(function).__name__
    )  # fmt: skip
    result: dict[str, Any] = {"kind": kind}
    if callable(function):
        result |= signature_of(function)
    if inspect.isclass(function):
        result["members"] = " ".join(one for one in dir(function) if one[:1] != "_")
    elif isinstance(function, dict):
        result["keys"] = " ".join(map(str, function))
    elif callable(getattr(function, "names", None)):
        result["names"] = " ".join(function.names())
    return result
