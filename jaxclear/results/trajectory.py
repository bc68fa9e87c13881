"""What a simulation returns: states over time, and by name everything that follows from them.

Poses, contacts, reactions and energies are computed from the saved states when asked for, so a run
pays for none of them.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.components.body import GROUND
from jaxclear.formulations import permanent, rigid
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import quaternion_from_rotation
from jaxclear.integrators.base import COMPLIANT, PERMANENT, RIGID
from jaxclear.integrators.outcome import Outcome
from jaxclear.multibody import constraints, dynamics, energy, kinematics, state
from jaxclear.multibody.contact_point import JointReport
from jaxclear.multibody.forces import Forces, applied_forces, contact_reports
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.system import System, prepare
from jaxclear.native import explain


class BodyHistory(eqx.Module):
    """Motion of a body in the ground frame: `com` place [m] and `velocity` [m/s] of its centre of
    mass, `rotation` its axes in the ground's (time, 3, 3), `spin` angular velocity [rad/s] in
    ground axes, `origin` place of the body frame [m]."""

    com: Float[Array, "time 3"]
    rotation: Float[Array, "time 3 3"]
    velocity: Float[Array, "time 3"]
    spin: Float[Array, "time 3"]
    origin: Float[Array, "time 3"]

    @property
    def quaternion(self) -> np.ndarray:
        """Orientation as unit quaternions, scalar first."""
        return quaternion_from_rotation(np.asarray(self.rotation))


class ContactHistory(eqx.Module):
    """A clearance joint over time, in the bearing's axes (the parent's marker); one column per
    possible contact. SI units.

    `offset` from the bearing's centre to the journal's and `axis`, the journal's z axis; per
    contact the `indentation` (positive in contact), `normal_force`, `slip_speed`, `traction`
    (magnitude of friction) and `place` of touch; `force` and `torque` on the journal (the child),
    about its marker.
    """

    offset: Float[Array, "time 3"]
    axis: Float[Array, "time 3"]
    indentation: Float[Array, "time contacts"]
    normal_force: Float[Array, "time contacts"]
    slip_speed: Float[Array, "time contacts"]
    traction: Float[Array, "time contacts"]
    place: Float[Array, "time contacts 3"]
    force: Float[Array, "time 3"]
    torque: Float[Array, "time 3"]


class ReactionHistory(eqx.Module):
    """Force [N] and torque [N m] that the child receives from the parent at the child's marker, in
    ground axes.
    """

    force: Float[Array, "time 3"]
    torque: Float[Array, "time 3"]


class EnergyHistory(eqx.Module):
    """Energy balance [J]: kinetic + potential + contact_stored + losses = start + input + error."""

    kinetic: Float[Array, " time"]
    potential: Float[Array, " time"]
    contact_stored: Float[Array, " time"]
    contact_loss: Float[Array, " time"]
    friction_loss: Float[Array, " time"]
    damping_loss: Float[Array, " time"]
    input: Float[Array, " time"]
    error: Float[Array, " time"]


class Trajectory(eqx.Module):
    """A simulated run. `states` (time, n) are the raw states; `worn` are depth maps [m] by joint
    and surface at the end, `read` the worn surfaces as the gaps saw them up to each saving time,
    `loops` the verdict on the time loops (`stats` says it in words)."""

    mechanism: Mechanism
    time: Float[Array, " time"]
    states: Float[Array, "time n"]
    worn: dict[str, dict[str, Array]]
    read: dict[str, dict[str, Any]]
    outcome: Array
    ended: Array
    accepted_steps: Array
    rejected_steps: Array
    balanced: bool = eqx.field(static=True)
    formulation: str = eqx.field(static=True, default=COMPLIANT)
    loops: Array | None = None

    @property
    def stats(self) -> dict[str, Any]:
        """What the run took: accepted and rejected steps, and whether its time loops ran as machine
        code, or why not."""
        told = None if self.loops is None else explain(np.max(self.loops))
        steps = {"accepted steps": self.accepted_steps, "rejected steps": self.rejected_steps}
        return {name: np.asarray(count)[()] for name, count in steps.items()} | {"loops": told}

    @property
    def succeeded(self) -> Any:
        """True where the run reached its end."""
        return self.outcome == Outcome.REACHED

    @property
    def result(self) -> str:
        """A sentence: that the run reached its end, or when and why it did not."""
        sentence = Outcome(int(self.outcome)).sentence
        if self.succeeded:
            return sentence
        return f"The run ended early, after {float(self.ended):.6g} s. {sentence}"

    def state_names(self) -> list[str]:
        """Names of the columns of `states`."""
        system = prepare(self.mechanism)
        return state.names(system, layout_of(system, self.balanced, self.formulation))

    def body(self, name: str) -> BodyHistory:
        """Motion of a body."""
        self._known(name, self.mechanism.bodies, "body")
        return _body(self, name)

    def marker(self, body: str, at: Any) -> Float[Array, "time 3"]:
        """Place of a point of a body, given in the body frame [m], in the ground frame over
        time."""
        history = self.body(body)
        return history.origin + jnp.einsum(
            "tij,j->ti", history.rotation, sp.stack(sp.vec3(tuple(at)))
        )

    def contact(self, name: str) -> ContactHistory:
        """Forces and gaps of a clearance joint.

        Where forces are no functions of the state (rigid contact, joints that always touch) they
        are means over the saving intervals, at the start over the first; a joint that always
        touches leans in its gap as its reaction says.
        """
        if self.formulation == PERMANENT:
            from jaxclear.results import permanent_contact

            self._touching(name)
            return permanent_contact.contact(self, name)
        self._known(name, self.mechanism.topology.clearances, "clearance joint")
        return _contact(self, name)

    def situations(self, name: str) -> Int[Array, " time"]:
        """How a joint that always touches carries: 0 not at all, 1 at one point, 2 at two points on
        opposite sides, 3 along a line (two points on one side). Needs a run by
        integrator.NonColliding."""
        from jaxclear.results import permanent_contact

        self._touching(name)
        return permanent_contact.situations(self, name)

    def switchings(self, name: str) -> Any:
        """Instants at which such a joint begins to carry in another way, as a pandas table (time
        [s], from, to).
        """
        from jaxclear.results import permanent_contact

        self._touching(name)
        return permanent_contact.switchings(self, name)

    def reaction(self, name: str) -> ReactionHistory:
        """Force and torque in a connection, ideal or with clearance; friction that is no function
        of the state enters as its mean over the saving interval, as in `contact`."""
        self._known(name, self.mechanism.connections, "connection")
        return _reaction(self, name)

    def coordinate(self, name: str) -> Float[Array, "time q"]:
        """Coordinates of a connection (or floating body) of the tree."""
        return self._columns(name, "coordinates")

    def speed(self, name: str) -> Float[Array, "time v"]:
        """Speeds of a connection (or floating body) of the tree."""
        return self._columns(name, "speeds")

    def _columns(self, name, kind):
        topology = self.mechanism.topology
        floating = [b.body for b in topology.branches if b.connection is None]
        self._known(name, [*self.mechanism.connections, *floating], "connection or floating body")
        for branch in topology.branches:
            if name in (branch.connection, branch.body if branch.connection is None else None):
                place = getattr(branch, kind)
                shift = 0 if kind == "coordinates" else topology.coordinate_count
                return self.states[:, place.start + shift : place.stop + shift]
        raise ValueError(
            f'"{name}" carries no coordinates: it is driven, has clearance, or closes a loop.'
        )

    def worn_volume(self, joint: str, surface: str) -> Float[Array, " time"]:
        """Volume lost by a surface of a joint over time [m3]."""
        self._check_wears(joint, surface)
        layout = layout_of(prepare(self.mechanism), self.balanced, self.formulation)
        slots = [slot for slot in layout.wear if (slot.bearing, slot.surface) == (joint, surface)]
        return sum(self.states[:, slot.start] for slot in slots)

    def worn_depth(self, joint: str, surface: str) -> Float[Array, "around along"]:
        """Wear map of a surface of a joint at the end of the run [m]."""
        self._check_wears(joint, surface)
        return self.worn[joint][surface]

    def _check_wears(self, joint, surface):
        if surface not in self.worn.get(joint, {}):
            wearing = ", ".join(f'"{j}" {s}' for j, surfaces in self.worn.items() for s in surfaces)
            raise ValueError(
                f'surface "{surface}" of joint "{joint}" does not wear; those that do: '
                f"{wearing or 'none'}."
            )

    def drift(self) -> dict[str, Float[Array, " time"]]:
        """Largest residual [m, 1] of each loop closure over time, by the joint that closes the
        loop.
        """
        return _drift(self)

    def energy_balance(self) -> EnergyHistory:
        """Energies over time; needs a run with `balance=True`."""
        if not self.balanced:
            raise ValueError("this run did not track energies; simulate with balance=True.")
        return _energies(self)

    def to_dataset(self) -> Any:
        """Everything as an xarray Dataset with units."""
        from jaxclear.results.dataset import to_dataset

        return to_dataset(self)

    def _touching(self, name):
        from jaxclear.results import permanent_contact

        if self.formulation != PERMANENT:
            raise ValueError(
                f'how joint "{name}" carries is known of joints that always touch: run '
                "integrator.NonColliding."
            )
        self._known(name, permanent_contact.touching(self), "joint that always touches")

    def _known(self, name, names, kind):
        if name not in names or name == GROUND:
            raise ValueError(
                f'no {kind} "{name}" in this mechanism; there are '
                f"{', '.join(map(repr, names)) or 'none'}."
            )


def layout_of(system: System, balanced: bool, formulation: str) -> state.Layout:
    """The layout of the states of a run."""
    counts = {RIGID: state.contact_components, PERMANENT: permanent.impulse_counts}.get(formulation)
    return state.lay_out(system, balanced, () if counts is None else counts(system))


class Instant(NamedTuple):
    """A saved state made ready: everything the histories are computed from. `means`: components of
    forces that are no functions of the state, as means over the saving interval that ends here."""

    system: System
    layout: state.Layout
    motions: tuple
    q: tuple
    v: tuple
    time: Any
    entries: Any
    read: dict
    means: Any

    def reports(self) -> dict[str, JointReport]:
        """Contacts over the surfaces as they were worn at this instant."""
        if self.layout.impulses:
            return rigid.reports_at(
                self.system,
                self.motions,
                self.read,
                [self.means[i] for i in range(len(self.means))],
            )
        return contact_reports(
            self.system, self.motions, state.unpack_memories(self.layout, self.entries), self.read
        )

    def forces(self) -> Forces:
        forces = applied_forces(
            self.system, self.motions, self.reports(), self.q, self.v, self.time
        )
        # Present only in runs of joints that always touch: friction, the last component of each
        # one's mean forces.
        count = len(permanent.touching(self.system))
        if count == 0:
            return forces
        frictions = self.means.reshape(count, permanent.COMPONENTS)[:, -1]
        return permanent.with_friction(self.system, forces, frictions)


def over_time(trajectory: Trajectory, function: Any) -> Any:
    """Maps a function of an `Instant` over the saved states."""
    mechanism = trajectory.mechanism
    system = prepare(mechanism)
    layout = layout_of(system, trajectory.balanced, trajectory.formulation)

    def one(time, entries, read, means):
        q, v = state.unpack_motion(system, entries)
        instant = Instant(
            system,
            layout,
            kinematics.link_motions(system, q, v, time),
            q,
            v,
            time,
            entries,
            read,
            means,
        )
        return sp.dense(function(instant))

    columns = [trajectory.states[:, i] for i in range(layout.size)]
    return jax.vmap(one)(trajectory.time, columns, trajectory.read, mean_forces(trajectory, layout))


def mean_forces(trajectory: Trajectory, layout: state.Layout) -> Float[Array, "time components"]:
    """Impulses gained over each saving interval, divided by its length; at the start those of the
    first interval.
    """
    impulses = trajectory.states[:, layout.impulse_start : layout.energy_start]
    means = jnp.diff(impulses, axis=0) / jnp.diff(trajectory.time)[:, None]
    return jnp.concatenate([means[:1], means])


@eqx.filter_jit
def _body(trajectory, name):
    def one(now):
        index = now.system.topology.index(name)
        link, motion = now.system.links[index], now.motions[index]
        frame = link.frame
        pose = motion.pose.after(frame)
        centre = sp.vec3(trajectory.mechanism.bodies[name].com)
        inner = frame.point(centre)
        velocity = sp.plus(motion.twist.linear, sp.cross(motion.twist.angular, inner))
        rotation = motion.pose.rotation
        return BodyHistory(
            pose.point(centre),
            pose.rotation,
            sp.apply(rotation, velocity),
            sp.apply(rotation, motion.twist.angular),
            pose.translation,
        )

    return _arrays(over_time(trajectory, one))


def _arrays(history):
    """Tuples of columns stacked to arrays with time first."""

    def pack(value):
        if isinstance(value, tuple):
            return jnp.stack([pack(part) for part in value], axis=1)
        return value

    return type(history)(
        **{name: pack(getattr(history, name)) for name in history.__dataclass_fields__}
    )


@eqx.filter_jit
def _contact(trajectory, name):
    def one(now):
        report = now.reports()[name]
        pose = kinematics.relative_motion(now.system.bearings[name].closure, now.motions)[1]
        axis = sp.transpose(pose.rotation)[2]
        points = report.points
        fields = [
            tuple(getattr(p, f) for p in points)
            for f in ("indentation", "normal_force", "slip_speed", "traction")
        ]
        places = tuple(p.place for p in points)
        return ContactHistory(pose.translation, axis, *fields, places, report.force, report.torque)

    return _arrays(over_time(trajectory, one))


@eqx.filter_jit
def _reaction(trajectory, name):
    topology = trajectory.mechanism.topology

    def one(now):
        system, motions, forces = now.system, now.motions, now.forces()
        solution = dynamics.forward_dynamics(system, forces, trajectory.mechanism.baumgarte)
        branch = topology.branch_of(name)
        if branch is not None:
            index = topology.branches.index(branch)
            wrench = dynamics.joint_wrenches(system, forces, solution)[index]
            rotation = motions[index].pose.rotation
            force, torque = sp.apply(rotation, wrench.force), sp.apply(rotation, wrench.torque)
            if branch.reversed:
                force, torque = (tuple(sp.neg(x) for x in part) for part in (force, torque))
            return ReactionHistory(force, torque)
        if name in topology.clearances:
            closure, report = system.bearings[name].closure, forces.reports[name]
            force, torque = report.force, report.torque
        else:
            wanted = system.closures[topology.loops.index(name)]
            found = constraints.constraint_wrenches(system, motions, solution.multipliers)
            closure, force, torque, _ = next(entry for entry in found if entry[0] is wanted)
        rotation = kinematics.relative_motion(closure, motions)[0].parent_pose.rotation
        return ReactionHistory(sp.apply(rotation, force), sp.apply(rotation, torque))

    return _arrays(over_time(trajectory, one))


@eqx.filter_jit
def _drift(trajectory):
    def one(now):
        return {
            name: jnp.max(
                jnp.abs(
                    sp.stack(
                        constraints.constraint_rows(now.system, now.motions, closure).residuals
                    )
                ),
                initial=0.0,
            )
            for name, closure in zip(now.system.topology.loops, now.system.closures, strict=True)
        }

    return over_time(trajectory, one)


@eqx.filter_jit
def _energies(trajectory):
    def one(now):
        return (
            *energy.mechanical_energy(now.system, now.forces()),
            *now.entries[now.layout.energy_start :],
        )

    kinetic, potential, supplied, contact_work, contact_loss, friction_loss, damping_loss = (
        over_time(trajectory, one)
    )
    stored = contact_work - contact_loss
    total = kinetic + potential + contact_work + friction_loss + damping_loss
    error = total - total[0] - supplied
    return EnergyHistory(
        kinetic, potential, stored, contact_loss, friction_loss, damping_loss, supplied, error
    )
