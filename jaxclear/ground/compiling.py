"""How programs are compiled that do little work themselves: how long they compile counts more than
how fast they are."""

import functools
import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.ground.quantity import is_traced

# XLA's newer emitters of fusions compile a third longer. Around a loop of machine code they gain
# 1 to 5 % of a run, and 17 % of one that XLA's own loop goes through.
AROUND_A_KERNEL = {"xla_cpu_use_fusion_emitters": False}
# What runs once is not optimised either: assemblies compile three times as fast and take no longer.
# A loop that XLA goes through itself takes two to three times as long so.
ONCE = {
    **AROUND_A_KERNEL,
    "xla_backend_optimization_level": 0,
    "xla_llvm_disable_expensive_passes": True,
}
# XLA drops options between its versions, and says so by this; those that this one lacks.
NO_OPTION = "No such compile option"
_unknown: set[str] = set()


@contextmanager
def uncollected() -> Iterator[None]:
    """Within it Python does not look for cycles of garbage. Tracing makes objects by the million,
    most of which stay for as long as it lasts: going through them again and again is an eighth of a
    first run. Where two threads are within it, it ends with the one that came first."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def compiled_quickly(
    function: Callable[..., Any], options: dict[str, Any] = ONCE
) -> Callable[..., Any]:
    """As `equinox.filter_jit`, compiled with these options of XLA's. Within another program it is
    part of that one, and compiled as that one is."""
    # Its annotations leave out what it hands on to `jax.jit`.
    compiled: Any = eqx.filter_jit
    plain = compiled(function)

    @functools.cache
    def quick(unknown: frozenset[str]) -> Callable[..., Any]:
        own = {name: value for name, value in options.items() if name not in unknown}
        return compiled(function, compiler_options=own)

    @functools.wraps(function)
    def call(*arguments):
        # JAX refuses options of a program within a program.
        if is_traced(arguments) or is_traced(jnp.zeros(1)):
            return plain(*arguments)
        while True:
            try:
                with uncollected():
                    return quick(frozenset(_unknown))(*arguments)
            except jax.errors.JaxRuntimeError as error:
                found = [name for name in options if f"{NO_OPTION}: '{name}'" in str(error)]
                if not found:
                    raise
                _unknown.update(found)

    return call
