r"""Bodies of a compiled model with their inertias, and its joints with their axes.

Equality constraints of a model of MuJoCo: `connect` is a `Spherical` joint that closes a loop,
`weld` a `Fixed` one, a linear equality of joints (URDF's `mimic`) a `Ratio`, of one joint alone a
drive that holds it. What is not built is named.

MuJoCo holds them softly; here they hold. With body semantics it keeps the point `eq_data[0:3]` of
the one body at the point `eq_data[3:6]` of the other (of a weld in the opposite order), with site
semantics two sites. Where the file gives one point only, its compiler has the other from the
reference configuration. Source: MuJoCo documentation, "XML reference", section "equality"
(mujoco.readthedocs.io, version 3).
"""

from typing import Any, NamedTuple

import numpy as np

from jaxclear.components.body import Body, Connection, Marker
from jaxclear.components.coupling import Ratio
from jaxclear.components.joint import Fixed, Free, Prismatic, Revolute, Spherical
from jaxclear.files.mujoco_model import FREE, SLIDE, SPHERICAL, free_name

# Of mjtJoint, in its order.
JOINTS = (Free, Spherical, Prismatic, Revolute)
# Between two joints of one body stands a body of this share of its mass and largest moment of
# inertia: a mechanism has a body between any two joints.
SHARE_BETWEEN = 1e-12


class Place(NamedTuple):
    """A frame: rotation matrix (3, 3) and origin [m]."""

    rotation: np.ndarray
    origin: np.ndarray

    def after(self, inner: "Place") -> "Place":
        """The frame `inner`, given in this one, in the frame in which this one is given."""
        origin = self.rotation @ inner.origin + self.origin
        return Place(self.rotation @ inner.rotation, origin)


HERE = Place(np.eye(3), np.zeros(3))


class Inertia(NamedTuple):
    """Mass [kg], centre of mass [m] and inertia about it [kg m^2], in some frame."""

    mass: float
    centre: np.ndarray
    matrix: np.ndarray

    def in_frame(self, place: Place) -> "Inertia":
        """The same in a frame in which its own stands at `place`."""
        rotated = place.rotation @ self.matrix @ place.rotation.T
        return Inertia(self.mass, place.rotation @ self.centre + place.origin, rotated)

    def with_another(self, other: "Inertia") -> "Inertia":
        """Both as one body."""
        mass = self.mass + other.mass
        if mass == 0:
            return self
        centre = (self.mass * self.centre + other.mass * other.centre) / mass
        matrix = self._about(centre) + other._about(centre)
        return Inertia(mass, centre, matrix)

    def _about(self, point: np.ndarray) -> np.ndarray:
        away = self.centre - point
        return self.matrix + self.mass * (away @ away * np.eye(3) - np.outer(away, away))

    @property
    def is_body(self) -> bool:
        """Whether it is that of a body: some mass, extended in every direction."""
        return self.mass > 0 and bool(np.linalg.eigvalsh(self.matrix)[0] > 0)

    def body(self) -> Body:
        """The body that has it."""
        m = self.matrix
        products = (m[0, 1], m[0, 2], m[1, 2])
        moments = tuple(map(float, np.diag(m)))
        numbers = (*moments, *map(float, products)) if np.any(products) else moments
        return Body(self.mass, numbers, tuple(map(float, self.centre)))


