"""A rope over pulleys, a tendon: it pulls, and goes slack."""

from collections.abc import Iterable

import equinox as eqx

from jaxclear.components.acting import CoordinateEffect
from jaxclear.components.coupling.base import as_name
from jaxclear.components.coupling.force import AbstractForceCoupling, check_needed
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import Scalar, as_vector, quantity, vector
from jaxclear.laws.transmission import one_sided


def _as_names(given: Iterable[str]) -> tuple[str, ...]:
    return tuple(map(as_name, given))


class Rope(AbstractForceCoupling):
    r"""A rope over pulleys on several joints, whose length between its ends is :math:`l_0 + \sum_i
    r_i q_i`: a radius [m] for each joint that turns, a number (1 for one strand, 2 for two) for one
    that slides, its sign that with which the rope gets longer.

    It pulls by :math:`F = \max(0, F_0 + k \sum_i r_i q_i)` and a damper that is bounded by the
    spring, so that it never pushes: :math:`F_0` is its `pretension` where all coordinates are 0; a
    negative one is slack, of the length :math:`-F_0/k`. It acts on the coordinates alone: pulleys
    load their bearings by what you put there. `load.Spring` is a straight one that pushes, too.
    """

    over: tuple[str, ...] = eqx.field(static=True, converter=_as_names)
    radii: tuple = vector(
        unit="m", meaning="way of the rope for a unit of each coordinate", converter=as_vector
    )
    pretension: Scalar = quantity(0.0, "N", "pull where all coordinates are 0", kw_only=True)
    stiffness: Scalar = quantity(None, "N/m", "stiffness", above=0, kw_only=True)
    damping: Scalar | None = quantity(None, "N s/m", "damping", at_least=0, kw_only=True)

    def __check_init__(self):
        check_needed(self, "stiffness")
        if len(self.over) != len(self.radii):
            raise ValueError(
                f"coupling.Rope runs over {len(self.over)} joints and has {len(self.radii)} radii; "
                "each joint needs one."
            )

    def coordinates(self):
        return self.over

    def states(self):
        return ()

    def effect(self, time, positions, speeds, states):
        longer = sp.total(r * q for r, q in zip(self.radii, positions, strict=True))
        rate = sp.total(r * v for r, v in zip(self.radii, speeds, strict=True))
        slack = self.pretension / self.stiffness
        force, stored, lost = one_sided(longer + slack, rate, self.stiffness, self.damping)
        return CoordinateEffect(tuple(-r * force for r in self.radii), (), stored, lost, 0)

    def transmitted(self, effect):
        return -effect.forces[0] / self.radii[0]

    def along(self):
        return None
