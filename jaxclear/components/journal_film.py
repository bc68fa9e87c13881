r"""The film in the gap of a journal bearing, as a load between its two parts.

Force and torque on journal and bearing are in balance: with F the force on the journal and
:math:`T = 2\pi\mu R^3 L\omega/(c\sqrt{1 - \varepsilon^2})` the torque of shear, the torque on the
journal is :math:`-T - \tfrac12 e \times F` and on the bearing :math:`T - \tfrac12 e \times F`.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.components.load_base import AbstractJointLoad, JointEffect, LoadState
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.laws.film import AbstractFilm
from jaxclear.laws.film.impedance import full_film_scales

# Parts of a step in which a journal moves, and turns of Newton's method in each, the first with the
# journal where it is.
PARTS, NEWTON, FROZEN = 4, 7, 2


class JournalFilm(AbstractJointLoad):
    """The film of a joint.

    Args:
        connection: name of the joint.
        law: film law, one of `jaxclear.film`, fitted to the bearing.
        radius: radius of the bearing's hole [m], > 0.
        clearance: radial clearance [m], > 0.
        length: length of the bearing [m], > 0.
        sheared: whether only the torque of shear acts, a flag.
    """

    connection: str = eqx.field(static=True)
    law: AbstractFilm
    radius: Scalar = quantity(unit="m", above=0)
    clearance: Scalar = quantity(unit="m", above=0)
    length: Scalar = quantity(unit="m", above=0)
    sheared: bool = eqx.field(static=True, default=False)

    @property
    def slenderness(self) -> Scalar:
        """Length over diameter [1]."""
        return self.length / (2 * self.radius)

    @property
    def stiffening(self) -> Scalar:
        """12 mu R (R/c)^3 [N s/m], by which the law's impedance is multiplied."""
        ratio = self.radius / self.clearance
        return 12 * self.law.viscosity * self.radius * ratio * ratio * ratio

    def _eccentricity_ratio(self, x: Any, y: Any) -> Any:
        """Eccentricity ratio [1] of an offset [m], as the film is evaluated."""
        return self.law.floored(safe_sqrt(x * x + y * y) / self.clearance)

    def squeeze_force(self, offset: tuple, squeeze: tuple) -> tuple[Any, Any]:
        """Force on the journal [N], in the bearing's axes.

        Args:
            offset: (x, y) from the bearing's centre to the journal's [m].
            squeeze: squeeze velocity [m/s], a pair.

        Returns:
            a pair of forces [N].
        """
        x, y = offset
        distance = safe_sqrt(x * x + y * y)
        i, j = safe_divide(x, distance), safe_divide(y, distance)
        i = jnp.where(distance > 0, i, 1.0)
        u, v = squeeze
        against, across = self.law.force(
            self._eccentricity_ratio(x, y), u * i + v * j, v * i - u * j, self.slenderness
        )
        size = -self.stiffening
        return size * (against * i - across * j), size * (against * j + across * i)

    def damping(self, offset: tuple) -> Any:
        """Damping of the film that closes [N s/m], the largest of all directions.

        Args:
            offset: (x, y) from the bearing's centre to the journal's [m].

        Returns:
            the damping [N s/m].
        """
        e = self._eccentricity_ratio(*offset)
        root = jnp.sqrt((1 - e) * (1 + e))
        return self.stiffening * full_film_scales(e, root, self.slenderness)[0]

    def shear_torque(self, offset: tuple, spin: Any) -> Any:
        """Torque by which shear resists [N m].

        Args:
            offset: (x, y) from the bearing's centre to the journal's [m].
            spin: angular velocity of the journal as seen from the bearing [rad/s].

        Returns:
            the torque [N m].
        """
        e, cube = self._eccentricity_ratio(*offset), self.radius * self.radius * self.radius
        size = 2 * jnp.pi * self.law.viscosity * cube * self.length
        return size * spin / (self.clearance * jnp.sqrt((1 - e) * (1 + e)))

    def act(self, time, motion, states):
        (x, y, _), spin = motion.pose.translation, motion.spin[2]
        torque = sp.neg(self.shear_torque((x, y), spin))
        if self.sheared:
            return JointEffect(sp.ZERO, (0, 0, torque))
        u, v = motion.velocity[:2]
        squeeze = u + 0.5 * spin * y, v - 0.5 * spin * x
        along, across = self.squeeze_force((x, y), squeeze)
        torque = torque - 0.5 * (x * across - y * along)
        return JointEffect((along, across, 0), (0, 0, torque))


