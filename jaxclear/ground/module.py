"""Equinox's modules with attributes that are read faster: where few numbers are computed, reading
attributes and binding methods is most of what a call costs.
"""

from types import MethodType
from typing import TYPE_CHECKING, Any

import equinox as eqx

# Equinox's bound methods, without the module that they are bound to, by their functions.
_BOUND_METHODS: dict[Any, tuple[type, dict[str, Any]]] = {}


class AbstractModule(eqx.Module):
    """A module of Equinox whose bound methods are those of Equinox too, which are pytrees."""

    if not TYPE_CHECKING:

        def __getattribute__(self, name: str) -> Any:
            value = object.__getattribute__(self, name)
            if type(value) is not MethodType:
                return value
            if value.__self__ is not self or name.startswith("__"):
                return eqx.Module.__getattribute__(self, name)
            if value.__func__ not in _BOUND_METHODS:
                fields = dict(vars(method := eqx.Module.__getattribute__(self, name)))
                _BOUND_METHODS[value.__func__] = type(method), fields | {"__self__": None}
            # As it is built from its leaves: by its class it takes fifty times as long.
            kind, fields = _BOUND_METHODS[value.__func__]
            bound = object.__new__(kind)
            object.__getattribute__(bound, "__dict__").update(fields, __self__=self)
            return bound
