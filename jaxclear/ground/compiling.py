"""How programs are compiled that do little work themselves: how long they compile counts more than
how fast they are."""

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxclear.ground.quantity import is_traced

# XLA's newer emitters of fusions compile a third longer. Around a loop of machine code they gain
# 1 to 5 % of a run, and 17 % of one that XLA's own loop goes through.
AROUND_A_KERNEL = {"xla_cpu_use_fusion_emitters": False}
# What runs once is not optimised either: assemblies compile three times as fast and take no longer.
ONCE = {**AROUND_A_KERNEL, "xla_backend_optimization_level": 0}


def compiled_quickly(
    function: Callable[..., Any], options: dict[str, Any] = ONCE
) -> Callable[..., Any]:
    """As `equinox.filter_jit`, compiled with these options of XLA's. Within another program it is
    part of that one, and compiled as that one is."""
    plain = eqx.filter_jit(function)
    quick = eqx.filter_jit(function, compiler_options=options)  # type: ignore[call-overload]

    @functools.wraps(function)
    def call(*arguments):
        # JAX refuses options of a program within a program.
        within = is_traced(arguments) or is_traced(jnp.zeros(1))
        return (plain if within else quick)(*arguments)

    return call
