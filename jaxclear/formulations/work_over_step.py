r"""Rates of the energies over a semi-implicit step: its forces, taken once at its start, work over
the mean of the speeds before and after.

$M (v_1 - v_0) = h f$ gives $T_1 - T_0 = h f \cdot (v_0 + v_1) / 2$. Power taken with $v_0$ instead
lags half a step, and because a contact's force changes the very speed that it works over, every
impact would seem to store energy that nothing gives back.
"""

from typing import Any

from jaxclear.formulations.joint_friction import friction_losses, rubbing
from jaxclear.formulations.model import Model
from jaxclear.formulations.permanent_reactions import slips_of, touching
from jaxclear.ground import sparse as sp
from jaxclear.multibody import contact_point, kinematics
from jaxclear.multibody.forces import applied_forces, contact_reports
from jaxclear.multibody.state import unpack_angles, unpack_memories, unpack_motion


def energy_rates(model: Model, time: Any, entries: list, mean: list) -> list:
    """Rates [W] of the energies of the balance but its input, in the order of `state.ENERGIES`: of
    the forces at a state's `entries`, over the `mean` speeds of the step that begins there."""
    system, layout = model.system, model.layout
    memories = unpack_memories(layout, entries)
    coordinates, angles = entries[: layout.coordinates], unpack_angles(layout, entries)

    def at(speeds):
        q, v = unpack_motion(system, [*coordinates, *speeds])
        motions = kinematics.link_motions(system, q, v, time)
        reports = contact_reports(system, motions, memories, model.worn)
        return applied_forces(system, motions, reports, q, v, time, angles)

    start = at(entries[layout.coordinates : layout.memory_start])
    middle = at(mean)
    work, loss, rubbed = 0, 0, 0
    for name, bearing in system.bearings.items():
        report = start.reports[name]
        relative = kinematics.relative_motion(bearing.closure, middle.motions)[2]
        given = sp.add(
            sp.dot(report.force, relative.velocity), sp.dot(report.torque, relative.spin)
        )
        pressed, damped = 0, 0
        pose = kinematics.relative_motion(bearing.closure, start.motions)[1]
        own_laws = contact_point.laws_at(
            bearing.joint, bearing.contact_laws, pose, model.worn.get(name, {})
        )
        points = zip(own_laws, report.points, middle.reports[name].points, strict=True)
        for laws, begun, moved in points:
            elastic = laws.contact.elastic_force(begun.indentation)
            pressed = sp.add(pressed, begun.normal_force * moved.rate)
            damped = sp.add(damped, (begun.normal_force - elastic) * moved.rate)
        work, loss = sp.add(work, pressed), sp.add(loss, damped)
        rubbed = sp.sub(rubbed, sp.add(given, pressed))
    held = touching(system)
    if held:
        q, _ = unpack_motion(system, entries)
        begun = rubbing(model, start, q, entries[layout.coordinates : layout.memory_start])
        slips = [
            sp.mul(one.joint.arm, slip.at(mean))
            for one in held
            for slip in slips_of(system, start.motions, one, mean)
        ]
        rubbed = sp.add(rubbed, friction_losses(held, begun.friction, slips)[0])
    # What a damper takes is of second degree: the mean is right to the square of the change.
    damping = sp.mul(0.5, sp.add(start.damping_loss, middle.damping_loss))
    return [work, loss, rubbed, damping]
