"""What acts on the coordinates of joints and motors: what it is asked, and what it answers."""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx

from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import Pose
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity


class AbstractLoad(AbstractQuantified):
    """A load on bodies, or on the coordinate of a joint.

    `switches`: whether its force may bend or jump as the mechanism moves, as that of a stop; it may
    unless overridden. Derivatives of steps that do not end there are off in proportion to them.
    """

    switches: ClassVar[bool] = True

    def springs_back(self) -> bool:
        """Whether it stays as it is where loads are reversed, as a spring does and friction; it
        does unless overridden."""
        return True


class LoadState(NamedTuple):
    """A state of a load, which the integrators carry beside the motion.

    Args:
        name: name of the state, a text.
        unit: unit of the state, a text.
        start: value at the beginning of a run [its unit].
        saturation: size at which the state stands still [its unit], where steps end; None: no such
            bound.
    """

    name: str
    unit: str = "1"
    start: Any = 0.0
    saturation: Any = None


class CoordinateEffect(NamedTuple):
    """What a load on coordinates does at one instant.

    Args:
        forces: generalised force on each coordinate [N m; N for a sliding joint], a tuple.
        rates: rate of each state [unit of the state per s], a tuple.
        stored: stored energy [J].
        dissipated: dissipated power [W].
        external: power that enters the mechanism [W].
    """

    forces: tuple
    rates: tuple
    stored: Any
    dissipated: Any
    external: Any


class Side(NamedTuple):
    """One side of a stop of a coordinate.

    The coordinate is stopped where `sign` times it is below `sign` times `place`.

    Args:
        sign: 1 for a lower stop, -1 for an upper one [1].
        place: coordinate of the stop [rad; m for a sliding joint].
        stop: the `JointStop` that it belongs to.
    """

    sign: float
    place: Any
    stop: Any

    def beyond(self, position: Any) -> Any:
        """How far the coordinate is beyond the stop, positive where it presses.

        Args:
            position: coordinate [rad; m for a sliding joint].

        Returns:
            the depth [rad; m for a sliding joint].
        """
        return self.sign * (self.place - position)


class MotorEnd(AbstractQuantified):
    """The motor behind a joint.

    Where nothing lies between them, the motor's coordinate is `ratio` times that of the joint plus
    `offset`.

    Args:
        coordinate: name of the motor's coordinate.
        ratio: turns of the motor for one of the joint [1].
        offset: angle of the motor where the joint's is 0 [rad]; None: 0.
    """

    coordinate: str = eqx.field(static=True)
    ratio: Scalar = quantity(unit="1")
    offset: Scalar | None = quantity(None, "rad")


