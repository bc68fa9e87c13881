"""A freewheel (sprag clutch, ratchet, backstop): it turns with its shaft one way only."""

from jaxclear.components.coupling.base import coordinate_field
from jaxclear.components.coupling.force import AbstractForceCoupling, check_needed
from jaxclear.components.load_base import CoordinateEffect, LoadState
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.transmission import freewheel_pull


class OneWay(AbstractForceCoupling):
    """A freewheel: a drives b forwards, and b may overtake it. A torque flows where a would turn
    by more than `ratio` times b, and never the other way.

    Its shaft is a spring of `stiffness` k that is wound up while it locks, so that it holds a load
    without creep, and unwinds within d / k of its `damping` d, both seen at a. Where it locks at
    the start it is unwound. It acts on the coordinates and loads no bearing. For a backstop hold
    one of the joints; where both ways are driven take `Ratio`.

    Args:
        a: name of the joint that drives.
        b: name of the joint that is driven.
        ratio: turns of a for one of b [1].
        stiffness: stiffness while it locks, seen at a [N m/rad; N/m for a sliding joint], > 0;
            required.
        damping: damping while it locks, seen at a [N m s/rad; N s/m for a sliding joint], > 0;
            required.

    Raises:
        ValueError: if stiffness or damping is missing.

    Source: the shaft with damping behind a gap of Nordin, Galić & Gutman 1997, Int. J. Adapt.
    Control Signal Process. 11, 49, with one flank.
    """

    a: str = coordinate_field()
    b: str = coordinate_field()
    ratio: Scalar = quantity(1.0, "1")
    stiffness: Scalar = quantity(None, "N m/rad", sliding="N/m", above=0, kw_only=True)
    damping: Scalar = quantity(None, "N m s/rad", sliding="N s/m", above=0, kw_only=True)

    def __check_init__(self):
        check_needed(self, "stiffness", "damping")

    def coordinates(self):
        return self.a, self.b

    def states(self):
        return (LoadState("wound", "rad"),)

    def effect(self, time, positions, speeds, states):
        rate = speeds[0] - self.ratio * speeds[1]
        (force, stored, loss), wound = freewheel_pull(states[0], rate, self.stiffness, self.damping)
        return CoordinateEffect((-force, self.ratio * force), (wound,), stored, loss, 0)

    def reads_position(self):
        return False

    def transmitted(self, effect):
        return -effect.forces[0]

    def along(self):
        return self.a
