"""What varies of a mechanism, which responses are wanted of it, and the checks of both."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.ground.arguments import check_number, expect
from jaxclear.ground.quantity import numbers
from jaxclear.ground.wording import described, meant
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.studies.base import AbstractVariable, is_one_number, one_distribution
from jaxclear.studies.distribution import AbstractDistribution

__all__ = [
    "Variable",
    "by_name",
    "check_responses",
    "check_variables",
    "leaves_of",
    "one_number",
    "places_of",
    "units_of_variables",
    "with_values",
]

# A derived number and the mechanism's own may differ by this share: data sheets round.
SAME = 1e-3


class Variable(AbstractVariable):
    """A number of the mechanism that varies: `where(mechanism)` returns its leaf, or several leaves
    that vary together.

    `distribution` is centred on the leaf's own value; `tolerance=t` stands for a normal
    distribution with three standard deviations in t, cut off at +-t.
    `derived`: numbers that follow from it, a pair of functions each: where the number stands, and
    what it is in a mechanism whose variables are set: `(lambda rig: rig.bodies["rod"].inertia,
    lambda rig: rig.bodies["rod"].mass * rig.bodies["rod"].com[0] ** 2 / 3)`.
    """

    where: Callable[[Mechanism], Any] = eqx.field(static=True)
    distribution: AbstractDistribution
    derived: tuple[tuple[Callable, Callable], ...] = eqx.field(static=True)

    def __init__(
        self,
        where: Callable,
        distribution: AbstractDistribution | None = None,
        *,
        tolerance: float | None = None,
        derived: Sequence[tuple[Callable, Callable]] = (),
    ):
        if tolerance is not None:
            check_number("tolerance of a Variable", tolerance, above=0)
        self.where = where
        self.distribution = one_distribution("Variable", distribution, tolerance)
        self.derived = tuple(_pair(one) for one in _listed(derived))


def leaves_of(variable: Variable) -> Callable[[Mechanism], list]:
    """What finds the numbers of a variable in a mechanism."""
    return lambda mechanism: jax.tree.leaves(variable.where(mechanism))


def _listed(derived: Any) -> Any:
    expect(derived, (list, tuple), "derived of a Variable", "a list of pairs of functions")
    return derived


def _pair(given: Any) -> tuple[Callable, Callable]:
    """Where a derived number stands, and what it is."""
    if not isinstance(given, (tuple, list)) or len(given) != 2 or not all(map(callable, given)):
        raise ValueError(
            f"derived of a Variable holds {described(given)}; each must be a pair of functions of "
            "a mechanism: where a number stands, and what it is."
        )
    return tuple(given)


def _with_derived(mechanism: Mechanism, variables: Iterable[Variable]) -> Mechanism:
    """The mechanism with the numbers that follow from its variables, in the order given."""
    for variable in variables:
        for where, value in variable.derived:
            leaves = lambda own: jax.tree.leaves(where(own))
            mechanism = eqx.tree_at(leaves, mechanism, [jnp.asarray(value(mechanism), float)])
    return mechanism


def _check_derived(mechanism: Mechanism, variables: Mapping[str, Variable]) -> None:
    """Raises `ValueError` where a derived number is not what the mechanism itself has: one of the
    two is wrong."""
    varied = {
        id(leaf) for variable in variables.values() for leaf in leaves_of(variable)(mechanism)
    }
    for name, variable in variables.items():
        for where, value in variable.derived:
            leaves, found = jax.tree.leaves(where(mechanism)), value(mechanism)
            own: Any = leaves[0] if len(leaves) == 1 else leaves
            if not eqx.is_array(own) or jnp.ndim(own) != 0 or id(own) in varied:
                raise ValueError(
                    f'variable "{name}" derives {described(own)}; it must be one number of the '
                    "mechanism, which no variable sets."
                )
            if not jnp.allclose(own, found, rtol=SAME, atol=0.0):
                raise ValueError(
                    f'variable "{name}" derives a number that is {float(found):.6g} at nominal, '
                    f"where the mechanism has {float(own):.6g}; give the mechanism what it derives."
                )


def with_values(mechanism: Mechanism, variables: list[Variable], values: Any) -> Mechanism:
    """The mechanism with its variables set, in the order of `values`. Leaves that vary together
    move by the same amount; derived numbers follow."""
    old = [leaves_of(variable)(mechanism) for variable in variables]
    for variable, own, value in zip(variables, old, values, strict=True):
        new = [leaf + (value - own[0]) for leaf in own]
        mechanism = eqx.tree_at(leaves_of(variable), mechanism, new)
    return _with_derived(mechanism, variables)


def units_of_variables(mechanism: Mechanism, variables: Iterable[Variable]) -> tuple[str, ...]:
    """Unit of each variable."""
    known = [(leaf, metadata.get("unit", "1")) for _, leaf, metadata in numbers(mechanism)]
    firsts = [leaves_of(variable)(mechanism)[0] for variable in variables]
    return tuple(next((u for leaf, u in known if leaf is first), "1") for first in firsts)


def places_of(mechanism: Mechanism, variables: dict[str, Variable]) -> dict[str, Any]:
    """What each variable points at, in words, and what follows from it."""
    leaves = jax.tree_util.tree_leaves_with_path(mechanism)
    known = {id(leaf): jax.tree_util.keystr(path).lstrip(".") for path, leaf in leaves}
    return {
        f'what "{name}" points at': ", ".join(known[id(x)] for x in leaves_of(own)(mechanism))
        for name, own in variables.items()
    } | {f'what "{name}" derives': own.derived for name, own in variables.items() if own.derived}


def by_name(what: str, given: Any) -> dict[str, Any]:
    """What varies or is wanted, by name; a response alone is called "response"."""
    if what == "response" and not isinstance(given, Mapping):
        return {what: given}
    expect(given, Mapping, f"{what} of a Problem", "a dictionary from names")
    if what == "response" and not given:
        raise ValueError("response of a Problem is empty; it must hold at least one.")
    for name in given:
        expect(name, str, f"a name in {what} of a Problem", "a text")
    return dict(given)


def one_number(name: str, value: Any) -> Array:
    """What a response answers, which studies take for one number."""
    if not is_one_number(value):
        hint = " It returns nothing: is a `return` missing?" if value is None else ""
        raise ValueError(
            f'response "{name}" gives {described(value)} for a run; it must be one number, such as '
            f"a mean or the largest.{hint}"
        )
    return jnp.asarray(value, float)


def check_responses(response: dict[str, Any], variables: dict[str, Any], of: str) -> None:
    """Responses are functions `of` something, and share no name with a variable."""
    for name, wanted in response.items():
        if not callable(wanted) or isinstance(wanted, type):
            hint = f": build one, {wanted.__name__}(...)" if isinstance(wanted, type) else ""
            raise ValueError(
                f'response "{name}" is {described(wanted)}; it must be a function of {of}, such as '
                f"one of jaxclear.response{hint}."
            )
        if name in variables:
            raise ValueError(
                f'"{name}" names a variable and a response; give them different names.'
            )


def check_variables(variables: dict[str, Any], mechanism: Mechanism) -> None:
    """Each points at numbers of the mechanism of its own."""
    for name, variable in variables.items():
        _check_variable(name, variable, mechanism)
    _check_derived(mechanism, variables)
    _check_apart({name: leaves_of(v)(mechanism) for name, v in variables.items()})


def _check_apart(leaves: dict[str, list]) -> None:
    """Each number of the mechanism may vary by one variable only."""
    taken: dict[int, str] = {}
    for name, own in leaves.items():
        for leaf in own:
            other = taken.setdefault(id(leaf), name)
            if other != name:
                raise ValueError(
                    f'variables "{other}" and "{name}" point at the same number of the mechanism; '
                    "only one of them can set it."
                )


def _check_variable(name: str, variable: Any, mechanism: Mechanism) -> None:
    """What is given as a variable of a mechanism."""
    expect(variable, Variable, f'variable "{name}"', "a jaxclear.Variable")
    try:
        target = variable.where(mechanism)
    except (KeyError, AttributeError, TypeError, IndexError) as error:
        raise ValueError(
            f'variable "{name}" points at nothing in this mechanism: its `where` fails with '
            f"{type(error).__name__}: {error}.{_meant(error, mechanism)}"
        ) from error
    leaves = target if isinstance(target, (tuple, list)) else [target]
    if not leaves or not all(eqx.is_array(leaf) and jnp.ndim(leaf) == 0 for leaf in leaves):
        raise ValueError(
            f'variable "{name}" must point at numbers of the mechanism; where(mechanism) gives '
            f"{described(target)}."
        )


def _meant(error: Exception, mechanism: Mechanism) -> str:
    """A question for the name that was probably meant where a `where` found none."""
    if isinstance(error, AttributeError) and error.name:
        return meant(error.name, [n for n in dir(error.obj) if not n.startswith("_")])
    key = error.args[0] if isinstance(error, KeyError) and error.args else ""
    return meant(key, [*mechanism.connections, *mechanism.bodies, *mechanism.loads])
