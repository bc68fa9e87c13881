"""What is not known of the laws themselves: a sample in which each run has one of several
dissipation laws and one of several friction laws, chosen by a number, so that one program serves
all.
"""

import dataclasses
import functools
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.contact.base import AbstractDissipation
from jaxclear.laws.contact.dissipation import (
    AbstractRestitutionFactor,
    CarvalhoMartins,
    Flores,
    HuntCrossley,
    LankaraniNikravesh,
)
from jaxclear.laws.friction import Ambrosio, CoulombTanh
from jaxclear.laws.friction.slip import AbstractSlipFriction
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.studies.distribution import Discrete
from jaxclear.studies.variable import AbstractMechanismVariable, Variable

# Of the published factors for one coefficient of restitution the lowest, the highest that is in
# use for bearings, and one between.
DISSIPATIONS = (LankaraniNikravesh, Flores, HuntCrossley)
FRICTIONS = (Ambrosio, CoulombTanh)
# Names of what is drawn beside the unknowns.
DISSIPATION, FRICTION = "law of dissipation", "law of friction"


def _choice_field() -> Any:
    return quantity(0.0, "1", "number of the law that acts", at_least=0)


class ChosenDissipation(AbstractDissipation):
    """The mechanism's own dissipation or one of the `others`, at the own law's restitution."""

    stated: AbstractRestitutionFactor = eqx.field(default_factory=CarvalhoMartins)
    others: tuple[AbstractRestitutionFactor, ...] = ()
    choice: Scalar = _choice_field()
    remembers_impact_speed = True

    @property
    def restitution(self):
        return self.stated.restitution

    def relative_damping(self, rate, impact_speed):
        laws = (self.stated, *(_with(one, "restitution", self.restitution) for one in self.others))
        factors = [law.factor() for law in laws]
        return _choose_value(factors, self.choice) * rate / impact_speed


class ChosenFriction(AbstractSlipFriction):
    """The mechanism's own friction or one of the `others`, at the own law's kinetic coefficient;
    its other numbers are those of the own law."""

    stated: AbstractSlipFriction = eqx.field(default_factory=CoulombTanh)
    others: tuple[AbstractSlipFriction, ...] = ()
    choice: Scalar = _choice_field()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name in ("own", "others", "choice"):
            raise AttributeError(name)
        return getattr(self.stated, name)

    def _laws(self) -> tuple[AbstractSlipFriction, ...]:
        coefficient = _coefficient(self.stated)
        return (self.stated, *(_with(one, "mu_kinetic", coefficient) for one in self.others))

    def coulomb(self):
        return self.stated.coulomb()

    def largest_slope(self, step):
        slopes = [law.largest_slope(step) for law in self._laws()]
        return jnp.max(jnp.stack([jnp.asarray(slope, float) for slope in slopes]))

    def coefficient(self, slip_speed):
        return _choose_value([law.coefficient(slip_speed) for law in self._laws()], self.choice)


def _coefficient(law: Any) -> Any:
    return law.mu_kinetic


def _with(law: Any, number: str, value: Any) -> Any:
    return eqx.tree_at(lambda tree: getattr(tree, number), law, value)


def _choose_value(values: list[Any], choice: Any) -> Any:
    selected = values[0]
    for number, value in enumerate(values[1:], 1):
        selected = jnp.where(choice > number - 0.5, value, selected)
    return selected


class Ensemble(NamedTuple):
    """A mechanism whose laws are chosen by numbers, the variables that choose, and for each of
    these the names of its laws, by number."""

    mechanism: Mechanism
    variables: dict[str, AbstractMechanismVariable]
    names: dict[str, tuple[str, ...]]


