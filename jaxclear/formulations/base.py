"""What a formulation is: how contact enters the equations of motion.

A formulation says what it asks of the laws, how it sees the mechanism, which impulses its states
hold, and what forces and contacts a saved state tells of. How it steps is between it and the
integrators that hold it. A new one is one file: the formulation and its integrator.
"""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx

from jaxclear.components.clearance import CarryingEnd
from jaxclear.components.coupling import AbstractCoupling
from jaxclear.formulations.model import Instant, Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.module import AbstractModule
from jaxclear.ground.quantity import concrete
from jaxclear.multibody.forces import Forces
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.rows import wrench_in_joint
from jaxclear.multibody.state import lay_out
from jaxclear.multibody.system import System, prepare


class ContactReport(NamedTuple):
    """A joint with contacts at an instant, in the axes of its bearing (the parent's marker).

    Args:
        offset: vector from the bearing's centre to the journal's [m].
        axis: the journal's z axis [1].
        indentation: indentation of each contact [m], positive in contact, a tuple.
        normal_force: normal force of each contact [N], a tuple.
        slip_speed: sliding speed of each contact [m/s], a tuple.
        traction: size of the friction force of each contact [N], a tuple.
        place: place of touch of each contact [m], a tuple.
        force: force on the journal (the child), of its contacts and of loads in the joint [N].
        torque: their torque on the journal about its marker [N m].
        ends: where the gap carries, of a joint that always touches, a tuple of `CarryingEnd`.
    """

    offset: Any
    axis: Any
    indentation: Any
    normal_force: Any
    slip_speed: Any
    traction: Any
    place: Any
    force: Any
    torque: Any
    ends: tuple[CarryingEnd, ...] = ()


class AbstractFormulation(AbstractModule):
    """How contact enters the equations of motion. An integrator holds one.

    Class attribute of a member: `forces_are_means`, whether the forces of contacts are no functions
    of the state; states then hold the impulses of all their components, and what is reported are
    means over the saving intervals.
    """

    forces_are_means: eqx.AbstractClassVar[bool]

    @property
    def rubs_as_coulombs(self) -> bool:
        """Whether of every friction law Coulomb's with its coefficients is taken."""
        return False

    @abstractmethod
    def check(self, mechanism: Mechanism, integrator: str) -> None:
        """Refuse a mechanism with a law that cannot serve this formulation.

        Args:
            mechanism: the mechanism.
            integrator: name of the integrator, a text for the sentence.

        Raises:
            ValueError: with a sentence that names the joint, load or coupling.
        """

    @abstractmethod
    def modelled(self, mechanism: Mechanism) -> Mechanism:
        """The mechanism as it is in this formulation, with other joints for example.

        Args:
            mechanism: the mechanism.

        Returns:
            the mechanism that is simulated.
        """

    def prepared(self, system: System) -> System:
        """The system as its steps take it, with other loads for example; unchanged unless
        overridden.

        Args:
            system: the prepared mechanism, a `System`.

        Returns:
            a `System`.
        """
        return system

    @abstractmethod
    def impulses(self, system: System) -> tuple[tuple[str, int], ...]:
        """Joints whose impulses since the start the state holds [N s, N m s].

        Args:
            system: the prepared mechanism, a `System`.

        Returns:
            a tuple of (name of the joint, number of components).
        """

    @abstractmethod
    def normal_impulses(self, system: System, name: str) -> tuple[int, ...]:
        """Which of a joint's components of `impulses` belong to normal forces; their sum is that of
        all its contacts.

        Args:
            system: the prepared mechanism, a `System`.
            name: name of the joint.

        Returns:
            indices of the components, a tuple.
        """

    @abstractmethod
    def contact_joints(self, mechanism: Mechanism) -> tuple[str, ...]:
        """Joints whose contacts are reported.

        Args:
            mechanism: the mechanism.

        Returns:
            names of the joints, a tuple.
        """

    @abstractmethod
    def forces(self, instant: Instant) -> Forces:
        """Everything that acts at a saved instant.

        Args:
            instant: the saved state, an `Instant`.

        Returns:
            forces and reports of joints, a `Forces`.
        """

    @abstractmethod
    def contact(self, instant: Instant, name: str) -> ContactReport:
        """The contacts of a joint at a saved instant.

        Args:
            instant: the saved state, an `Instant`.
            name: name of the joint.

        Returns:
            a `ContactReport`.
        """


