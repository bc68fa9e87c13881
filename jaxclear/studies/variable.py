"""What varies of a mechanism, or about it, such as a temperature."""

import dataclasses
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import scipy

from jaxclear.ground.arguments import check_number, expect
from jaxclear.ground.array_functions import on_host
from jaxclear.ground.quantity import Scalar, is_one_number, is_traced, quantity
from jaxclear.ground.warning import warn
from jaxclear.ground.wording import described, listed, meant
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.thermal_expansion import apply_thermal_expansion
from jaxclear.multibody.topology import numbers_of_parts
from jaxclear.studies.distribution import AbstractDistribution, AbstractJointDistribution
from jaxclear.studies.distribution.joint import marginals_of
from jaxclear.studies.experiment import (
    AbstractFreeVariable,
    AbstractVariable,
    one_distribution,
)

# The least quantile of a response that studies tell.
LEAST_QUANTILE = 0.05
# A derived number and the mechanism's own may differ by this share: data sheets round.
SAME = 1e-3


class AbstractMechanismVariable(AbstractVariable):
    """A number that varies in a mechanism, or in its environment."""

    @abstractmethod
    def leaves(self, mechanism: Mechanism) -> list:
        """The numbers of the mechanism that the variable sets.

        Args:
            mechanism: the `Mechanism`.

        Returns:
            A list of leaves.
        """

    @abstractmethod
    def check(self, name: str, mechanism: Mechanism) -> None:
        """Refuse a variable that does not belong to the mechanism.

        Args:
            name: name of the variable.
            mechanism: the `Mechanism`.

        Raises:
            ValueError: if it does not.
        """

    def check_derived(self, name: str, mechanism: Mechanism, varied: set[int]) -> None:
        """Refuse derived numbers that contradict the mechanism or that a variable sets.

        Args:
            name: name of the variable.
            mechanism: the `Mechanism`.
            varied: identifiers (`id`) of the numbers that variables set.

        Raises:
            ValueError: if a derived number is not what the mechanism has, or is among them.
        """


class Variable(AbstractMechanismVariable):
    """A number of a mechanism that varies, or several under one name.

    Args:
        where: function of a `Mechanism` that returns the number (a leaf), or several that move by
            the same amount; with a distribution of several numbers as many, each with its own.
        distribution: distribution of the deviation from the number's own value, one of
            `jaxclear.distribution`, or of several numbers, such as `jaxclear.distribution.Ball`; in
            its place `tolerance`.
        tolerance: half width t of the tolerance, a number in the varied number's unit, > 0: a
            normal distribution with a standard deviation of t/3, cut off at +-t.
        derived: numbers that follow from it, a sequence of pairs of functions of a mechanism: where
            the number stands, and its value once the variables are set, such as `(lambda rig:
            rig.bodies["rod"].inertia, lambda rig: rig.bodies["rod"].mass * rig.bodies["rod"].com[0]
            ** 2 / 3)`; () by default.

    Raises:
        ValueError: if neither or both of distribution and tolerance are given, or `derived` holds
            something else.
    """

    where: Callable[[Mechanism], Any] = eqx.field(static=True)
    distribution: AbstractDistribution | AbstractJointDistribution
    derived: tuple[tuple[Callable, Callable], ...] = eqx.field(static=True)

    def __init__(
        self,
        where: Callable,
        distribution: AbstractDistribution | AbstractJointDistribution | None = None,
        *,
        tolerance: float | None = None,
        derived: Sequence[tuple[Callable, Callable]] = (),
    ):
        if tolerance is not None:
            check_number("tolerance of a Variable", tolerance, above=0)
        self.where = where
        self.distribution = one_distribution("Variable", distribution, tolerance)
        expect(derived, (list, tuple), "derived of a Variable", "a list of pairs of functions")
        self.derived = tuple(_pair(one) for one in derived)

    def leaves(self, mechanism):
        return jax.tree.leaves(self.where(mechanism))

    def nominal_in(self, subject):
        leaves = self.leaves(subject)
        return jnp.stack(leaves) if self.parts else leaves[0]

    def unit_in(self, subject):
        first = self.leaves(subject)[0]
        return next((unit for _, leaf, _, unit in numbers_of_parts(subject) if leaf is first), "1")

    def put(self, name, subject, value):
        # Leaves that vary together move by the same amount.
        old = self.leaves(subject)
        new = list(value) if self.parts else [leaf + (value - old[0]) for leaf in old]
        return eqx.tree_at(self.leaves, subject, new)

    def followed(self, subject, value):
        for where, compute in self.derived:
            leaves = lambda tree: jax.tree.leaves(where(tree))
            subject = eqx.tree_at(leaves, subject, [jnp.asarray(compute(subject), float)])
        return subject

    def check(self, name, mechanism):
        _check_place(name, self.where, mechanism)
        leaves = self.leaves(mechanism)
        if self.parts and len(leaves) != len(self.parts):
            raise ValueError(
                f'variable "{name}" points at {len(leaves)} numbers, and its distribution is that '
                f"of {len(self.parts)}: {listed(self.parts)}."
            )
        if is_traced((leaves, self.distribution)):
            return
        for path, leaf, metadata, unit in numbers_of_parts(mechanism):
            for place in [i for i, one in enumerate(leaves) if leaf is one]:
                distribution = marginals_of(self.distribution)[place if self.parts else 0]
                _warn_of_cut_off(name, on_host(distribution), float(leaf), (path, metadata, unit))

    def identity(self, name, subject):
        leaves = jax.tree_util.tree_leaves_with_path(subject)
        paths = {id(leaf): jax.tree_util.keystr(path).lstrip(".") for path, leaf in leaves}
        places = ", ".join(paths[id(leaf)] for leaf in self.leaves(subject))
        derived = {f'what "{name}" derives': self.derived} if self.derived else {}
        return {f'what "{name}" points at': places} | derived

    def check_derived(self, name, mechanism, varied):
        unvaried = {id(leaf) for leaf in jax.tree.leaves(mechanism)} - varied
        for where, value in self.derived:
            what = f'what variable "{name}" derives'
            leaves = jax.tree.leaves(_evaluate_user(f"the place of {what}", where, mechanism))
            result = _evaluate_user(what, value, mechanism)
            leaf: Any = leaves[0] if len(leaves) == 1 else leaves
            if id(leaf) not in unvaried or jnp.ndim(leaf) != 0:
                raise ValueError(
                    f'variable "{name}" derives {described(leaf)}; it must be one number of the '
                    "mechanism, which no variable sets."
                )
            if not jnp.allclose(leaf, result, rtol=SAME, atol=0.0):
                raise ValueError(
                    f'variable "{name}" derives a number that is {float(result):.6g} at '
                    f"nominal, where the mechanism has {float(leaf):.6g}; give the mechanism "
                    "what it derives."
                )


