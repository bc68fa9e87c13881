r"""Couplings: one equation between the motions of joints or bodies, held by one multiplier.

A coupling of coordinates, $\sum_i r_i q_i = c$, acts on the coordinates of joints as a torque or a
force does and loads no bearing (`Ratio`, `Differential`).
"""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx

from jaxclear.ground.answering import nothing_else
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity

__all__ = [
    "AbstractCoordinateCoupling",
    "AbstractCoupling",
    "CoordinateTerm",
    "Differential",
    "Ratio",
]
__getattr__ = nothing_else("jaxclear.coupling", __all__)


class AbstractCoupling(AbstractQuantified):
    """One equation between the motions of joints or bodies."""

    @abstractmethod
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that it speaks of."""


class CoordinateTerm(NamedTuple):
    """The coordinate of a `joint`, times a `factor`."""

    joint: str
    factor: Any


class AbstractCoordinateCoupling(AbstractCoupling):
    """A sum of coordinates of joints that is constant.

    Each joint has one coordinate, of turning or sliding, and is ideal or has clearance; at most
    one angle may be of a joint outside the tree, where whole turns are not counted. It acts on the
    coordinates as a torque [N m] or force [N] does and loads no bearing: prefer a coupling of
    bodies where bearing loads matter.
    """

    @abstractmethod
    def terms(self) -> tuple[CoordinateTerm, ...]:
        """The coordinates with their factors; the first is that in whose unit the sum is."""

    @abstractmethod
    def total(self) -> Any:
        """What the sum is, in the unit of the first coordinate; None for 0."""

    def joints(self):
        return tuple(term.joint for term in self.terms())


class Ratio(AbstractCoordinateCoupling):
    r"""One joint's coordinate follows another's: $q_f = r\,q_l + c$.

    The `mimic` of URDF and the joint equality of MuJoCo (of degree 1). Loads no bearing: what it
    transmits acts along the two coordinates alone. Between coordinates of one unit r is a plain
    number; of a slide that follows a turn it is in m/rad.
    """

    follower: str = eqx.field(static=True)
    leader: str = eqx.field(static=True)
    ratio: Scalar = quantity(unit="1", meaning="change of the follower for one of the leader")
    offset: Scalar | None = quantity(
        None, "rad", "follower's coordinate where the leader's is 0 (m for a sliding joint)"
    )

    def __check_init__(self):
        _check_differ("Ratio", follower=self.follower, leader=self.leader)

    def terms(self):
        return (CoordinateTerm(self.follower, 1), CoordinateTerm(self.leader, -self.ratio))

    def total(self):
        return self.offset


class Differential(AbstractCoordinateCoupling):
    r"""Two outputs and a carrier: $q_a + i\,q_b = (1 + i)\,q_c$ (Willis).

    With i = 1 the bevel differential of an axle, whose outputs a and b turn as fast as the carrier
    c on an average; with i teeth of the ring over those of the sun a planetary set of sun a, ring b
    and carrier c. Its wheels share their load evenly and leave none in the bearings. All turns are
    seen from one body. Source: Willis 1841, Principles of Mechanism; Müller 1982, Epicyclic Drive
    Trains, chapter 2.
    """

    a: str = eqx.field(static=True)
    b: str = eqx.field(static=True)
    carrier: str = eqx.field(static=True)
    ratio: Scalar = quantity(1.0, "1", "turns of a for one of b, the carrier held", above=0)

    def __check_init__(self):
        _check_differ("Differential", a=self.a, b=self.b, carrier=self.carrier)

    def terms(self):
        return (
            CoordinateTerm(self.a, 1),
            CoordinateTerm(self.b, self.ratio),
            CoordinateTerm(self.carrier, -(1 + self.ratio)),
        )

    def total(self):
        return None


def _check_differ(kind: str, **joints: str) -> None:
    """Raises `ValueError` where a joint is named twice."""
    names = list(joints.values())
    for place, name in joints.items():
        if names.count(name) > 1:
            raise ValueError(
                f'coupling.{kind} has {place} = "{name}", which it names twice; it couples '
                "different joints."
            )
