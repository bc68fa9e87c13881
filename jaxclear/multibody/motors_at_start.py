"""Where motors stand as a run begins of which nothing is told: so that what they drive through play
or stiffness is in the middle of its play and not wound up, and moves along."""

from typing import Any

from jaxtyping import Array, Float

from jaxclear.components.clearance.backlash import middle_of
from jaxclear.multibody import kinematics, transmissions
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import System
from jaxclear.multibody.topology import motors


def with_motors(
    mechanism: Mechanism, system: System, q: Float[Array, " q"], v: Float[Array, " v"], time: Any
) -> tuple[Array, Array]:
    """Coordinates and speeds with those of motors that `start`, `guess` and `speeds` do not give.

    Args:
        mechanism: with what is given.
        system: prepared mechanism, as `prepare` returns it.
        q: coordinates of the tree, shape (coordinates,) [rad, m; 1 for quaternions].
        v: free speeds, shape (speeds,) [rad/s, m/s].
        time: start of the run [s].
    """
    names, start_names = motors(mechanism.couplings), {*mechanism.start, *mechanism.guess}
    free: list[tuple[Any, str]] = [
        (system.topology.branch_of(motor), coupling)
        for motor, coupling in names.items()
        if coupling in system.transmissions
    ]
    if not free:
        return q, v
    place = unpack_motion(system, [*(q[i] for i in range(len(q))), *(v[i] for i in range(len(v)))])
    motions = kinematics.link_motions(system, *place, time)
    for branch, coupling in free:
        giving: Any = system.transmissions[coupling]
        twist = transmissions.twist_of(motions, giving)
        (factor,) = (x.factor for x in giving.closure.reading.terms if x.joint == branch.name)
        share = giving.scale / factor
        play = giving.coupling.play
        if branch.name not in start_names:
            amiss = twist.value - (0 if play is None else middle_of(play))
            q = q.at[branch.coordinates.start].add(-share * amiss)
        if branch.name not in mechanism.speeds:
            v = v.at[branch.speeds.start].add(-share * twist.rate)
    return q, v