class AbstractStateLoad(AbstractLoad):
    """Acts on one or more coordinates of joints that turn or slide, or of motors
    (`coupling.Motor`, by the coupling's name and ".motor"), by what they all do and by states of
    its own.

    A joint may also close a loop or have clearance; then its coordinate is that of the ideal joint
    that it would be, read between its two markers. An angle is followed over whole turns, from
    where `start` or `guess` of the mechanism gives it, else from within half a turn of 0. States
    are carried by every integrator beside the motion, and held to its tolerance as coordinates are.
    """

    @abstractmethod
    def coordinates(self) -> tuple[str, ...]:
        """The joints and motors whose coordinates it reads, and on which it acts, each once."""

    @abstractmethod
    def states(self) -> tuple[LoadState, ...]:
        """Its states; none for a load that follows from the motion alone."""

    @abstractmethod
    def effect(
        self, time: Scalar, positions: tuple, speeds: tuple, states: tuple
    ) -> CoordinateEffect:
        """What the load does at an instant.

        Args:
            time: time [s].
            positions: coordinates [rad; m for a sliding joint], child against parent, a tuple in
                the order of `coordinates`.
            speeds: their speeds [rad/s; m/s for a sliding joint], a tuple.
            states: values of the load's states, a tuple in the order of `states`.

        Returns:
            forces, rates of the states, energy and powers, a `CoordinateEffect`.
        """

    def reads_position(self) -> bool:
        """Whether it depends on the coordinates, not only on their speeds; it does unless
        overridden."""
        return True

    def inertia_along(self) -> Scalar | None:
        """Inertia [kg m^2] that moves with its only coordinate and with nothing else; None unless
        overridden. Only a joint that the tree carries can have some."""
        return None

    def of_bodies(self, bodies: Mapping[str, Any]) -> "AbstractStateLoad":
        """The load with numbers of the mechanism's bodies; itself unless overridden.

        Args:
            bodies: dictionary of the bodies by name.
        """
        return self

    def resistance(self) -> Sequence[tuple[Scalar, Scalar]]:
        """Stiffness [N m/rad, N/m] and damping [N m s/rad, N s/m] of each of its coordinates, where
        it is a linear spring on each that `ImplicitStep` need not resolve; none unless
        overridden."""
        return ()

    def sampled_every(self) -> Scalar | None:
        """Period [s] with which `sampled` sets its states, at its whole multiples; None: never, as
        unless overridden."""
        return None

    def sampled(self, time: Scalar, positions: tuple, speeds: tuple, states: tuple) -> tuple:
        """States from a sampling instant on; their rates are 0 between sampling instants.

        Unless overridden, states are left as they are.

        Args:
            time: time [s].
            positions: coordinates [rad; m for a sliding joint], a tuple in the order of
                `coordinates`.
            speeds: their speeds [rad/s; m/s for a sliding joint], a tuple.
            states: values of the states before the instant, a tuple.

        Returns:
            values of the states after it, a tuple.
        """
        return states

    def motor_of(self) -> str | None:
        """The joint on whose motor it acts where there is one; None, as unless overridden: it asks
        for none."""
        return None

    def needs_motor(self) -> bool:
        """Whether there must be one; not unless overridden."""
        return False

    def behind(self, motors: dict[str, MotorEnd]) -> "AbstractStateLoad":
        """The load in a mechanism whose couplings turn joints by motors; the same unless
        overridden.

        Args:
            motors: a dict of `MotorEnd` by the name of the joint.

        Returns:
            the load that acts there.
        """
        return self

    def sides(self) -> tuple[Side, ...]:
        """The sides at which it stops its only coordinate, none unless overridden: `MoreauJean` and
        `NonColliding` take them as rigid, and do not ask for its `effect`."""
        return ()

    def dry_friction(self) -> Scalar | Callable | None:
        """The friction [N m, N] with which it holds its only coordinate or resists it, a number or
        a function of time, None unless overridden: `MoreauJean` and `NonColliding` take it as
        set-valued, and do not ask for its `effect`."""
        return None

    def smooth_force(
        self, time: Scalar, position: Scalar, speed: Scalar
    ) -> tuple[Any, Any, Any, Any]:
        """What a load with `sides` or `dry_friction` does beside these; nothing unless overridden.
        Integrators that find the force of these themselves ask for it in place of `effect`.

        Args:
            time: time [s].
            position: its only coordinate [rad; m for a sliding joint].
            speed: speed of the coordinate [rad/s; m/s for a sliding joint].

        Returns:
            generalised force [N m, N], stored energy [J], dissipated power [W], external power [W].
        """
        return 0, 0, 0, 0

    def needs_inertia(self) -> bool:
        """Whether numbers of it follow from the inertia along its only coordinate where a run
        starts; not unless overridden."""
        return False

    def for_inertia(self, inertia: Scalar, delay: Scalar, times: Any) -> "AbstractStateLoad":
        """The load with the numbers that follow from the inertia; the same unless overridden.

        Args:
            inertia: inertia along the load's only coordinate where a run starts [kg m^2; kg for a
                sliding joint].
            delay: time that steps resolve [s].
            times: saving times of the run [s], an array (n,).

        Returns:
            the load with these numbers.
        """
        return self

    def pressed_by(self) -> str | None:
        """The load on a coordinate, or the coupling, by whose force it is pressed; None, as unless
        overridden: by none."""
        return None

    def under(self, force: Scalar) -> "AbstractStateLoad":
        """The load while the load or coupling that presses it gives a force; the same unless
        overridden.

        Args:
            force: that force [N m, N].

        Returns:
            the load under it.
        """
        return self


