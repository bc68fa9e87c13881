"""Reports of the clearance joints for contact forces that a step has found, or a saved state holds
as impulses: what wears, what is lost, and the wrench on the journal."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxclear.components.clearance import ContactLaws
from jaxclear.formulations.contact_rows import ContactPoint, by_joint, contact_points, split
from jaxclear.formulations.model import Instant
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.ground.pose import Pose
from jaxclear.laws.contact import Rigid
from jaxclear.multibody import contact_point
from jaxclear.multibody.contact_point import GapFunction, JointReport, PointState, Response
from jaxclear.multibody.kinematics import along
from jaxclear.multibody.state import component_count
from jaxclear.multibody.system import System

# Indentation [m] at which the extent of a contact is read that no law tells: its wear needs some.
TOUCHING = 1e-9


class ActingContact(NamedTuple):
    """A contact with the forces that act in it: normal [N], pushing apart, and friction [N] on the
    journal along each sliding direction, at the rates of its rows; `slid`: speed [m/s] with which
    it wears, where that is not the slip's."""

    laws: ContactLaws
    gap_function: GapFunction
    rates: tuple
    normal: Any
    tractions: tuple
    memory: PointState = PointState(None, ())
    slid: Any = None


def joint_reports(
    system: System, poses: dict[str, Pose], contacts: list[ActingContact]
) -> dict[str, JointReport]:
    """Reports of the clearance joints."""
    reports = {}
    for (name, bearing), own in zip(
        system.bearings.items(), by_joint(system, contacts), strict=True
    ):
        speeds, responses = [], []
        for contact in own:
            slip = tuple(contact.rates[1:])
            speeds.append((contact.rates[0], slip))
            speed = contact_point.slip_speed(slip) if contact.slid is None else contact.slid
            responses.append(Response(contact.normal, speed, contact.tractions, contact.memory))
        reports[name] = contact_point.assemble(
            bearing.joint,
            tuple(contact.laws for contact in own),
            poses[name],
            tuple(contact.gap_function for contact in own),
            tuple(speeds),
            tuple(responses),
        )
    return reports


def rigid_reports(
    system: System,
    poses: dict[str, Pose],
    contacts: tuple[ContactPoint, ...],
    forces: list[tuple],
    change: list | None = None,
) -> dict[str, JointReport]:
    """Reports for given forces (normal, then friction along each slip direction) of contacts
    without stiffness, at their rates with the speeds changed by `change`."""
    acting = []
    for contact, force in zip(contacts, forces, strict=True):
        rates = contact.rates
        if change is not None:
            rates = tuple(
                sp.add(rate, along(row, change))
                for rate, row in zip(rates, contact.rows, strict=True)
            )
        depth = jnp.maximum(contact.gap_function.indentation, _pressed(contact.laws, force[0]))
        acting.append(
            ActingContact(
                contact.laws._replace(contact=Rigid()),
                contact.gap_function._replace(indentation=depth),
                rates,
                force[0],
                tuple(force[1:]),
            )
        )
    reports = joint_reports(system, poses, acting)
    indentations = [contact.gap_function.indentation for contact in contacts]
    for name, own in zip(system.bearings, by_joint(system, indentations), strict=True):
        points = tuple(
            point._replace(indentation=depth)
            for point, depth in zip(reports[name].points, own, strict=True)
        )
        reports[name] = reports[name]._replace(points=points)
    return reports


def _pressed(laws: ContactLaws, force: Any) -> Any:
    """Indentation [m] at which the extent of a contact under a normal force [N] is read: its law's,
    where it has one."""
    if not laws.wears:
        return TOUCHING
    return jnp.maximum(laws.indentation_under(positive_part(force)), TOUCHING)


def reports_of_means(instant: Instant) -> dict[str, JointReport]:
    """Reports at a saved instant whose state holds the impulses of every contact: normal, then one
    for each slip direction where it rubs (`state.contact_components`)."""
    poses, contacts = contact_points(instant.model, instant.motions)
    counts = [component_count(c.laws, c.gap_function.candidate) for c in contacts]
    forces = split(instant.means, counts)
    return rigid_reports(instant.model.system, poses, contacts, forces)