class Tree:
    """Bodies and connections of a model, and where free bodies start."""

    def __init__(self, model: Any, bodies: list[str], joints: list[str]):
        self.model, self.names, self.joints = model, bodies, joints
        self.bodies: dict[str, Body] = {}
        self.connections: dict[str, Connection] = {}
        self.start: dict[str, tuple[float, ...]] = {}
        # The body of which one is a part, and where it stands in it.
        self.part: list[tuple[int, Place]] = [(0, HERE)]
        self.inertias = [_inertia_of(model, index) for index in range(model.nbody)]
        self._merge_welded_bodies()
        for index in range(1, model.nbody):
            if self.part[index][0] == index:
                self._add_body(index)

    def _merge_welded_bodies(self) -> None:
        """Welded bodies that are none by themselves, or hold what is none, become parts."""
        model = self.model
        for index in range(1, model.nbody):
            parent = int(model.body_parentid[index])
            owner, place = self.part[parent]
            welded = model.body_jntnum[index] == 0
            owner_is_body = owner == 0 or self.inertias[owner].is_body
            if welded and not (self.inertias[index].is_body and owner_is_body):
                place = place.after(_place_of(model, index))
                self.part.append((owner, place))
                part = self.inertias[index].in_frame(place)
                self.inertias[owner] = self.inertias[owner].with_another(part)
            else:
                self.part.append((index, HERE))

    def _add_body(self, index: int) -> None:
        """A body with its connections."""
        model, name, inertia = self.model, self.names[index], self.inertias[index]
        if not inertia.is_body:
            raise ValueError(
                f'body "{name}" moves and has mass {inertia.mass:g} kg and moments of inertia '
                f"{np.linalg.eigvalsh(inertia.matrix)} kg m^2; all must be above 0."
            )
        owner, place = self.part[int(model.body_parentid[index])]
        place = place.after(_place_of(model, index))
        first = int(model.body_jntadr[index])
        joints = range(first, first + int(model.body_jntnum[index]))
        parent = self.names[owner]
        if not joints:
            at = marker_at(parent, place)
            self.connections[f"{name} weld"] = Connection(Fixed(), at, Marker(name))
        for k in joints:
            child = name if k == joints[-1] else f"{self.joints[k]} carrier"
            if child != name:
                self.bodies[child] = _make_carrier_body(inertia)
            self._add_joint(k, parent, place, child)
            parent, place = child, HERE
        self.bodies[name] = inertia.body()

    def _add_joint(self, k: int, parent: str, place: Place, child: str) -> None:
        """A joint between a parent, in which the child stands at `place` by reference, and a
        child."""
        model, joint = self.model, JOINTS[self.model.jnt_type[k]]()
        name, at = self.joints[k], model.jnt_pos[k]
        if model.jnt_type[k] == FREE:
            self.connections[name] = Connection(joint, parent, child)
            start = model.qpos0[model.jnt_qposadr[k] :][:7]
            self.start[name] = tuple(map(float, start))
            return
        turn = np.eye(3) if model.jnt_type[k] == SPHERICAL else _rotation_to_axis(model.jnt_axis[k])
        axis = Place(turn, at)
        outer = place.after(axis)
        self.connections[name] = Connection(joint, marker_at(parent, outer), marker_at(child, axis))

    def locate(self, index: int, place: Place) -> tuple[str, Place]:
        """The body that has a body of the model, and where a place in that stands in it."""
        owner, offset = self.part[index]
        return self.names[owner], offset.after(place)


def _inertia_of(model: Any, index: int) -> Inertia:
    turn = rotation_of(model.body_iquat[index])
    matrix = turn @ np.diag(model.body_inertia[index]) @ turn.T
    matrix = 0.5 * (matrix + matrix.T)
    return Inertia(float(model.body_mass[index]), np.array(model.body_ipos[index]), matrix)


def _make_carrier_body(inertia: Inertia) -> Body:
    """What stands between two joints of a body."""
    moment = SHARE_BETWEEN * float(np.linalg.eigvalsh(inertia.matrix)[-1])
    return Body(SHARE_BETWEEN * inertia.mass, (moment, moment, moment))


def _place_of(model: Any, index: int) -> Place:
    return Place(rotation_of(model.body_quat[index]), np.array(model.body_pos[index]))


