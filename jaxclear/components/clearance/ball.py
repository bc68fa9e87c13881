"""Ball and socket: one contact, at the point of the socket towards which the ball lies; and what it
is while it always touches."""

from typing import ClassVar

import equinox as eqx

from jaxclear.components.clearance.base import (
    AbstractClearance,
    ContactCandidate,
    ContactLaws,
    check_clearance,
    direction,
)
from jaxclear.components.joint import AbstractRubbingBall, Spherical
from jaxclear.components.sphere_map import SphereMap
from jaxclear.components.wear_map import Wearing
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.friction import AbstractFrictionLaw
from jaxclear.laws.stiffness import Shape


class BallSocket(AbstractClearance):
    r"""Ball in a hollow socket: one contact, :math:`\delta = |e| - c`.

    Args:
        contact: contact law, one of `jaxclear.contact`.
        friction: friction law, one of `jaxclear.friction`; none by default.
        socket_radius: radius of the socket [m], > 0.
        clearance: radial clearance, socket radius minus ball radius [m], > 0.
        socket_wear: wear of the socket, a `Wearing`; none by default.
        ball_wear: wear of the ball, a `Wearing`; none by default.

    Raises:
        ValueError: if the clearance is not below the socket radius.
    """

    ideal_rows: ClassVar = ("x", "y", "z")
    surfaces: ClassVar = ("socket", "ball")
    contact: AbstractNormalLaw
    friction: AbstractFrictionLaw | None = None
    socket_radius: Scalar = quantity(10e-3, "m", above=0, kw_only=True)
    clearance: Scalar = quantity(0.1e-3, "m", above=0, kw_only=True)
    socket_wear: Wearing | None = eqx.field(default=None, kw_only=True)
    ball_wear: Wearing | None = eqx.field(default=None, kw_only=True)

    def __check_init__(self):
        check_clearance(self, "socket_radius")

    @property
    def axes(self) -> tuple[int, ...]:
        return () if self.ball_wear is None else (0, 1, 2)

    @property
    def ball_radius(self) -> Scalar:
        return self.socket_radius - self.clearance

    def contact_laws(self):
        shape = Shape(self.ball_radius, self.socket_radius, None)
        return (ContactLaws(self.contact, self.friction, shape, True),)

    def indentations(self, offset, axes, worn):
        overlap = sp.norm(offset) - self.clearance
        for surface in worn:
            towards = offset if surface == "socket" else sp.apply(axes, offset)
            depth = self.maps()[surface][0].depth_towards(worn[surface], *towards)
            overlap = overlap - depth
        return (overlap,)

    def contact_candidates(self, offset, axes, indentations):
        normal = direction(offset, 3)
        place = sp.scale(self.socket_radius + 0.5 * indentations[0], normal)
        return (ContactCandidate(place, normal, sp.IDENTITY),)

    def wear_map(self, surface, wearing):
        radius = self.socket_radius if surface == "socket" else self.ball_radius
        return SphereMap(wearing.cells, radius, self.clearance, coarseness=wearing.coarseness)

    def features(self, surface, offset, axes, indentations, index):
        towards = direction(offset, 3)
        x, y, z = towards if surface == "socket" else sp.apply(axes, towards)
        pairs = ((x, x), (x, y), (x, z), (y, y), (y, z))
        return (
            x,
            y,
            z,
            *(sp.mul(*pair) for pair in pairs),
            self.maps()[surface][0].narrowness(indentations[0]),
        )

    def grown(self, outer, inner):
        socket = outer * self.socket_radius
        gap = socket - inner * self.ball_radius
        return eqx.tree_at(lambda j: (j.socket_radius, j.clearance), self, (socket, gap))

    def diameters(self):
        return 2.0 * self.socket_radius, 2.0 * self.ball_radius

    def with_diameters(self, outer, inner):
        sizes = 0.5 * outer, 0.5 * (outer - inner)
        return eqx.tree_at(lambda joint: (joint.socket_radius, joint.clearance), self, sizes)

    def seat(self, force, torque):
        return sp.scale(-self.clearance, direction(force, 3)), (0, 0)

    def permanent_form(self):
        if self.friction is None and not self.maps():
            return Spherical()
        return PermanentSpherical(self)

    def coordinate_form(self):
        return Spherical()


class PermanentSpherical(AbstractRubbingBall):
    """A ball that always touches its socket, where its reaction presses it.

    Args:
        gap: the joint with clearance, a `BallSocket`.
    """

    home: ClassVar = Spherical.home
    units: ClassVar = Spherical.units
    rows: ClassVar = Spherical.rows
    reversal: ClassVar = Spherical.reversal
    gap: BallSocket

    @property
    def friction(self):
        return self.gap.friction

    @property
    def arm(self):
        return self.gap.ball_radius

    @property
    def has_moving_centre(self):
        return True

    @property
    def play(self):
        return self.gap.clearance

    @property
    def gap_axes(self):
        return self.gap.axes

    def maps(self):
        return self.gap.maps()

    def wearing_contacts(self):
        return (0,)

    def wear_place(self, surface, offset, axes, contact, indentation):
        return self.gap.features(surface, offset, axes, (indentation,), contact)

    def indentation(self, contact, force):
        return self.gap.contact_laws()[contact].indentation_under(force)
