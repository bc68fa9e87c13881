"""A number of a mechanism that varies, and what it points at."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.ground.arguments import check_number, expect
from jaxclear.ground.wording import described, meant
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.studies.base import AbstractVariable, one_distribution
from jaxclear.studies.distribution import AbstractDistribution

__all__ = [
    "Variable",
    "check_apart",
    "check_derived",
    "check_variable",
    "leaves_of",
    "with_derived",
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


def with_derived(mechanism: Mechanism, variables: Mapping[str, Variable]) -> Mechanism:
    """The mechanism with the numbers that follow from its variables, in the order given."""
    for variable in variables.values():
        for where, value in variable.derived:
            leaves = lambda own: jax.tree.leaves(where(own))
            mechanism = eqx.tree_at(leaves, mechanism, [jnp.asarray(value(mechanism), float)])
    return mechanism


def check_derived(mechanism: Mechanism, variables: Mapping[str, Variable]) -> None:
    """Raises `ValueError` where a derived number is not what the mechanism itself has: one of the
    two is wrong."""
    varied = {
        id(leaf) for variable in variables.values() for leaf in leaves_of(variable)(mechanism)
    }
    for name, variable in variables.items():
        for where, value in variable.derived:
            leaves, found = jax.tree.leaves(where(mechanism)), value(mechanism)
            own = leaves[0] if len(leaves) == 1 else leaves
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


def check_apart(leaves: dict[str, list]) -> None:
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


def check_variable(name: str, variable: Any, mechanism: Mechanism) -> None:
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
