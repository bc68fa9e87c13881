"""Functions of arrays, by NumPy's names: by NumPy and SciPy where all arguments are theirs, which
compiles nothing, by JAX where one is JAX's, which may be traced.
"""

import functools
import importlib
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.ground.quantity import is_traced

SPECIAL = ("betainc", "gammainc", "ndtr", "ndtri")


def __getattr__(name: str) -> Callable[..., Any]:
    if name.startswith("_"):
        raise AttributeError(name)
    libraries: Any = np, jnp
    if name in SPECIAL:
        # Loaded for who needs them: a tenth of the import.
        libraries = scipy.special, importlib.import_module("jax.scipy.special")
    plain, traced = (getattr(library, name) for library in libraries)

    @functools.wraps(traced)
    def call(*arguments, **named):
        if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(arguments)):
            return traced(*arguments, **named)
        # JAX does not warn of what `where` throws away either.
        with np.errstate(all="ignore"):
            return plain(*arguments, **named)

    globals()[name] = call
    return call


def on_host(tree: Any) -> Any:
    """A tree with NumPy's arrays in place of JAX's; as it is where one of them is traced."""
    return tree if is_traced(tree) else jax.tree.map(np.asarray, tree)
