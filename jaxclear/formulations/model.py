"""The mechanism as a formulation works on it during a saving interval, and a saved state made ready
to be read.

Worn surfaces enter the gaps as they were at the last saving time: wear is slow, the motion is fast.
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from jaxclear.ground.grouping import unstacked
from jaxclear.ground.pose import Pose
from jaxclear.multibody import kinematics
from jaxclear.multibody.contact_point import JointReport
from jaxclear.multibody.damped_stops import forces_at
from jaxclear.multibody.forces import Forces
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.state import Followed, Layout, unpack_followed
from jaxclear.multibody.system import System, with_worn_flanks
from jaxclear.multibody.tree import Motion

State = Float[Array, " n"]


class Model(eqx.Module):
    """Equations of motion without the time and the state.

    Args:
        system: the prepared mechanism, a `System`.
        worn: worn surfaces as the gaps read them, a dict by joint of dicts by surface.
        stabilisation: `Baumgarte` for closed loops, or None.
        layout: where everything is in the state, a `Layout`.
        projects: whether loops are closed anew after every step.
        events: number of touches and releases of each contact that are kept between two saving
            times.
        discrete: whether derivatives are those of the steps, not of the motion.
    """

    system: System
    worn: dict[str, dict[str, Any]]
    stabilisation: Baumgarte | None
    layout: Layout = eqx.field(static=True)
    projects: bool = eqx.field(static=True, default=False)
    events: int = eqx.field(static=True, default=0)
    discrete: bool = eqx.field(static=True, default=False)

    def entries(self, state: State) -> list:
        """The numbers of a state, one by one.

        Args:
            state: a state, an array (n,).

        Returns:
            a list of n numbers.
        """
        return unstacked(state)

    def seeing(self, worn: dict[str, dict[str, Any]]) -> "Model":
        """The same model with other worn surfaces, and plays as worn.

        Args:
            worn: worn surfaces as the gaps read them, a dict by joint of dicts by surface.

        Returns:
            a `Model`.
        """
        system = with_worn_flanks(self.system, worn)
        return dataclasses.replace(self, worn=worn, system=system)


class Instant(NamedTuple):
    """A saved state that is ready to be read.

    Args:
        model: the mechanism, a `Model`.
        motions: motion of each link, a tuple.
        q: coordinates of each link [m, rad], a tuple.
        v: speeds of each link [m/s, rad/s], a tuple.
        time: time [s].
        entries: the numbers of the state, a list.
        means: components of forces that are no functions of the state [N, N m], as means over the
            saving interval that ends here, a list in the order of `layout.impulses`.
    """

    model: Model
    motions: tuple[Motion, ...]
    q: tuple
    v: tuple
    time: Any
    entries: list
    means: list

    @property
    def followed(self) -> Followed:
        """What the state follows beside the motion."""
        return unpack_followed(self.model.layout, self.entries)

    def means_of(self, name: str) -> list:
        """The means that belong to a joint.

        Args:
            name: name of the joint.

        Returns:
            components [N, N m], a list.
        """
        return self.means[self.model.layout.impulses_of(name)]

    def forces(self, reports: dict[str, JointReport]) -> Forces:
        """Everything that acts, with the clearance joints as reported.

        Args:
            reports: a dict of `JointReport` by name.

        Returns:
            a `Forces`.
        """
        return forces_at(self.model.system, self.motions, reports, self.time, self.followed)

    def pose(self, name: str) -> Pose:
        """Pose of a clearance joint's journal in its bearing.

        Args:
            name: name of the joint.

        Returns:
            a `Pose`.
        """
        closure = self.model.system.bearings[name].closure
        return kinematics.relative_motion(closure, self.motions)[1]
