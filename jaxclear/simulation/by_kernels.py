"""How a program is compiled whose time loops may be kernels: quickly where they are, as usual where
XLA goes through them itself."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax

from jaxclear.ground.compiling import AROUND_A_KERNEL, ONCE, compiled_quickly
from jaxclear.native import NoKernel, only_kernels


def compiled_for_kernels(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `equinox.filter_jit`, compiled as what runs `ONCE` if its time loops are kernels, and
    otherwise `AROUND_A_KERNEL`: XLA then goes through them itself."""
    soon = compiled_quickly(function, ONCE)
    return kernels_or(soon, compiled_quickly(function, AROUND_A_KERNEL))


def kernels_or(soon: Callable[..., Any], usual: Callable[..., Any]) -> Callable[..., Any]:
    """A compiled function, and another in its place where its time loops are no kernels."""
    refused: set[Any] = set()

    @functools.wraps(usual)
    def call(*arguments):
        if refused and _kind(arguments) in refused:
            return usual(*arguments)
        try:
            with only_kernels():
                return soon(*arguments)
        except NoKernel:
            refused.add(_kind(arguments))
        return usual(*arguments)

    return call


def _kind(arguments: Any) -> Any:
    """What of arguments decides which program they are compiled to."""
    leaves, structure = jax.tree.flatten(arguments)
    shapes = (jax.typeof(x) if eqx.is_array(x) else x for x in leaves)
    return structure, tuple(shapes)
