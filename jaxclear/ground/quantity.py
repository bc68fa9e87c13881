"""Fields that know their unit and meaning, so that a mechanism can print its own table of
parameters.

A quantity is a float64 leaf of a pytree: it can be varied, differentiated and batched. `None` means
absent and leaves no operation in the compiled program. A vector quantity is a tuple of scalar
leaves, because each component can then be varied by itself and a component that is not given is
known to be zero before tracing.

Every class with quantities derives from `AbstractQuantified`, which checks their ranges when an
object is built from numbers; a number that is being traced was checked before, or is a sample's.
"""

import dataclasses
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.precision import check_double_precision

__all__ = [
    "AbstractQuantified",
    "Scalar",
    "as_number",
    "as_vector",
    "check_range",
    "concrete",
    "inside",
    "numbers",
    "parameters",
    "public_name",
    "quantity",
    "range_in_words",
    "vector",
]

if TYPE_CHECKING:
    # A user gives a Python number, a law gets an array or a structural zero.
    Scalar: TypeAlias = Any
else:
    Scalar = Float[Array, ""]


def as_number(value: Any) -> Any:
    """A float64 scalar (shape ()); `None` and modules pass through, anything else that is no number
    is refused.

    Raises `ValueError` for arrays with axes or text, `RuntimeError` where float64 has been switched
    off.
    """
    if value is None or isinstance(value, eqx.Module):
        return value
    if isinstance(value, (str, bytes, dict, list, tuple, bool)):
        raise ValueError(f"expected one number, got {value!r}.")
    number = value if isinstance(value, jax.Array) else jnp.asarray(np.asarray(value, dtype=float))
    if number.dtype != jnp.float64:
        check_double_precision()
        number = number.astype(jnp.float64)
    if jnp.ndim(number) != 0:
        raise ValueError(f"expected one number, got an array of shape {jnp.shape(number)}.")
    return number


def as_vector(value: Any) -> Any:
    """A tuple of float64 scalars; `None` passes through (absent: structurally zero). Raises
    `ValueError` for one number.
    """
    if value is None:
        return None
    if not isinstance(value, (tuple, list)) and np.ndim(value) != 1:
        raise ValueError(f"expected several numbers, one for each direction, got {value!r}.")
    return tuple(as_number(component) for component in value)


def concrete(value: Any) -> float | None:
    """The number, or None where it is absent or being traced."""
    return None if value is None or isinstance(value, jax.core.Tracer) else float(value)


def quantity(
    default: Any = dataclasses.MISSING,
    unit: str = "1",
    meaning: str = "",
    *,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    **kwargs: Any,
) -> Any:
    """A scalar field with a unit (SI, "1" if none), a sentence of meaning and the range of its
    values.

    `default` may be a number or `None`. The range is checked when an object is built (see
    `AbstractQuantified`), for all numbers of a mechanism, and for every sample of a study.
    `converter` is for what may be given in other ways than as one number.
    """
    bounds = {"above": above, "at_least": at_least, "below": below, "at_most": at_most}
    return _field(
        default,
        unit,
        meaning,
        kwargs.pop("converter", as_number),
        kwargs,
        {k: v for k, v in bounds.items() if v is not None},
    )


def vector(
    default: Any = dataclasses.MISSING, unit: str = "1", meaning: str = "", **kwargs: Any
) -> Any:
    """A field of two or more scalars, each its own leaf, sharing one unit."""
    return _field(default, unit, meaning, as_vector, kwargs, {})


def _field(default, unit, meaning, converter, kwargs, bounds):
    metadata = {"unit": unit, "meaning": meaning} | bounds
    if default is not dataclasses.MISSING:
        kwargs["default"] = default
    return eqx.field(converter=converter, metadata=metadata, **kwargs)


class AbstractQuantified(eqx.Module):
    """What has numbers with units. Building one raises `ValueError` for a number that is not finite
    or outside its range: `integrator.MoreauJean has gamma = -1; it must be at least 0.`
    """

    def __check_init__(self):
        for field in dataclasses.fields(self):
            if "unit" in field.metadata:
                for path, leaf, metadata in _numbers(
                    getattr(self, field.name), field.name, field.metadata
                ):
                    check_range(lambda: public_name(type(self)), path, leaf, metadata)


