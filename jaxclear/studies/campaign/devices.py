"""A batch on several accelerators: each computes samples of its own, by the same program as alone.

The devices are those that JAX sees in this process; `jax.sharding` lays the samples out over them.
"""

import functools
from collections.abc import Callable

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float

from jaxclear.studies.base import AbstractProblem, SampleResult
from jaxclear.studies.batch import evaluate_chunk

__all__ = ["devices", "laid_out", "on_all_devices"]


def devices() -> int:
    """Devices of this process that compute side by side."""
    return jax.local_device_count()


@functools.cache
def _mesh() -> Mesh:
    return Mesh(np.array(jax.local_devices()), ("samples",))


def laid_out(values: np.ndarray) -> Array:
    """Values (samples, variables) in equal parts on all devices."""
    if devices() == 1:
        return jax.numpy.asarray(values)
    return jax.device_put(values, NamedSharding(_mesh(), PartitionSpec("samples")))


def on_all_devices() -> Callable:
    """The function of a chunk whose samples are laid out over all devices."""
    return evaluate_chunk if devices() == 1 else _on_each


def _on_each(problem: AbstractProblem, values: Float[Array, "samples variables"]) -> SampleResult:
    """A chunk of samples, an equal part of it on each device."""
    numbers, rest = eqx.partition(problem, eqx.is_array)

    def own(numbers, values):
        return evaluate_chunk(eqx.combine(numbers, rest), values)

    # A device's part is a program of its own: its numbers are those of a batch of this size.
    parts = PartitionSpec(), PartitionSpec("samples")
    mapped = jax.shard_map(own, mesh=_mesh(), in_specs=parts, out_specs=parts[1], check_vma=False)
    return mapped(numbers, values)
