"""The standard answers of a run, and how far two runs of one mechanism are apart in them.

Places are judged beside the longest way of a body, or a hundred times the widest gap if that is
more: bodies that go less far only move within their gaps; what stands still is judged beside its
size. Places in gaps are judged beside the
clearance, forces beside the largest of all joints, wear beside the surface that wears most; all of
them as the finest run tells them, as errors are shares of what an answer is.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.formulations.model import Instant
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.pose import REST
from jaxclear.multibody import contact_point, kinematics
from jaxclear.multibody.forces import load_rows
from jaxclear.multibody.length_scales import is_gap, rooms
from jaxclear.multibody.rows import wrench_in_joint
from jaxclear.multibody.system import films_in, longest_arm, wear_maps
from jaxclear.multibody.topology import motor_name, turns
from jaxclear.native.compiled import AROUND_A_KERNEL, compiled_quickly
from jaxclear.results import histories
from jaxclear.results.response import PeakContactForce, needs_of, peak_of_steps
from jaxclear.results.state_history import columns, over_time
from jaxclear.results.trajectory import Trajectory
from jaxclear.results.transmissions import sent_at

# A body that goes less far than so many of the widest gap is judged beside that.
GAPS = 100.0
# Bodies that move by less than this share of the longest arm, and of a radian, are judged beside
# it: a thousandth, the tightest promise, is what Adaptive's absolute tolerance lets through.
AT_REST = 1e-6
# Share of the energy turned over below which friction takes nothing that a user would read.
LEAST_LOSS = 1e-3
# Worn depth, beside the root of its surface's area, below which nothing wears: a thousand million
# such runs take less than an atom off a bearing.
NO_WEAR = 1e-17
# Of a worn depth what half the step changes counts three times in the place of twice: surfaces wear
# by means over parts of a run, each with whole impacts as they come, so two runs may agree by
# chance. Source: Roache 1997, Annu. Rev. Fluid Mech. 29, 123, doi:10.1146/annurev.fluid.29.1.123.
SAFETY_OF_DEPTHS = 1.5


class Observables(NamedTuple):
    """Centres of mass [m] and axes of the bodies over time; where parts are in the gap of each
    contact, beside its width, that width [m], and the number of its joint; mean and peak normal
    force of each joint [N] (None: not known between saving times); what friction has taken and what
    was turned over [J] (None: no balance); worn volumes [m3], depths [m] and areas [m2] of the
    surfaces; the longest arm [m]; mean and peak of what couplings transmit [N m, N] (of `means_of`
    and `peaks_of`), and the torque [N m] beside which none transmits anything; the mean force of
    each film [N]."""

    centres: Float[Array, "time bodies 3"]
    axes: Float[Array, "time bodies 9"]
    in_gaps: Float[Array, "time contacts 3"] | None
    rooms: Float[Array, " contacts"] | None
    owners: Int[Array, " contacts"] | None
    mean_force: Float[Array, " joints"]
    peak_force: Float[Array, " joints"] | None
    friction_loss: Float[Array, ""] | None
    turnover: Float[Array, ""] | None
    volume: Float[Array, " surfaces"]
    depth: Float[Array, " surfaces"]
    area: Float[Array, " surfaces"]
    arm: Float[Array, ""]
    mean_sent: Float[Array, " couplings"]
    peak_sent: Float[Array, " couplings"]
    idle: Float[Array, ""]
    film_force: Float[Array, " films"]


def films_of(run: Trajectory) -> dict[str, str]:
    """Joints with a film whose force follows from the state, with the name of the film."""
    if run.formulation.forces_are_means:
        return {}
    return {load.connection: name for name, load in films_in(run.mechanism).items()}


def means_of(run: Trajectory) -> tuple[str, ...]:
    """Couplings whose mean is a standard answer: saving times tell of those that never part."""
    return tuple(n for n in _determined_couplings(run) if not run.mechanism.couplings[n].play)


def peaks_of(run: Trajectory) -> tuple[str, ...]:
    """Couplings whose peak is one: where forces are no means."""
    return () if run.formulation.forces_are_means else _determined_couplings(run)


def _determined_couplings(run: Trajectory) -> tuple[str, ...]:
    """Couplings that loops determine, but for motors that turn with a joint: what these transmit is
    worked out from accelerations alone, which takes long to compile."""
    topology = run.mechanism.topology
    excluded = {*dict(topology.geared)}
    excluded |= set() if topology.redundancy is None else {*topology.redundancy.joints}
    return tuple(n for n in run.mechanism.couplings if not {n, motor_name(n)} & excluded)


def safety_of(run: Trajectory, response: Any) -> float:
    """By how much more than finer steps tell the error of a response of a run is taken."""
    reads_depths = bool(run.worn) and needs_of(response) in ("worn depth", "anything")
    return SAFETY_OF_DEPTHS if reads_depths else 1.0


def label_of(answer: str, place: str) -> str:
    """An answer with its place, if it has one."""
    return f'{answer}, "{place}"' if place else answer


class Difference(NamedTuple):
    """How far two runs are apart in an `answer`: by its `part` of the promise and its `place`, in
    its `unit`, beside the `scale` by which it is judged; `value`: what the answer is; `safety`: by
    how much more than finer steps tell its error is taken."""

    answer: str
    part: str
    place: str
    unit: str
    value: float
    off: float
    scale: float
    safety: float = 1.0

    @property
    def name(self) -> str:
        """The answer with its place."""
        return label_of(self.answer, self.place)

    @property
    def share(self) -> float:
        """The difference beside the scale."""
        return self.off / self.scale if self.scale > 0 else (0.0 if self.off == 0 else np.inf)


def _observe_run(run: Trajectory) -> Observables:
    """What is compared of a run and of its companions."""
    history, model = run.history, run.history.model()
    system, duration = model.system, run.time[-1] - run.time[0]

    def at(now: Instant) -> tuple:
        moved = zip(system.topology.branches, system.links, now.motions, strict=True)
        # A rotor is no body; its many turns would hide by how much an arm is off.
        links = [(link, motion) for branch, link, motion in moved if not branch.motor]
        centres = tuple(
            motion.pose.point(sp.scale(safe_divide(1.0, link.mass), link.first_moment))
            for link, motion in links
        )
        axes = tuple(tuple(x for row in m.pose.rotation for x in row) for _, m in links)
        rows = {
            joint: load_rows(system, now.motions, film, now.time, now.followed)[1]
            for joint, film in films.items()
        }
        forces = [wrench_in_joint(of_film, joint).force for joint, of_film in rows.items()]
        films_at = tuple(safe_sqrt(jnp.asarray(sp.dot(x, x), float)) for x in forces)
        return centres, axes, _positions_in_gaps(now), sent_at(history, now, coupled), films_at

    coupled, films = _determined_couplings(run), films_of(run)
    *moved, sent, filmed = over_time(history, at)
    centres, axes, inside = (
        columns(each) if each else jnp.zeros((len(run.time), 0, k))
        for each, k in zip(moved, (3, 9, 3), strict=True)
    )
    sent = {name: jnp.abs(part) for name, part in zip(coupled, sent, strict=True)}
    heavy = [link.mass for link in system.links]
    peaks_sent = [peak_of_steps(run, name, jnp.max(sent[name])) for name in peaks_of(run)]
    joints = run.formulation.contact_joints(run.mechanism)
    contacts = [(name, k) for name, part in system.bearings.items() for k in range(len(part.radii))]
    stacked = lambda each: jnp.stack(each) if each else jnp.zeros(0)
    mean = stacked([histories.contact_impulse(history, name)[-1] / duration for name in joints])
    peaks = None
    if run.extremes is not None and not run.formulation.forces_are_means:
        peaks = stacked([PeakContactForce(name)(run) for name in run.mechanism.topology.clearances])
    friction, turnover = None, None
    if history.balanced:
        energies = histories.energy_history(history)
        friction = energies.friction_loss[-1]
        turnover = jnp.max(energies.kinetic) + jnp.max(jnp.abs(energies.input))
    places = [(joint, surface) for joint, part in run.worn.items() for surface in part]
    volumes = [histories.worn_volume(history, *place)[-1] for place in places]
    maps, opens = wear_maps(system), bool(system.bearings)
    depths = [maps[name][surface][0].deepest(run.worn[name][surface]) for name, surface in places]
    areas = [jnp.sum(maps[joint][surface][0].areas()) for joint, surface in places]
    return Observables(
        centres,
        axes,
        inside if opens else None,
        rooms(system) if opens else None,
        jnp.asarray([list(joints).index(name) for name, _ in contacts]) if opens else None,
        mean,
        peaks,
        friction,
        turnover,
        stacked(volumes),
        stacked(depths),
        stacked(areas),
        jnp.asarray(longest_arm(system), float),
        stacked([jnp.trapezoid(sent[name], run.time) / duration for name in means_of(run)]),
        stacked(peaks_sent),
        AT_REST * jnp.asarray(sp.total(heavy), float) * (longest_arm(system) / duration) ** 2,
        stacked([jnp.trapezoid(force, run.time) / duration for force in filmed]),
    )


# Compiled once for all runs of a kind.
observed = compiled_quickly(_observe_run, AROUND_A_KERNEL)


def _positions_in_gaps(now: Instant) -> tuple:
    """Where each contact's parts are in their gap, beside its width: the vector from the middle
    along which it closes, in the bearing's axes."""
    shares: list[Any] = []
    for name, bearing in now.model.system.bearings.items():
        _, pose, _ = kinematics.relative_motion(bearing.closure, now.motions)
        drawn = contact_point.depths(bearing.joint, REST, {})
        contacts = contact_point.gap_function(bearing.joint, pose, now.model.worn.get(name, {}))
        for gap, contact in zip(drawn, contacts, strict=True):
            width = abs(gap)
            share = safe_divide(contact.indentation + width, width)
            shares.append(sp.scale(share, contact.slope))
    return tuple(shares)


