r"""Equality constraints of a model of MuJoCo: `connect` is a `Spherical` joint that closes a loop,
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

from jaxclear.components.body import Connection
from jaxclear.components.coupling import Ratio
from jaxclear.components.joint import Fixed, Spherical
from jaxclear.files.model_tree import Place, Tree, marker_at, quaternion_of, rotation_of
from jaxclear.files.mujoco_model import FREE, SLIDE, free_name

__all__ = ["Equalities", "equalities_of"]

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
    held: dict[str, float]
    missing: list[str]
    free: set[str]
    turned: dict[str, tuple[float, ...]]


class End(NamedTuple):
    """An end of an equality: its body in the model, and its frame there."""

    body: int
    place: Place


def equalities_of(model: Any, tree: Tree) -> Equalities:
    """The equality constraints of a model whose bodies and joints are those of a tree."""
    found = Equalities({}, {}, {}, [], set(), {})
    taken = [*tree.names, *tree.joints, *tree.connections]
    for k in range(model.neq):
        own, kind = model.eq(k).name or _unnamed(model, tree, k), KINDS[model.eq_type[k]]
        name = free_name(own, [*taken, *found.connections, *found.couplings], " equality")
        if not model.eq_active0[k] or kind not in ("connect", "weld", "joint"):
            found.missing.append(_in_words(model, k, name, tree.joints))
        elif kind == "joint":
            _couple(found, model, tree, name, k)
        else:
            _hold(found, model, tree, name, k)
    return found


def _unnamed(model: Any, tree: Tree, k: int) -> str:
    """What an equality without a name is called: of joints, as URDF's `mimic`, by these."""
    kind, follower, leader = KINDS[model.eq_type[k]], model.eq_obj1id[k], model.eq_obj2id[k]
    if kind != "joint":
        return f"{kind} {k}"
    return f"{tree.joints[follower]} " + (f"by {tree.joints[leader]}" if leader >= 0 else "held")


def _couple(found: Equalities, model: Any, tree: Tree, name: str, k: int) -> None:
    """Puts an equality of joints into what was found; both coordinates count from the reference
    configuration there, too."""
    follower, leader = (int(own[k]) for own in (model.eq_obj1id, model.eq_obj2id))
    offset, ratio, *bent = map(float, model.eq_data[k][:5])
    if leader >= 0 and any(bent):
        found.missing.append(_in_words(model, k, name, tree.joints))
        return
    if leader >= 0 and ratio:
        joints = tree.joints[follower], tree.joints[leader]
        found.couplings[name] = Ratio(*joints, ratio, offset or None)
    else:
        found.held[tree.joints[follower]] = offset
    if abs(offset) > OPEN:
        unit = "m" if model.jnt_type[follower] == SLIDE else "rad"
        found.missing.append(
            f'the reference configuration, in which equality "{name}" is off by {offset:.3g} {unit}'
            " (the mechanism is assembled from it)"
        )


def _ends(model: Any, k: int) -> tuple[End, End]:
    import mujoco

    one, other, data = int(model.eq_obj1id[k]), int(model.eq_obj2id[k]), model.eq_data[k]
    if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
        return _site(model, one), _site(model, other)
    first, second = np.array(data[:3]), np.array(data[3:6])
    if KINDS[model.eq_type[k]] == "connect":
        return End(one, Place(np.eye(3), first)), End(other, Place(np.eye(3), second))
    turned = Place(rotation_of(data[6:10]), second)
    return End(one, turned), End(other, Place(np.eye(3), first))


def _site(model: Any, index: int) -> End:
    place = Place(rotation_of(model.site_quat[index]), np.array(model.site_pos[index]))
    return End(int(model.site_bodyid[index]), place)


def _hold(found: Equalities, model: Any, tree: Tree, name: str, k: int) -> None:
    """Puts a connection between two ends, and what has to be said of it, into what was found."""
    ends = _ends(model, k)
    (parent, outer), (child, inner) = (tree.stands(end.body, end.place) for end in ends)
    # A weld whose torques count nothing holds a point only.
    turns = KINDS[model.eq_type[k]] == "connect" or model.eq_data[k][10] == 0
    kind, joint = ("connect", Spherical()) if turns else ("weld", Fixed())
    gap, turned = _apart(model, ends)
    turn = 0.0 if turns else _angle(turned)
    far = gap > OPEN * model.stat.extent or turn > OPEN
    if parent == child:
        said = ", which it does not close" if far else ""
        found.missing.append(f'{kind} "{name}" (both ends are parts of "{parent}"{said})')
        return
    found.connections[name] = Connection(joint, marker_at(parent, outer), marker_at(child, inner))
    free = {name for end in ends for name in _free_joints(model, tree, end.body)}
    found.free.update(free)
    if free and turns:
        found.turned[name] = quaternion_of(turned)
    if far:
        beside = f" and {turn:.3g} rad" if turn > OPEN else ""
        found.missing.append(
            f'the reference configuration, in which {kind} "{name}" is open by {gap:.3g} m{beside}'
            " (the mechanism is assembled from it)"
        )


def _apart(model: Any, ends: tuple[End, End]) -> tuple[float, np.ndarray]:
    """Distance [m] of two ends and the rotation between them in the reference configuration."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    one, other = (
        Place(data.xmat[end.body].reshape(3, 3), data.xpos[end.body]).after(end.place)
        for end in ends
    )
    return float(np.linalg.norm(one.origin - other.origin)), one.rotation.T @ other.rotation


def _angle(turn: np.ndarray) -> float:
    """How far a rotation turns [rad]."""
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(turn) - 1))


def _free_joints(model: Any, tree: Tree, body: int) -> list[str]:
    """The free joints that carry a body of the model."""
    found = []
    while body:
        first = int(model.body_jntadr[body])
        if first >= 0 and model.jnt_type[first] == FREE:
            found.append(tree.joints[first])
        body = int(model.body_parentid[body])
    return found


def _in_words(model: Any, k: int, name: str, joints: list[str]) -> str:
    """An equality that is not built: of one between joints with its polynomial."""
    idle, kind = "" if model.eq_active0[k] else ", not active", KINDS[model.eq_type[k]]
    if kind != "joint":
        return f'equality "{name}" ({kind}{idle})'
    one, other = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
    terms = [f"{x:.6g}{_power(i)}" for i, x in enumerate(model.eq_data[k][:5]) if x]
    law = " + ".join(terms) or "0"
    of = f', x that of "{joints[other]}"' if other >= 0 else ""
    return f'equality "{name}" (coordinate of "{joints[one]}" = {law}{of}{idle})'


def _power(i: int) -> str:
    return ("", " x", " x^2", " x^3", " x^4")[i]
