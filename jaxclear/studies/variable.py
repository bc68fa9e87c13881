"""A number of a mechanism that varies, and what it points at."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.ground.arguments import check_number, expect
from jaxclear.ground.wording import described, meant
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.studies.base import AbstractVariable, one_distribution
from jaxclear.studies.distribution import AbstractDistribution

__all__ = ["Variable", "check_apart", "check_variable", "leaves_of"]


class Variable(AbstractVariable):
    """A number of the mechanism that varies: `where(mechanism)` returns its leaf, or several leaves
    that vary together.

    `distribution` is centred on the leaf's own value; `tolerance=t` stands for a normal
    distribution with three standard deviations in t, cut off at +-t.
    """

    where: Callable[[Mechanism], Any] = eqx.field(static=True)
    distribution: AbstractDistribution

    def __init__(
        self,
        where: Callable,
        distribution: AbstractDistribution | None = None,
        *,
        tolerance: float | None = None,
    ):
        if tolerance is not None:
            check_number("tolerance of a Variable", tolerance, above=0)
        self.where = where
        self.distribution = one_distribution("Variable", distribution, tolerance)


def leaves_of(variable: Variable) -> Callable[[Mechanism], list]:
    """What finds the numbers of a variable in a mechanism."""
    return lambda mechanism: jax.tree.leaves(variable.where(mechanism))


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
