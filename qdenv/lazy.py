"""Packages that take long to import, imported when they are first used.

`from qdenv.lazy import jax, jnp` stands for `import jax` and `import jax.numpy as jnp` in modules
that a command line needs to refuse a mistake, to check a plan or to list presets: jax alone takes
longer than that. Such modules postpone their annotations (`from __future__ import annotations`).
"""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING, Any


class LazyModule(ModuleType):
    """A module that is imported when an attribute of it is first used."""

    def __getattr__(self, name: str) -> Any:
        """Look a name up in the true module."""
        return getattr(importlib.import_module(self.__name__), name)


if TYPE_CHECKING:
    import chex
    import jax
    import jax.numpy as jnp
    from scipy import ndimage
else:
    chex = LazyModule("chex")
    jax, jnp = LazyModule("jax"), LazyModule("jax.numpy")
    ndimage = LazyModule("scipy.ndimage")

__all__ = ["chex", "jax", "jnp", "ndimage"]