@dataclasses.dataclass(frozen=True)
class Heating:
    """Thermal expansion by a temperature rise, as data: what a `Condition` acts by.

    A scene file holds it. It calls `apply_thermal_expansion(mechanism, rise, expansion)`, `rise`
    [K] above the temperature of the drawing.

    Args:
        expansion: coefficient of linear expansion [1/K], one number for all bodies and the ground,
            or a dict by body.
    """

    expansion: float | tuple[tuple[str, float], ...]

    def __init__(self, expansion: float | Mapping[str, float]):
        if isinstance(expansion, Mapping):
            if not expansion:
                raise ValueError(
                    "expansion of a Heating is empty; it must hold the coefficient [1/K] of one "
                    "body at least, or be one number for all."
                )
            for name, value in expansion.items():
                check_number(f'expansion of body "{name}" in a Heating', value, "1/K")
            pairs: Any = tuple((str(name), float(value)) for name, value in expansion.items())
        else:
            check_number("expansion of a Heating", expansion, "1/K")
            pairs = float(expansion)
        object.__setattr__(self, "expansion", pairs)

    def __call__(self, mechanism: Mechanism, rise: Any) -> Mechanism:
        """The mechanism at a higher temperature.

        Args:
            mechanism: the `Mechanism`.
            rise: temperature above that of the drawing [K].

        Returns:
            The new `Mechanism`.
        """
        expansion = self.expansion
        return apply_thermal_expansion(
            mechanism, rise, dict(expansion) if isinstance(expansion, tuple) else expansion
        )


class Condition(AbstractFreeVariable, AbstractMechanismVariable):
    """A quantity that varies and is no number of the mechanism, such as a temperature.

    Args:
        acts: function of a `Mechanism` and the value that returns the mechanism under the
            condition, after all other variables are set, such as a `Heating`; with the nominal
            value it is the mechanism at nominal.
        nominal: nominal value, a number in `unit`.
        distribution: distribution of the deviation from the nominal value, one of
            `jaxclear.distribution`; in its place `tolerance`.
        tolerance: half width t of the tolerance, a number in `unit`, > 0, as of a `Variable`.
        unit: unit, a text; "K" by default.

    Raises:
        ValueError: if an argument is of another kind, or neither or both of distribution and
            tolerance are given.
    """

    nominal: Scalar = quantity(unit="(its unit)", meaning="nominal value")
    distribution: AbstractDistribution
    acts: Callable[[Mechanism, Any], Mechanism] = eqx.field(static=True)
    unit: str = eqx.field(static=True)

    def __init__(
        self,
        acts: Callable[[Mechanism, Any], Mechanism],
        nominal: Any,
        distribution: AbstractDistribution | None = None,
        *,
        tolerance: float | None = None,
        unit: str = "K",
    ):
        if not callable(acts):
            raise ValueError(
                f"acts of a Condition is {described(acts)}; it must be a function of a mechanism "
                "and the condition's value that returns a mechanism."
            )
        if tolerance is not None:
            check_number("tolerance of a Condition", tolerance, above=0)
        expect(unit, str, "unit of a Condition", 'a text, such as "K"')
        self.acts, self.nominal, self.unit = acts, nominal, unit
        self.distribution = one_distribution("Condition", distribution, tolerance)

    def leaves(self, mechanism):
        return []

    def followed(self, subject, value):
        return self.acts(subject, value)

    def check(self, name, mechanism):
        result = self.acts(mechanism, self.nominal)
        expect(result, Mechanism, f'what condition "{name}" makes of the mechanism', "a mechanism")
        if jax.tree.structure(result) != jax.tree.structure(mechanism):
            raise ValueError(
                f'condition "{name}" makes another mechanism (other parts, not other numbers); '
                "change numbers only, as with equinox.tree_at."
            )

    def identity(self, name, subject):
        return {f'what "{name}" does': self.acts, f'nominal of "{name}"': self.nominal}