def check_range(owner: Callable[[], str], path: str, leaf: Any, metadata: Mapping) -> None:
    """Raises `ValueError` if a known number is not finite or not within its field's range; `owner`
    says whose number it is.
    """
    if "unit" not in metadata or isinstance(leaf, jax.core.Tracer):
        return
    # A Python number: comparing it costs a tenth of what an array's costs, and every call builds
    # objects.
    value = float(leaf) if np.ndim(leaf) == 0 else leaf
    if _fits(value, metadata) if isinstance(value, float) else np.all(inside(leaf, metadata)):
        return
    unit = "" if metadata["unit"] == "1" else f" {metadata['unit']}"
    wanted = [range_in_words(metadata)] if range_in_words(metadata) else []
    wanted += [] if np.all(np.isfinite(leaf)) else ["finite"]
    raise ValueError(
        f"{owner()} has {path} = {np.asarray(leaf):g}{unit}; it must be {' and '.join(wanted)}."
    )


def _fits(value: float, metadata: Mapping) -> bool:
    """As `inside`, for one known number."""
    return (
        math.isfinite(value)
        and value > metadata.get("above", -math.inf)
        and value >= metadata.get("at_least", -math.inf)
        and value < metadata.get("below", math.inf)
        and value <= metadata.get("at_most", math.inf)
    )


def public_name(kind: type) -> str:
    """What a user types behind `jaxclear.` for a class, such as `contact.Hertz`; the class's own
    name where it is not of this package.
    """
    return _offered(sys.modules[__name__.partition(".")[0]], kind) or kind.__qualname__


def _offered(place: ModuleType, kind: type) -> str:
    """The path to a class by the names that modules offer; "" where there is none."""
    for name in getattr(place, "__all__", ()):
        thing = getattr(place, name, None)
        if thing is kind:
            return name
        inner = _offered(thing, kind) if isinstance(thing, ModuleType) else ""
        if inner:
            return f"{name}.{inner}"
    return ""


def numbers(tree: Any, name: str = "") -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """(name, leaf, metadata of its field) of every number in a mechanism or any part of it, in
    definition order; `name` is what the tree itself is called."""
    return _numbers(tree, name, {})


def parameters(tree: Any, name: str = "") -> list[dict[str, Any]]:
    """Rows (name, value, unit, meaning) of every number."""
    return [
        {
            "name": path,
            "value": np.asarray(leaf).tolist(),
            "unit": m.get("unit", "1"),
            "meaning": m.get("meaning", ""),
        }
        for path, leaf, m in numbers(tree, name)
    ]


def inside(leaf: Any, metadata: Mapping[str, Any]) -> Any:
    """True where a number lies in its field's range; works on traced numbers."""
    # A number that is known stays known within a program that is being traced.
    library = jnp if isinstance(leaf, jax.core.Tracer) else np
    leaf = library.asarray(leaf)
    fits = library.isfinite(leaf)
    if "above" in metadata:
        fits = fits & (leaf > metadata["above"])
    if "at_least" in metadata:
        fits = fits & (leaf >= metadata["at_least"])
    if "below" in metadata:
        fits = fits & (leaf < metadata["below"])
    return fits & (leaf <= metadata["at_most"]) if "at_most" in metadata else fits


def range_in_words(metadata: Mapping[str, Any]) -> str:
    """The range of a field: "above 0 and at most 1"."""
    words = {"above": "above", "at_least": "at least", "below": "below", "at_most": "at most"}
    return " and ".join(
        f"{word} {metadata[key]:g}" for key, word in words.items() if key in metadata
    )


def _numbers(tree, path, metadata):
    if isinstance(tree, eqx.Module):
        for field in dataclasses.fields(tree):
            if not field.metadata.get("static", False):
                inner = f"{path}.{field.name}" if path else field.name
                yield from _numbers(getattr(tree, field.name), inner, field.metadata)
    elif isinstance(tree, dict):
        for key, value in tree.items():
            yield from _numbers(value, f'{path}["{key}"]', metadata)
    elif isinstance(tree, (tuple, list)):
        for index, value in enumerate(tree):
            yield from _numbers(value, f"{path}[{index}]", metadata)
    elif eqx.is_array(tree):
        yield path, tree, metadata
