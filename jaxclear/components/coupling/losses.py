"""What teeth and threads lose: the efficiency of a transmission."""

from typing import Any, NamedTuple

import equinox as eqx

from jaxclear.ground.quantity import AbstractQuantified, Scalar, as_number, quantity
from jaxclear.laws.transmission import Helix, loss


class Efficiency(AbstractQuantified):
    """The share of the power passed that comes out of a transmission.

    The rest is friction on the first end, in proportion to the force of the flank. At rest friction
    holds: it is a spring with a damper, so that nothing creeps; a motor holds a load with less than
    it needs to lift it. It needs `stiffness` or play of its coupling, by which the force of the
    flank is known, and acts on the coordinate of the first end. Steps resolve that spring;
    `integrator.ImplicitStep`, which takes it as a step finds it, creeps.

    Args:
        forwards: share of the power that comes out from the first end to the second [1], > 0 and <=
            1.
        backwards: the same from the second to the first [1], <= 1; None: as forwards. Negative:
            self-locking; to come back it must be pushed by this share of the torque.
        presliding: deflection of the first end at which friction is full [rad], > 0.
        settling_time: damping time of friction that holds [s], >= 0.

    Source: Pelchen, Schweiger & Otter 2002, Modeling and simulating the efficiency of gearboxes and
    of planetary gearboxes, Proc. 2nd Int. Modelica Conference, 257; Prandtl 1928, Z. angew. Math.
    Mech. 8, 85, doi:10.1002/zamm.19280080202 (friction that holds).
    """

    forwards: Scalar = quantity(unit="1", above=0, at_most=1)
    backwards: Scalar | None = quantity(None, "1", at_most=1)
    presliding: Scalar = quantity(1e-3, "rad", above=0, kw_only=True)
    settling_time: Scalar = quantity(1e-3, "s", at_least=0, kw_only=True)

    def loss(self, force: Scalar, share: Scalar) -> Scalar:
        """Friction on the first end.

        Args:
            force: force with which the flank pushes back on that end [N m, N], positive against a
                positive motion.
            share: share of the friction that acts [1], -1 to 1.

        Returns:
            the friction [N m, N].
        """
        backwards = self.forwards if self.backwards is None else self.backwards
        return loss(force, share, self.forwards, backwards)


class Thread(NamedTuple):
    """A thread that rubs: its `helix`, friction `coefficient` [1], and how friction holds:
    deflection `presliding` [m] and damping time [s]."""

    helix: Helix
    coefficient: Any
    presliding: Any
    settling_time: Any


def as_efficiency(value: Any) -> Any:
    """An `Efficiency` from a number; anything else as it is."""
    if value is None or isinstance(value, eqx.Module):
        return value
    return Efficiency(as_number(value))


def efficiency_field() -> Any:
    """Field of the efficiency of a coupling: an `Efficiency`, or that forwards alone."""
    return eqx.field(default=None, converter=as_efficiency, kw_only=True)