def clearance_contact(instant: Instant, forces: Forces, name: str) -> ContactReport:
    """The contacts of a clearance joint, from everything that acts.

    Args:
        instant: the saved state, an `Instant`.
        forces: what acts there, a `Forces`.
        name: name of the joint.

    Returns:
        a `ContactReport`.
    """
    pose, points = instant.pose(name), forces.reports[name].points
    return ContactReport(
        pose.translation,
        sp.transpose(pose.rotation)[2],
        tuple(point.indentation for point in points),
        tuple(point.normal_force for point in points),
        tuple(point.slip_speed for point in points),
        tuple(point.traction for point in points),
        tuple(point.place for point in points),
        *wrench_in_joint(forces.rows, name),
    )


def check_play(mechanism: Mechanism, integrator: str, rigid: bool) -> None:
    """Raises `ValueError` for a coupling whose play the formulation cannot model.

    Args:
        mechanism: with its couplings.
        integrator: name in the message.
        rigid: whether flanks may be rigid; those with a restitution then need no stiffness.
    """
    for name, coupling in mechanism.couplings.items():
        if coupling.play is None:
            continue
        if rigid or coupling.play.in_contact:
            check_unworn(name, coupling, integrator)
        if rigid and coupling.play.restitution is not None:
            check_lossless(name, coupling, f"{integrator} takes the flanks of its play as rigid")
            continue
        kind = f'coupling "{name}" is a {type(coupling).__name__} with play'
        law = type(coupling.play.law).__name__
        if coupling.stiffness is None:
            raise ValueError(
                f"{kind} and without stiffness; for {integrator} give that of its shaft or teeth, "
                "from which its flanks press"
                + (", or the restitution of rigid ones." if rigid else ".")
            )
        if coupling.play.law.needs_damping and (
            coupling.damping is None or concrete(coupling.damping) == 0
        ):
            raise ValueError(
                f"{kind} by flank.{law}, whose shaft relaxes by its damping, and has none; give "
                "damping, or take flank.Stop."
            )


def check_unworn(name: str, coupling: AbstractCoupling, integrator: str) -> None:
    """Raises `ValueError` for a coupling whose flanks wear.

    Args:
        name: of the coupling.
        coupling: with or without play.
        integrator: name in the message.
    """
    if coupling.play is not None and coupling.play.wear is not None:
        raise ValueError(
            f'the play of coupling "{name}" wears, which {integrator} does not follow on '
            "rigid or seated flanks: take integrator.Adaptive, FixedStep or ImplicitStep and "
            "flanks that are not seated, or leave its wear out."
        )


def check_lossless(name: str, coupling: AbstractCoupling, why: str) -> None:
    """Raises `ValueError` for a coupling that loses power, where its play is between rigid flanks.

    Args:
        name: of the coupling.
        coupling: with play.
        why: clause of the message that says why losses are not modelled.
    """
    if coupling.efficiency is not None or coupling.thread is not None:
        raise ValueError(
            f'coupling "{name}" has play and loses power to friction, and {why}, of which nothing '
            "is lost: take Adaptive, FixedStep or ImplicitStep, or leave play or losses out."
        )


def model_of(
    mechanism: Mechanism, formulation: AbstractFormulation, balance: bool = False
) -> Model:
    """The model of a mechanism whose surfaces are new, in a formulation.

    Args:
        mechanism: the mechanism.
        formulation: the formulation, an `AbstractFormulation`.
        balance: whether the state holds the energies of the balance.

    Returns:
        a `Model`.
    """
    system = formulation.prepared(prepare(mechanism))
    layout = lay_out(system, balance, formulation.impulses(system))
    return Model(system, {}, mechanism.baumgarte, layout, mechanism.projects)
