"""Couplings of coordinates, which load no bearing."""

from jaxclear.components.clearance.backlash import Backlash
from jaxclear.components.coupling.base import (
    AbstractCoordinateCoupling,
    CoordinateTerm,
    Motor,
    coordinate_field,
    damping_field,
    end_field,
    play_field,
    stiffness_field,
)
from jaxclear.ground.quantity import Scalar, quantity


class Ratio(AbstractCoordinateCoupling):
    r"""One joint's coordinate follows another's: $q_f = r\,q_l + c$.

    The `mimic` of URDF and the joint equality of MuJoCo (of degree 1). Loads no bearing: what it
    transmits acts along the two coordinates alone. Between coordinates of one unit r is a plain
    number; of a slide that follows a turn it is in m/rad. A `Motor` may lead, or follow.

    Args:
        follower: name of the joint that follows, or a `Motor`.
        leader: name of the joint that leads, or a `Motor`.
        ratio: change of the follower for one of the leader [1; m/rad for a slide that follows a
            turn].
        offset: follower's coordinate where the leader's is 0 [rad; m for a sliding joint]; None: 0.
        play: play, a `clearance.Backlash`, or its width alone [rad; m for a sliding joint]; none by
            default.
        stiffness: stiffness [N m/rad; N/m for a sliding joint], > 0; none by default.
        damping: viscous damping [N m s/rad; N s/m for a sliding joint], >= 0; none by default.
    """

    follower: str | Motor = end_field()
    leader: str | Motor = end_field()
    ratio: Scalar = quantity(unit="1")
    offset: Scalar | None = quantity(None, "rad", sliding="m")
    play: Backlash | None = play_field()
    stiffness: Scalar | None = stiffness_field()
    damping: Scalar | None = damping_field()

    def terms(self):
        return (CoordinateTerm(self.follower, 1), CoordinateTerm(self.leader, -self.ratio))

    def total(self):
        return self.offset


class Differential(AbstractCoordinateCoupling):
    r"""Two outputs and a carrier: $q_a + i\,q_b = (1 + i)\,q_c$ (Willis).

    With i = 1 the bevel differential of an axle, whose outputs a and b turn as fast as the carrier
    c on an average; with i teeth of the ring over those of the sun a planetary set of sun a, ring b
    and carrier c. Its wheels share their load evenly and leave none in the bearings. All turns are
    seen from one body.

    Args:
        a, b: names of the joints of the two outputs.
        carrier: name of the joint of the carrier.
        ratio: turns of a for one of b with the carrier at rest [1], > 0.
        play: play, a `clearance.Backlash`, or its width alone [rad; m for a sliding joint]; none by
            default.
        stiffness: stiffness [N m/rad; N/m for a sliding joint], > 0; none by default.
        damping: viscous damping [N m s/rad; N s/m for a sliding joint], >= 0; none by default.

    Source: Willis 1841, Principles of Mechanism; Müller 1982, Epicyclic Drive Trains, chapter 2.
    """

    a: str = coordinate_field()
    b: str = coordinate_field()
    carrier: str = coordinate_field()
    ratio: Scalar = quantity(1.0, "1", above=0)
    play: Backlash | None = play_field()
    stiffness: Scalar | None = stiffness_field()
    damping: Scalar | None = damping_field()

    def terms(self):
        return (
            CoordinateTerm(self.a, 1),
            CoordinateTerm(self.b, self.ratio),
            CoordinateTerm(self.carrier, -(1 + self.ratio)),
        )

    def total(self):
        return None


class Latch(AbstractCoordinateCoupling):
    """A joint whose coordinate is tied to a place with play or by a spring: a worn key, a latch, an
    elastic stop on both sides.

    `load.JointStop` has a stop on one side, or two apart.

    Args:
        joint: name of the joint.
        place: coordinate to which it is tied [rad; m for a sliding joint]; None: 0.
        play: play, a `clearance.Backlash`, or its width alone [rad; m for a sliding joint]; none by
            default.
        stiffness: stiffness [N m/rad; N/m for a sliding joint], > 0; none by default.
        damping: viscous damping [N m s/rad; N s/m for a sliding joint], >= 0; none by default.

    Raises:
        ValueError: if neither play nor stiffness is given.
    """

    joint: str = coordinate_field()
    place: Scalar | None = quantity(None, "rad", sliding="m")
    play: Backlash | None = play_field()
    stiffness: Scalar | None = stiffness_field()
    damping: Scalar | None = damping_field()

    def __check_init__(self):
        if self.play is None and self.stiffness is None:
            raise ValueError(
                "coupling.Latch has neither play nor stiffness; to hold a joint for good take a "
                "joint.Fixed."
            )

    def terms(self):
        return (CoordinateTerm(self.joint, 1),)

    def total(self):
        return self.place