class MobileJournal(AbstractJointLoad):
    """The film of a joint whose journal moves as the joint's reaction drives it (Booker's mobility
    method): its states are the journal's offset and the force that has driven it.

    Args:
        connection: name of the joint.
        film: the film between its parts, a `JournalFilm`.

    Source: Booker 1965, J. Basic Eng. 87, 168, doi:10.1115/1.3650461.
    """

    connection: str = eqx.field(static=True)
    film: JournalFilm

    @property
    def clearance(self) -> Scalar:
        """Radial clearance [m]."""
        return self.film.clearance

    def states(self):
        names = ("x", "m"), ("y", "m"), ("fx", "N"), ("fy", "N")
        return tuple(LoadState(*name) for name in names)

    def act(self, time, motion, states):
        x, y, along, across = states
        torque = -self.film.shear_torque((x, y), motion.spin[2])
        torque = torque - 0.5 * (x * across - y * along)
        return JointEffect(sp.ZERO, (0, 0, torque), (0.0,) * len(states))

    def moved(self, states: tuple, spin: Any, force: tuple, duration: Any) -> tuple:
        """The states after some time under a force.

        Midpoint rule in a few parts; in each Newton's method on the squeeze velocity whose film
        gives the force, first with the journal where it is.

        Args:
            states: the states before, a tuple.
            spin: angular velocity of the journal as seen from the bearing [rad/s].
            force: force of the film on the journal [N], in the bearing's axes.
            duration: the time [s].

        Returns:
            the states after it, a tuple.
        """
        length, target = duration / PARTS, jnp.stack([jnp.asarray(x, float) for x in force])
        spinning = jnp.array([[0.0, -0.5], [0.5, 0.0]]) * spin

        def part(offset, _):
            def force_at(squeeze, moving):
                # place = offset + length / 2 (squeeze + spinning @ place), solved for the place.
                half = 0.5 * length * spinning[1, 0]
                x, y = (offset[i] + 0.5 * length * moving * squeeze[i] for i in (0, 1))
                ahead = moving * half
                scale = 1 / (1 + ahead * ahead)
                place = scale * (x - ahead * y), scale * (y + ahead * x)
                return jnp.stack(self.film.squeeze_force(place, (squeeze[0], squeeze[1]))), place

            def improve(squeeze, moving):
                force_of = lambda x: force_at(x, moving)[0]
                value, (along, across) = force_of(squeeze), jax.jacfwd(force_of)(squeeze).T
                short = target - value
                size = along[0] * across[1] - along[1] * across[0]
                first = safe_divide(short[0] * across[1] - short[1] * across[0], size)
                second = safe_divide(along[0] * short[1] - along[1] * short[0], size)
                return squeeze + jnp.stack([first, second]), None

            moving = jnp.arange(NEWTON) >= FROZEN
            squeeze, _ = jax.lax.scan(improve, -target / self.film.damping(offset), moving)
            _, place = force_at(squeeze, True)
            return offset + length * (squeeze + spinning @ jnp.stack(place)), None

        offset, _ = jax.lax.scan(part, jnp.stack(states[:2]), length=PARTS)
        return offset[0], offset[1], *force


def film_of(name: str) -> str:
    """Name of the film of a joint, by which `run.reaction` gives its force."""
    return f"{name}.film"