def ensemble(mechanism: Mechanism, laws: Sequence[type] = (*DISSIPATIONS, *FRICTIONS)) -> Ensemble:
    """The mechanism with the choice of `laws`, classes of jaxclear.contact.dissipation and
    jaxclear.friction. A joint's own laws are always among them; one whose law is of another kind
    (no coefficient of restitution, friction that remembers or sticks) keeps it."""
    losses = [kind for kind in laws if issubclass(kind, AbstractRestitutionFactor)]
    frictions = [kind for kind in laws if issubclass(kind, AbstractSlipFriction)]
    names: dict[str, tuple[str, ...]] = {}
    extended = mechanism
    for name in mechanism.topology.clearances:
        joint = extended.connections[name].joint
        mix = functools.partial(_mix_laws, losses=losses, frictions=frictions, names=names)
        extended = _replace_joint(extended, name, jax.tree.map(mix, joint, is_leaf=_is_law))
    kinds = {DISSIPATION: _dissipation_choices, FRICTION: _friction_choices}
    variables: dict[str, AbstractMechanismVariable] = {
        what: Variable(where, Discrete(deviations=tuple(map(float, range(len(names[what]))))))
        for what, where in kinds.items()
        if what in names
    }
    return Ensemble(extended, variables, {what: names[what] for what in variables})


def _replace_joint(mechanism: Mechanism, name: str, joint: Any) -> Mechanism:
    return eqx.tree_at(lambda tree: tree.connections[name].joint, mechanism, joint)


def _is_law(part: Any) -> bool:
    return isinstance(part, (AbstractRestitutionFactor, AbstractSlipFriction))


def _mix_laws(part: Any, losses: list, frictions: list, names: dict[str, tuple[str, ...]]) -> Any:
    """A law with its alternatives, or a part as it is."""
    if isinstance(part, AbstractRestitutionFactor):
        kinds = _other_laws(part, losses)
        if kinds:
            with warnings.catch_warnings():
                # That a factor misses its restitution is part of what is not known.
                warnings.simplefilter("ignore")
                others = tuple(kind(restitution=part.restitution) for kind in kinds)
            names.setdefault(DISSIPATION, _law_names(part, kinds))
            return ChosenDissipation(part, others)
    if isinstance(part, AbstractSlipFriction):
        kinds = _other_laws(part, frictions)
        if kinds and "mu_kinetic" in {field.name for field in dataclasses.fields(type(part))}:
            others = tuple(_friction_like(kind, part) for kind in kinds)
            names.setdefault(FRICTION, _law_names(part, kinds))
            return ChosenFriction(part, others)
    return part


def _other_laws(law: Any, kinds: list) -> list:
    """Those beside the own one; of the usual ones so many that there are as many with it."""
    others = [kind for kind in kinds if kind is not type(law)]
    usual = kinds in (list(DISSIPATIONS), list(FRICTIONS))
    return others[: len(kinds) - 1] if usual else others


def _law_names(law: Any, kinds: list) -> tuple[str, ...]:
    return tuple(kind.__name__ for kind in (type(law), *kinds))


def _friction_like(kind: type, law: Any) -> Any:
    """A law with the kinetic coefficient of another, and as steep where it says how steep."""
    slope = float(law.largest_slope(0.0))
    coefficient = float(law.mu_kinetic)
    if slope > 0 and coefficient > 0:
        speed = coefficient / slope
        if kind is CoulombTanh:
            return CoulombTanh(mu_kinetic=coefficient, transition_speed=speed)
        if kind is Ambrosio:
            # Inner beside outer speed as by default.
            return Ambrosio(
                mu_kinetic=coefficient, inner_speed=speed / 9, outer_speed=speed * 10 / 9
            )
    return kind(mu_kinetic=coefficient)


def _list_choices(mechanism: Any, kind: Any) -> list[Any]:
    leaves = jax.tree.leaves(mechanism, is_leaf=lambda part: isinstance(part, kind))
    return [part.choice for part in leaves if isinstance(part, kind)]


def _dissipation_choices(mechanism: Any) -> list[Any]:
    return _list_choices(mechanism, ChosenDissipation)


def _friction_choices(mechanism: Any) -> list[Any]:
    return _list_choices(mechanism, ChosenFriction)