def marker_at(body: str, place: Place) -> Marker:
    """A marker at a place, its axis by name where it is turned as that name says."""
    at = tuple(map(float, place.origin)) if np.any(place.origin) else None
    if np.array_equal(place.rotation, np.eye(3)):
        return Marker(body, at)
    return Marker(body, at, quaternion=quaternion_of(place.rotation))


def rotation_of(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix of a quaternion (w, x, y, z)."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_of(rotation: np.ndarray) -> tuple[float, ...]:
    """Quaternion (w, x, y, z) of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    return (float(w), float(x), float(y), float(z))


def _rotation_to_axis(axis: np.ndarray) -> np.ndarray:
    """A rotation that takes z to an axis, by the least turn."""
    x, y, z = axis / np.linalg.norm(axis)
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # The turn about (0, 0, 1) x axis.
    return rotation_of(np.array([1 + z, -y, x, 0.0]))


# Of mjtEq, in its order.
KINDS = ("connect", "weld", "joint", "tendon", "flex", "flexvert", "flexstrain")
# From this share of the model's extent on, or this angle [rad], a loop is open: as a `Mechanism`
# judges what is given for its start.
OPEN = 1e-6


class Equalities(NamedTuple):
    """Equality constraints as connections and couplings, joints held at a coordinate [rad, m], what
    is not taken over in words, the free joints of bodies that they hold, and how balls that hold
    such a body are turned in the reference configuration (quaternions w, x, y, z)."""

    connections: dict[str, Connection]
    couplings: dict[str, Ratio]
    fixed: dict[str, float]
    missing: list[str]
    free: set[str]
    rotations: dict[str, tuple[float, ...]]


class End(NamedTuple):
    """An end of an equality: its body in the model, and its frame there."""

    body: int
    place: Place


def equalities_of(model: Any, tree: Tree) -> Equalities:
    """The equality constraints of a model whose bodies and joints are those of a tree."""
    out = Equalities({}, {}, {}, [], set(), {})
    taken = [*tree.names, *tree.joints, *tree.connections]
    for k in range(model.neq):
        label, kind = model.eq(k).name or _name_of_equality(model, tree, k), KINDS[model.eq_type[k]]
        name = free_name(label, [*taken, *out.connections, *out.couplings], " equality")
        if not model.eq_active0[k] or kind not in ("connect", "weld", "joint"):
            out.missing.append(_describe_equality(model, k, name, tree.joints))
        elif kind == "joint":
            _add_coupling(out, model, tree, name, k)
        else:
            _add_connection(out, model, tree, name, k)
    return out


def _name_of_equality(model: Any, tree: Tree, k: int) -> str:
    """What an equality without a name is called: of joints, as URDF's `mimic`, by these."""
    kind, follower, leader = KINDS[model.eq_type[k]], model.eq_obj1id[k], model.eq_obj2id[k]
    if kind != "joint":
        return f"{kind} {k}"
    return f"{tree.joints[follower]} " + (f"by {tree.joints[leader]}" if leader >= 0 else "held")


def _add_coupling(out: Equalities, model: Any, tree: Tree, name: str, k: int) -> None:
    """Puts an equality of joints into what was found; both coordinates count from the reference
    configuration there, too."""
    follower, leader = (int(ids[k]) for ids in (model.eq_obj1id, model.eq_obj2id))
    offset, ratio, *bent = map(float, model.eq_data[k][:5])
    if leader >= 0 and any(bent):
        out.missing.append(_describe_equality(model, k, name, tree.joints))
        return
    if leader >= 0 and ratio:
        joints = tree.joints[follower], tree.joints[leader]
        out.couplings[name] = Ratio(*joints, ratio, offset or None)
    else:
        out.fixed[tree.joints[follower]] = offset
    if abs(offset) > OPEN:
        unit = "m" if model.jnt_type[follower] == SLIDE else "rad"
        out.missing.append(
            f'the reference configuration, in which equality "{name}" is off by {offset:.3g} {unit}'
            " (the mechanism is assembled from it)"
        )


def _ends_of_equality(model: Any, k: int) -> tuple[End, End]:
    import mujoco

    one, other, data = int(model.eq_obj1id[k]), int(model.eq_obj2id[k]), model.eq_data[k]
    if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
        return _end_at_site(model, one), _end_at_site(model, other)
    first, second = np.array(data[:3]), np.array(data[3:6])
    if KINDS[model.eq_type[k]] == "connect":
        return End(one, Place(np.eye(3), first)), End(other, Place(np.eye(3), second))
    rotated = Place(rotation_of(data[6:10]), second)
    return End(one, rotated), End(other, Place(np.eye(3), first))


def _end_at_site(model: Any, index: int) -> End:
    place = Place(rotation_of(model.site_quat[index]), np.array(model.site_pos[index]))
    return End(int(model.site_bodyid[index]), place)


def _add_connection(out: Equalities, model: Any, tree: Tree, name: str, k: int) -> None:
    """Puts a connection between two ends, and what has to be said of it, into what was found."""
    ends = _ends_of_equality(model, k)
    (parent, outer), (child, inner) = (tree.locate(end.body, end.place) for end in ends)
    # A weld whose torques count nothing holds a point only.
    turns = KINDS[model.eq_type[k]] == "connect" or model.eq_data[k][10] == 0
    kind, joint = ("connect", Spherical()) if turns else ("weld", Fixed())
    gap, rotation = _measure_gap(model, ends)
    turn = 0.0 if turns else _rotation_angle(rotation)
    far = gap > OPEN * model.stat.extent or turn > OPEN
    if parent == child:
        note = ", which it does not close" if far else ""
        out.missing.append(f'{kind} "{name}" (both ends are parts of "{parent}"{note})')
        return
    out.connections[name] = Connection(joint, marker_at(parent, outer), marker_at(child, inner))
    free = {name for end in ends for name in _free_joints(model, tree, end.body)}
    out.free.update(free)
    if free and turns:
        out.rotations[name] = quaternion_of(rotation)
    if far:
        by = f" and {turn:.3g} rad" if turn > OPEN else ""
        out.missing.append(
            f'the reference configuration, in which {kind} "{name}" is open by {gap:.3g} m{by}'
            " (the mechanism is assembled from it)"
        )


def _measure_gap(model: Any, ends: tuple[End, End]) -> tuple[float, np.ndarray]:
    """Distance [m] of two ends and the rotation between them in the reference configuration."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    one, other = (
        Place(data.xmat[end.body].reshape(3, 3), data.xpos[end.body]).after(end.place)
        for end in ends
    )
    return float(np.linalg.norm(one.origin - other.origin)), one.rotation.T @ other.rotation


def _rotation_angle(turn: np.ndarray) -> float:
    """How far a rotation turns [rad]."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1))


def _free_joints(model: Any, tree: Tree, body: int) -> list[str]:
    """The free joints that carry a body of the model."""
    names = []
    while body:
        first = int(model.body_jntadr[body])
        if first >= 0 and model.jnt_type[first] == FREE:
            names.append(tree.joints[first])
        body = int(model.body_parentid[body])
    return names


def _describe_equality(model: Any, k: int, name: str, joints: list[str]) -> str:
    """An equality that is not built: of one between joints with its polynomial."""
    idle, kind = "" if model.eq_active0[k] else ", not active", KINDS[model.eq_type[k]]
    if kind != "joint":
        return f'equality "{name}" ({kind}{idle})'
    one, other = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
    terms = [f"{x:.6g}{_power_text(i)}" for i, x in enumerate(model.eq_data[k][:5]) if x]
    law = " + ".join(terms) or "0"
    of = f', x that of "{joints[other]}"' if other >= 0 else ""
    return f'equality "{name}" (coordinate of "{joints[one]}" = {law}{of}{idle})'


def _power_text(i: int) -> str:
    return ("", " x", " x^2", " x^3", " x^4")[i]