def differences(
    run: Trajectory, one: Observables, other: Observables, finest: Observables
) -> list[Difference]:
    """Differences of two runs in the standard answers.

    Args:
        run: the one that is judged, which names joints and bodies.
        one, other: what is observed of the two runs, NumPy's numbers.
        finest: what is observed of the most accurate run, which scales the differences.
    """
    widest = 0.0 if one.rooms is None else float(np.max(one.rooms, initial=0.0))
    arm = float(one.arm)
    shift, longest = (_largest_displacement(each.centres) for each in (one, finest))
    angle, most = (_largest_angle(each.axes, each.axes[:1]) for each in (one, finest))
    length_scale = max(longest, GAPS * widest, AT_REST * arm)
    angles = max(most, GAPS * widest / arm if arm > 0 else 0.0, AT_REST)
    off = float(np.max(np.abs(one.centres - other.centres), initial=0.0))
    angle_off = _largest_angle(one.axes, other.axes)
    rows = [
        Difference("places of bodies", "places", "", "m", shift, off, length_scale),
        Difference("orientation of bodies", "places", "", "rad", angle, angle_off, angles),
    ]
    rows += _gap_differences(run, one, other)
    joints = run.formulation.contact_joints(run.mechanism)
    of_joints = (
        ("mean contact force", "mean_force", joints),
        ("peak contact force", "peak_force", run.mechanism.topology.clearances),
    )
    for answer, part, names in of_joints:
        forces = [getattr(each, part) for each in (one, other, finest)]
        if forces[0] is not None and len(forces[0]):
            rows += _by_place(answer, part, "N", names, *forces)
    films = films_of(run)
    if films:
        # A journal that its film carries has no contact of which anything is to be said.
        rows = [row for row in rows if not (row.place in films and row.scale == 0)]
        forces = [each.film_force for each in (one, other, finest)]
        rows += _by_place("mean film force", "mean_force", "N", [*films], *forces)
    couplings = run.mechanism.couplings
    of_couplings = (("mean", "mean_force", means_of(run)), ("peak", "peak_force", peaks_of(run)))
    for kind, part, names in of_couplings:
        for unit, least in (("N m", float(one.idle)), ("N", float(one.idle) / arm if arm else 0.0)):
            torque = unit == "N m"
            ks = [k for k, n in enumerate(names) if turns(run.mechanism, couplings[n]) == torque]
            a, b, c = (getattr(x, f"{kind}_sent")[ks] for x in (one, other, finest))
            if ks:
                places = [names[k] for k in ks]
                rows += _by_place(f"{kind} transmitted", part, unit, places, a, b, c, least)
    if one.friction_loss is not None:
        loss, less, last = (float(np.asarray(each.friction_loss)) for each in (one, other, finest))
        scale = max(last, LEAST_LOSS * float(np.asarray(finest.turnover))) or max(loss, less)
        if max(loss, less) > 0:
            row = "friction loss", "losses", "", "J", loss, abs(loss - less), scale
            rows.append(Difference(*row))
    places = [f"{joint}, {surface}" for joint, ks in run.worn.items() for surface in ks]
    if places:
        least = NO_WEAR * float(np.sqrt(np.max(one.area)))
        volumes = one.volume, other.volume, finest.volume
        rows += _by_place(
            "worn volume", "losses", "m^3", places, *volumes, least * float(np.max(one.area))
        )
        depths = one.depth, other.depth, finest.depth
        worn = _by_place("worn depth", "losses", "m", places, *depths, least)
        rows += [row._replace(safety=SAFETY_OF_DEPTHS) for row in worn]
    return rows


