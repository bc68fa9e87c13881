"""Rates of what only follows the motion: coordinates from speeds, worn volumes and energies from
forces."""

from typing import Any, NamedTuple

from jaxclear.ground import sparse as sp
from jaxclear.ground.compiling import map_many
from jaxclear.multibody import dynamics
from jaxclear.multibody.closure_coordinates import angle_rates
from jaxclear.multibody.dynamics import Solution
from jaxclear.multibody.forces import Forces, read_coordinate
from jaxclear.multibody.state import Layout, unpack_motion
from jaxclear.multibody.system import System, flanks_that_wear


class Passive(NamedTuple):
    """What ideal joints that rub add: rates of their worn volumes with their locations, power [W]
    lost to their friction, what drives give of it, and how hard each presses [N]."""

    worn: Any = ()
    loss: Any = 0
    driven: Any = 0
    pressing: Any = ()


def coordinate_rates(system: System, q: tuple, v: tuple) -> list:
    """Rates of the coordinates of all links, scalars.

    Args:
        system: with the joints.
        q, v: coordinates and speeds, a tuple for each link.
    """
    rate = lambda joint, q, v: tuple(joint.rate(q, v))
    each = zip(system.links, q, v, strict=True)
    part = map_many(rate, [(link.joint, q, v) for link, q, v in each if q])
    return [x for rates in part for x in rates]


def drift(system: System, start: list, at: list, speeds: list, h: Any) -> list:
    """Coordinates after a time at constant rates.

    Args:
        system: with the joints.
        start: coordinates, scalars.
        at: coordinates at which rates are taken.
        speeds: scalars.
        h: time [s].
    """
    rates = coordinate_rates(system, *unpack_motion(system, [*at, *speeds]))
    return sp.each(lambda x, rate: x + h * rate, start, rates)


def followed_rates(system: System, layout: Layout, forces: Forces) -> list:
    """Rates of the angles that the state follows, and of states of loads and flanks.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        layout: whose order the result has.
        forces: with rates of states, by load or coupling.
    """
    owners = dict.fromkeys(owner for owner, _ in layout.states)
    states = (rate for owner in owners for rate in forces.state_rates[owner])
    return [*angle_rates(system, layout, forces.motions), *states]


def passive_rates(
    system: System,
    layout: Layout,
    forces: Forces,
    solution: Solution,
    rubbing: Passive = Passive(),
    pressing: Any = (),
) -> list:
    """Rates of entries that only follow the motion, in the layout's order.

    These are angles over whole turns, states of loads and flanks, worn volumes with their
    locations, impulses and energies.

    Args:
        system: prepared mechanism, as `prepare` returns it.
        layout: of the state array.
        forces: with contact reports.
        solution: accelerations and multipliers under these forces.
        rubbing: wear and losses of ideal joints that rub.
        pressing: forces whose impulses the state counts [N, N m].
    """
    out: list[Any] = followed_rates(system, layout, forces)
    for slot in layout.wear:
        if slot.bearing not in system.bearings:
            continue
        contact_laws = system.bearings[slot.bearing].contact_laws
        order = [k for k, pairing in enumerate(contact_laws) if pairing.wears].index(slot.contact)
        volume, features = forces.reports[slot.bearing].wear_rates[slot.surface][order]
        out.append(volume)
        out.extend(sp.mul(volume, features[i]) for i in slot.averaged)
    out.extend((*rubbing.worn, *_wear_of_flanks(system, forces), *pressing, *rubbing.pressing))
    if layout.energies:
        powers = dict(zip(layout.energies, dynamics.powers(system, forces, solution), strict=True))
        powers["input"] = sp.add(powers["input"], rubbing.driven)
        powers["friction_loss"] = sp.add(powers["friction_loss"], rubbing.loss)
        out.extend(powers.values())
    return out


def _wear_of_flanks(system: System, forces: Forces) -> list:
    """Rates of the worn volumes of flanks of play."""
    result = []
    for name, play in flanks_that_wear(system).items():
        slides: Any = system.transmissions[name].slides
        speed = read_coordinate(system, forces.motions, slides, forces.followed).speed
        result += [play.wear_rate(torque, speed) for torque in forces.pressing[name].torques]
    return result


def link_accelerations(system: System, flat: Any, multipliers: tuple) -> Solution:
    """Free accelerations as those of the links.

    Args:
        system: with the branches.
        flat: accelerations, one after the other.
        multipliers: of the constraint rows.
    """
    part = tuple(tuple(flat[branch.speeds]) for branch in system.topology.branches)
    return Solution(part, multipliers)
