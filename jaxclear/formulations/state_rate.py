"""From a state and a time to the rate of every entry of the state, in the state's order."""

from typing import Any

from jaxclear.ground import sparse as sp
from jaxclear.multibody import dynamics, energy, kinematics
from jaxclear.multibody.contact_point import JointReport
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import Forces, applied_forces, contact_reports
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.state import Layout, pack_memories, unpack_memories, unpack_motion
from jaxclear.multibody.system import System


def reports_at(
    system: System, layout: Layout, worn: dict, time: Any, entries: Any
) -> dict[str, JointReport]:
    """Report of every clearance joint, without the equations of motion."""
    motions = kinematics.link_motions(system, *unpack_motion(system, entries), time)
    return contact_reports(system, motions, unpack_memories(layout, entries), worn)


def evaluate(
    system: System,
    layout: Layout,
    stabilisation: Baumgarte | None,
    worn: dict,
    time: Any,
    entries: Any,
) -> tuple[list, dict[str, JointReport]]:
    """Rate of every entry of the state as a list of scalars, and the reports of the clearance
    joints.
    """
    q, v = unpack_motion(system, entries)
    motions = kinematics.link_motions(system, q, v, time)
    reports = contact_reports(system, motions, unpack_memories(layout, entries), worn)
    forces = applied_forces(system, motions, reports, q, v, time)
    solution = dynamics.forward_dynamics(system, forces, stabilisation)
    rates = [
        *coordinate_rates(system, q, v),
        *(a for accelerations in solution.accelerations for a in accelerations),
        *pack_memories(layout, {name: report.memory_rates for name, report in reports.items()}),
        *passive_rates(system, layout, forces, solution),
    ]
    return rates, reports


def coordinate_rates(system: System, q: tuple, v: tuple) -> list:
    """Rates of the coordinates of all links, as the joints give them."""
    out: list[Any] = []
    for link, own_q, own_v in zip(system.links, q, v, strict=True):
        if own_q:
            out.extend(link.joint.rate(own_q, own_v))
    return out


def passive_rates(system: System, layout: Layout, forces: Forces, solution: Solution) -> list:
    """Rates of what only follows the motion: worn volumes with their locations, and energies."""
    out: list[Any] = []
    for slot in layout.wear:
        contact_laws = system.bearings[slot.bearing].contact_laws
        order = [k for k, pairing in enumerate(contact_laws) if pairing.wears].index(slot.contact)
        volume, features = forces.reports[slot.bearing].wear_rates[slot.surface][order]
        out.append(volume)
        out.extend(sp.mul(volume, features[i]) for i in slot.averaged)
    if layout.energies:
        out.extend(energy.powers(system, forces, solution))
    return out
