"""Fields that know their unit and meaning, so that a mechanism can print its own table of parameters.

A quantity is a float64 leaf of a pytree: it can be varied, differentiated and batched. `None` means absent and leaves no
operation in the compiled program. A vector quantity is a tuple of scalar leaves, because each component can then be
varied by itself and a component that is not given is known to be zero before tracing.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Scalar = Float[Array, ""]


def as_number(value: Any) -> Any:
    """A float64 scalar (shape ()); `None` and modules pass through, anything else that is no number is refused.

    Raises `ValueError` for arrays with axes or text, `RuntimeError` where float64 has been switched off.
    """
    if value is None or isinstance(value, eqx.Module):
        return value
    if isinstance(value, (str, bytes, dict, list, tuple, bool)):
        raise ValueError(f"expected one number, got {value!r}.")
    number = value if isinstance(value, jax.Array) else jnp.asarray(np.asarray(value, dtype=float))
    if number.dtype != jnp.float64:
        if not jax.config.jax_enable_x64:
            raise RuntimeError("jaxclear needs float64: leave jax_enable_x64 on (importing jaxclear switches it on).")
        number = number.astype(jnp.float64)
    if jnp.ndim(number) != 0:
        raise ValueError(f"expected one number, got an array of shape {jnp.shape(number)}.")
    return number


def as_vector(value: Any) -> Any:
    """A tuple of float64 scalars; `None` passes through (absent: structurally zero). Raises `ValueError` for one number."""
    if value is None:
        return None
    if not isinstance(value, (tuple, list)) and np.ndim(value) != 1:
        raise ValueError(f"expected several numbers, one for each direction, got {value!r}.")
    return tuple(as_number(component) for component in value)


def concrete(value: Any) -> float | None:
    """The number, or None where it is absent or being traced."""
    return None if value is None or isinstance(value, jax.core.Tracer) else float(value)


def quantity(default: Any = dataclasses.MISSING, unit: str = "1", meaning: str = "", **kwargs: Any) -> Any:
    """A scalar field with a unit (SI, "1" if none) and a sentence of meaning. `default` may be a number or `None`."""
    return _field(default, unit, meaning, as_number, kwargs)


def vector(default: Any = dataclasses.MISSING, unit: str = "1", meaning: str = "", **kwargs: Any) -> Any:
    """A field of two or more scalars, each its own leaf, sharing one unit."""
    return _field(default, unit, meaning, as_vector, kwargs)


def _field(default, unit, meaning, converter, kwargs):
    metadata = {"unit": unit, "meaning": meaning}
    if default is not dataclasses.MISSING:
        kwargs["default"] = default
    return eqx.field(converter=converter, metadata=metadata, **kwargs)


def unit_of(module: eqx.Module, name: str) -> str:
    """Unit of a module's field, with exponents that are themselves fields (as in N/m^exponent) left by name."""
    return _metadata(module)[name].get("unit", "1")


def parameters(tree: Any, name: str = "") -> list[dict[str, Any]]:
    """Rows (name, value, unit, meaning) of every number in a mechanism or any part of it, in definition order; `name` is
    what the tree itself is called."""
    return list(_rows(tree, name))


def _metadata(module):
    return {field.name: field.metadata for field in dataclasses.fields(module)}


def _rows(tree, path, unit="1", meaning=""):
    if isinstance(tree, eqx.Module):
        for field in dataclasses.fields(tree):
            if field.metadata.get("static", False):
                continue
            inner = f"{path}.{field.name}" if path else field.name
            metadata = field.metadata
            yield from _rows(getattr(tree, field.name), inner, metadata.get("unit", "1"), metadata.get("meaning", ""))
    elif isinstance(tree, dict):
        for key, value in tree.items():
            yield from _rows(value, f'{path}["{key}"]', unit, meaning)
    elif isinstance(tree, (tuple, list)):
        for index, value in enumerate(tree):
            yield from _rows(value, f"{path}[{index}]", unit, meaning)
    elif eqx.is_array(tree):
        yield {"name": path, "value": np.asarray(tree).tolist(), "unit": unit, "meaning": meaning}
