"""What acts on the coordinates of joints and motors: what it is asked, and what it answers."""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx

from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity


class AbstractLoad(AbstractQuantified):
    """A load on bodies, or on the coordinate of a joint."""

    def springs_back(self) -> bool:
        """Whether what it acts on may swing by it, as by a spring; it may unless overridden."""
        return True


class LoadState(NamedTuple):
    """A state of a load: its `name`, `unit`, the number with which a run begins, and the size
    `most` at which it stands still (None: it has none): steps end within it."""

    name: str
    unit: str = "1"
    start: Any = 0.0
    most: Any = None


class CoordinateEffect(NamedTuple):
    """What a load on coordinates does at one instant: the generalised force [N m, N] on each, the
    rate of each of its states; energy in J, powers in W, `external` power enters the mechanism."""

    forces: tuple
    rates: tuple
    stored: Any
    dissipated: Any
    external: Any


class Side(NamedTuple):
    """One side of a `stop` (a `JointStop`): the coordinate is held where `sign` times it is above
    `sign` times the `place` [rad, m]."""

    sign: float
    place: Any
    stop: Any

    def beyond(self, position: Any) -> Any:
        """How far the coordinate is beyond it [rad, m]."""
        return self.sign * (self.place - position)


class MotorEnd(AbstractQuantified):
    """The motor behind a joint: its `coordinate`, which is `ratio` times that of the joint and an
    `offset` (None: 0) where nothing lies between."""

    coordinate: str = eqx.field(static=True)
    ratio: Scalar = quantity(unit="1", meaning="turns of the motor for one of the joint")
    offset: Scalar | None = quantity(None, "rad", "angle of the motor where the joint's is 0")


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
        """What it does at an instant, from the coordinates [rad, m] and their speeds, child against
        parent, in the order of `coordinates`, and its states."""

    def reads_position(self) -> bool:
        """Whether it depends on the coordinates, not only on their speeds; it does unless
        overridden."""
        return True

    def springs_back(self) -> bool:
        return self.reads_position()

    def inertia_along(self) -> Scalar | None:
        """Inertia [kg m^2] that moves with its only coordinate and with nothing else; None unless
        overridden. Only a joint that the tree carries can have some."""
        return None

    def resistance(self) -> list[tuple[Scalar, Scalar]] | None:
        """Stiffness [N m/rad, N/m] and damping [N m s/rad, N s/m] of each of its coordinates, where
        it is a linear spring on each that `ImplicitStep` shall not have to resolve; None unless
        overridden."""
        return None

    def sampled_every(self) -> Scalar | None:
        """Period [s] with which `sampled` sets its states, at its whole multiples; None: never, as
        unless overridden."""
        return None

    def sampled(self, time: Scalar, positions: tuple, speeds: tuple, states: tuple) -> tuple:
        """Its states from an instant of its period on; their rates are 0 in between. As they are
        unless overridden."""
        return states

    def motor_of(self) -> str | None:
        """The joint on whose motor it acts where there is one; None, as unless overridden: it asks
        for none."""
        return None

    def needs_motor(self) -> bool:
        """Whether there must be one; not unless overridden."""
        return False

    def behind(self, motors: dict[str, MotorEnd]) -> "AbstractStateLoad":
        """Itself where couplings turn joints, by name, by these motors; the same unless
        overridden."""
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

    def needs_inertia(self) -> bool:
        """Whether numbers of it follow from the inertia along its only coordinate where a run
        starts; not unless overridden."""
        return False

    def for_inertia(self, inertia: Scalar, delay: Scalar, times: Any) -> "AbstractStateLoad":
        """Itself with these numbers, for an inertia [kg m^2, kg], a `delay` [s] that steps resolve
        and the saving times [s] of the run; the same unless overridden."""
        return self

    def pressed_by(self) -> str | None:
        """The load on a coordinate, or the coupling, by whose force it is pressed; None, as unless
        overridden: by none."""
        return None

    def under(self, force: Scalar) -> "AbstractStateLoad":
        """Itself as it is where that one gives this force [N m, N]; the same unless overridden."""
        return self


class AbstractCoordinateLoad(AbstractStateLoad):
    """Acts on the single coordinate of a joint, child against parent, an angle or a displacement,
    or of a motor, by its position and speed alone: the simple case of `AbstractStateLoad`.
    """

    connection: eqx.AbstractVar[str]

    @abstractmethod
    def force(self, time: Scalar, position: Scalar, speed: Scalar) -> tuple[Any, Any, Any, Any]:
        """(generalised force, stored energy, dissipated power, external power)."""

    def coordinates(self):
        return (self.connection,)

    def states(self):
        return ()

    def effect(self, time, positions, speeds, states):
        force, *energies = self.force(time, positions[0], speeds[0])
        return CoordinateEffect((force,), (), *energies)