def _largest_displacement(history: Any) -> float:
    """The longest way from where it begins."""
    return float(np.max(np.abs(history - history[:1]), initial=0.0))


def _largest_angle(one: Any, other: Any) -> float:
    """The largest angle [rad] between axes."""
    squares = np.sum(np.square(one - other), axis=-1)
    half = np.sqrt(np.max(squares, initial=0.0) / 8)
    return float(2 * np.arcsin(np.minimum(half, 1.0)))


def _gap_differences(run: Trajectory, one: Observables, other: Observables) -> list[Difference]:
    if one.in_gaps is None:
        return []
    off = np.max(np.abs(np.asarray(one.in_gaps) - np.asarray(other.in_gaps)), axis=(0, 2))
    joints = list(run.formulation.contact_joints(run.mechanism))
    names = [joints[owner] for owner in np.asarray(one.owners)]
    largest: dict[str, tuple[float, float]] = {}
    for name, share, gap in zip(names, off, np.asarray(one.rooms), strict=True):
        largest[name] = max(largest.get(name, (0.0, 0.0)), (float(share), float(gap)))
    return [
        Difference("places in the gap", "gaps", name, "m", gap, share * gap, gap)
        for name, (share, gap) in largest.items()
        if is_gap(gap, float(one.arm))
    ]


def _by_place(
    answer: str,
    part: str,
    unit: str,
    places: Any,
    one: Any,
    other: Any,
    finest: Any,
    least: float = 0.0,
) -> list[Difference]:
    """Of an answer by place, judged beside the `finest` one that is largest (of all runs where
    there is none in this), or beside the `least` that counts."""
    largest = float(np.max(np.abs(finest))) or float(np.max(np.abs(one)))
    scale = max(largest, least)
    rows = zip(places, one, other, strict=True)
    return [
        Difference(answer, part, place, unit, float(x), abs(float(x) - float(y)), scale)
        for place, x, y in rows
    ]


def distance_in_gaps(one: Observables, other: Observables) -> Float[np.ndarray, " time"]:
    """By saving time how far parts are elsewhere in their gaps, beside these; 0 without gaps."""
    if one.in_gaps is None:
        return np.zeros(len(one.centres))
    return np.max(np.abs(np.asarray(one.in_gaps) - np.asarray(other.in_gaps)), axis=(1, 2))