class JointMotion(NamedTuple):
    """Motion of a joint at an instant, in the axes of the parent's marker; in a joint with
    clearance the child's marker is the journal's, the parent's the bearing's.

    Args:
        pose: pose of the child's marker in the parent's, a `Pose` (rotation, translation [m]).
        velocity: velocity of the child's marker as seen from the parent's [m/s].
        spin: angular velocity as seen from there [rad/s].
    """

    pose: Pose
    velocity: sp.Vec
    spin: sp.Vec


class JointEffect(NamedTuple):
    """Force of a load in a joint at an instant, in the axes of the parent's marker.

    Args:
        force: force on the child [N]; its opposite acts on the parent.
        torque: torque on the child about its marker [N m].
        rates: rates of its states, a tuple in their order.
        stored: energy stored in it [J].
        dissipated: power lost in it [W]; None: all that force and torque take from the motion.
        external: power that enters the mechanism through it [W].
    """

    force: sp.Vec
    torque: sp.Vec = sp.ZERO
    rates: tuple = ()
    stored: Any = 0
    dissipated: Any = None
    external: Any = 0


class AbstractJointLoad(AbstractStateLoad):
    """Acts between the two parts of a joint by their relative pose and motion: a film in the gap of
    a bearing, a seal, a bushing.

    The joint is any connection, ideal or with clearance, of the tree or closing a loop.
    `run.contact` and `run.reaction` of the joint contain the load; `run.reaction` by the load's
    name is the load alone. Every integrator takes its force at an instant: it has no law over a
    step, so steps resolve its stiffness and damping.

    Args:
        connection: name of the joint.
    """

    connection: eqx.AbstractVar[str]

    @abstractmethod
    def act(self, time: Scalar, motion: JointMotion, states: tuple) -> JointEffect:
        """Force of the load at an instant.

        Args:
            time: time [s].
            motion: motion of the joint, a `JointMotion`.
            states: values of its states, a tuple in their order.

        Returns:
            a `JointEffect`.
        """

    def states(self):
        return ()

    def coordinates(self):
        return ()

    def effect(self, time, positions, speeds, states):
        (motion,) = positions
        effect = self.act(time, motion, states)
        loss = effect.dissipated
        if loss is None:
            taken = sp.dot(effect.force, motion.velocity), sp.dot(effect.torque, motion.spin)
            loss = sp.neg(sp.add(*taken))
        wrench = (tuple(effect.force), tuple(effect.torque))
        return CoordinateEffect(wrench, effect.rates, effect.stored, loss, effect.external)


def acts_on_coordinates(load: AbstractLoad) -> bool:
    """Whether it is a load on coordinates of joints or motors."""
    return isinstance(load, AbstractStateLoad) and not isinstance(load, AbstractJointLoad)


class AbstractCoordinateLoad(AbstractStateLoad):
    """Acts on the single coordinate of a joint or of a motor by its position and speed alone: the
    simple case of `AbstractStateLoad`.

    The coordinate is an angle or a displacement, child against parent.
    """

    connection: eqx.AbstractVar[str]

    @abstractmethod
    def force(self, time: Scalar, position: Scalar, speed: Scalar) -> tuple[Any, Any, Any, Any]:
        """Force and energies at an instant.

        Args:
            time: time [s].
            position: coordinate [rad; m for a sliding joint], child against parent.
            speed: its speed [rad/s; m/s for a sliding joint].

        Returns:
            generalised force [N m; N for a sliding joint], stored energy [J], dissipated power [W],
            external power [W].
        """

    def coordinates(self):
        return (self.connection,)

    def states(self):
        return ()

    def effect(self, time, positions, speeds, states):
        force, *energies = self.force(time, positions[0], speeds[0])
        return CoordinateEffect((force,), (), *energies)