def _pair(pair: Any) -> tuple[Callable, Callable]:
    """Where a derived number stands, and what it is."""
    if not isinstance(pair, (tuple, list)) or len(pair) != 2 or not all(map(callable, pair)):
        raise ValueError(
            f"derived of a Variable holds {described(pair)}; each must be a pair of functions of "
            "a mechanism: where a number stands, and what it is."
        )
    return tuple(pair)


def check_variables(variables: dict[str, Any], mechanism: Mechanism) -> None:
    """Each points at numbers of the mechanism of its own, or is a condition."""
    for name, variable in variables.items():
        expected = "a jaxclear.Variable, or a jaxclear.Condition"
        expect(variable, AbstractMechanismVariable, f'variable "{name}"', expected)
        variable.check(name, mechanism)
    leaves = {name: variable.leaves(mechanism) for name, variable in variables.items()}
    _check_distinct(leaves)
    varied = {id(leaf) for group in leaves.values() for leaf in group}
    for name, variable in variables.items():
        variable.check_derived(name, mechanism, varied)


def _check_distinct(leaves: dict[str, list]) -> None:
    """Each number of the mechanism may vary by one variable only."""
    taken: dict[int, str] = {}
    for name, group in leaves.items():
        for leaf in group:
            other = taken.setdefault(id(leaf), name)
            if other != name:
                raise ValueError(
                    f'variables "{other}" and "{name}" point at the same number of the mechanism; '
                    "only one of them can set it."
                )


def _warn_of_cut_off(name: str, distribution: Any, leaf: Any, number: tuple[str, Any, str]) -> None:
    """Warns where more than the twentieth that studies tell of, the 5 % quantile, lies where the
    number cannot be."""
    path, metadata, unit = number
    unit = "" if unit == "1" else f" {unit}"
    low, high = (
        metadata.get(strict, metadata.get(inclusive))
        for strict, inclusive in (("above", "at_least"), ("below", "at_most"))
    )
    for words, bound, sign in (("below", low, 1), ("above", high, -1)):
        edge = LEAST_QUANTILE if sign == 1 else 1 - LEAST_QUANTILE
        if bound is None or sign * (leaf + distribution.quantile(edge) - bound) >= 0:
            continue
        part = float(scipy.special.ndtr(sign * distribution.score(bound - leaf)))
        warn(
            f'variable "{name}": {100 * part:.2g} % of its distribution lie {words} {bound:g}{unit}'
            f", where {path} cannot be. Such samples fail, and statistics are of the others."
        )


def _check_place(name: str, where: Callable, mechanism: Mechanism) -> None:
    """What a variable of a mechanism points at."""
    what = f'variable "{name}" points at nothing in this mechanism: its `where`'
    target = _evaluate_user(what, where, mechanism)
    leaves = target if isinstance(target, (tuple, list)) else [target]
    leaf_ids = {id(leaf) for leaf in jax.tree.leaves(mechanism)}
    if leaves and all(id(leaf) in leaf_ids and jnp.ndim(leaf) == 0 for leaf in leaves):
        return
    hint = ""
    if target is None:
        hint = (
            " What is not given there cannot vary: give a marker three numbers for `at` and "
            "axis=(0, 0, 1) instead of a name, say."
        )
    elif leaves and all(map(is_one_number, leaves)):
        hint = (
            " It computes, and what is computed cannot be set: return the number of the mechanism "
            "itself, and let others follow from it by derived=."
        )
    raise ValueError(
        f'variable "{name}" must point at numbers of the mechanism; where(mechanism) gives '
        f"{described(target)}.{hint}"
    )


def _evaluate_user(what: str, function: Callable, mechanism: Mechanism) -> Any:
    """What a user's function says of a mechanism; `what`: whose it is, for a sentence."""
    try:
        return function(mechanism)
    except (KeyError, AttributeError, TypeError, IndexError) as error:
        raise ValueError(
            f"{what} fails with {type(error).__name__}: {error}.{_meant(error, mechanism)}"
        ) from error


def _meant(error: Exception, mechanism: Mechanism) -> str:
    """A question for the name that was probably meant where a `where` found none."""
    if isinstance(error, AttributeError) and error.name:
        return meant(error.name, [n for n in dir(error.obj) if not n.startswith("_")])
    key = error.args[0] if isinstance(error, KeyError) and error.args else ""
    names = [*mechanism.connections, *mechanism.bodies, *mechanism.loads, *mechanism.couplings]
    return meant(key, names)
