"""Open trees of every ideal joint against Pinocchio (pin, an independent implementation of
Featherstone's algorithms).

Tolerance 1e-10 relative: both programs work in float64 and differ by rounding only."""

import jax
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground import sparse as sp
from jaxclear.multibody import dynamics, kinematics, tree
from jaxclear.multibody.forces import applied_forces
from jaxclear.multibody.state import lay_out, unpack_motion
from jaxclear.multibody.system import prepare
from tests.rigs.cells import slow

pin = pytest.importorskip("pinocchio")

JOINTS = [
    "Fixed",
    "Revolute",
    "Prismatic",
    "Cylindrical",
    "Universal",
    "Spherical",
    "Planar",
    "Free",
]


def random_rotation(rng):
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def random_tree(rng, size):
    """The same random tree twice: as a mechanism of ours, and as a Pinocchio model with its joint
    ids."""
    model, ids, bodies, connections, kinds = pin.Model(), [], {}, {}, []
    model.gravity.linear = np.array([0.3, -9.81, 1.2])
    for i in range(size):
        kind = JOINTS[rng.integers(len(JOINTS))] if i else "Universal"
        parent = int(rng.integers(-1, i)) if i else -1
        at, turn = rng.normal(size=3), random_rotation(rng)
        mass, com = rng.uniform(0.5, 3.0), rng.normal(size=3)
        root = rng.normal(size=(3, 3))
        inertia = root @ root.T + np.eye(3) * np.trace(root @ root.T)
        bodies[f"b{i}"] = jc.Body(
            mass, (*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]), tuple(com)
        )
        connections[f"j{i}"] = jc.Connection(
            getattr(jc.joint, kind)(),
            jc.Marker("ground" if parent < 0 else f"b{parent}", tuple(at), quaternion=tuple(turn)),
            jc.Marker(f"b{i}"),
        )
        placement = pin.SE3(pin.Quaternion(*turn).matrix(), at)
        own = pin.Inertia(mass, com, inertia)
        if kind == "Fixed":
            base, offset = (0, pin.SE3.Identity()) if parent < 0 else ids[parent]
            place = offset * placement
            model.appendBodyToJoint(base, own, place)
            ids.append((base, place))
        else:
            base, offset = (0, pin.SE3.Identity()) if parent < 0 else ids[parent]
            joint = model.addJoint(base, pin_joint(kind), offset * placement, f"j{i}")
            model.appendBodyToJoint(joint, own, pin.SE3.Identity())
            ids.append((joint, pin.SE3.Identity()))
        kinds.append(kind)
    rig = jc.Mechanism(bodies, connections, {"g": jc.load.Gravity((0.3, -9.81, 1.2))})
    return rig, model, ids, kinds


def pin_joint(kind):
    if kind == "Cylindrical":
        both = pin.JointModelComposite(pin.JointModelPZ())
        both.addJoint(pin.JointModelRZ())
        return both
    if kind == "Universal":
        return pin.JointModelUniversal(np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
    return {
        "Revolute": pin.JointModelRZ,
        "Prismatic": pin.JointModelPZ,
        "Spherical": pin.JointModelSpherical,
        "Planar": pin.JointModelPlanar,
        "Free": pin.JointModelFreeFlyer,
    }[kind]()


def coordinates(rng, kind):
    """Coordinates in our order and in Pinocchio's."""
    angle = rng.uniform(-3, 3)
    turn = random_rotation(rng)
    place = rng.normal(size=3)
    if kind == "Fixed":
        return [], []
    if kind in ("Revolute", "Prismatic"):
        return [angle], [angle]
    if kind in ("Cylindrical", "Universal"):
        return [place[0], angle], [place[0], angle]
    if kind == "Spherical":
        return [*turn], [*turn[1:], turn[0]]
    if kind == "Planar":
        return [*place[:2], angle], [*place[:2], np.cos(angle), np.sin(angle)]
    return [*place, *turn], [*place, *turn[1:], turn[0]]


def subtree_rows(system, mass_blocks):
    """Mass blocks of the subtrees as one dense matrix over all speeds."""
    count = system.topology.speed_count
    full, start = np.zeros((count, count)), 0
    for block in mass_blocks:
        n = len(block)
        full[start : start + n, start : start + n] = sp.stack(
            [x for row in block for x in row]
        ).reshape(n, n)
        start += n
    return full


# Every tree compiles anew: two of them always, the others with the long tests.
@pytest.mark.parametrize("seed", [*range(2), *slow(*range(2, 12))])
def test_random_tree_agrees_with_pinocchio(seed):
    rng = np.random.default_rng(seed)
    rig, model, ids, kinds = random_tree(rng, 6)
    system = prepare(rig)
    layout = lay_out(system)
    ours, theirs = {}, np.zeros(model.nq)
    for i, kind in enumerate(kinds):
        own, pinocchio = coordinates(rng, kind)
        ours[f"j{i}"] = own
        if pinocchio:
            joint = model.joints[ids[i][0]]
            theirs[joint.idx_q : joint.idx_q + joint.nq] = pinocchio
    speeds = rng.normal(size=model.nv)
    own_speeds = np.zeros(model.nv)
    data = model.createData()
    order = np.zeros(model.nv, int)
    q_flat = []
    for branch in system.topology.branches:
        i = int(branch.body[1:])
        q_flat += ours[f"j{i}"]
        n = branch.speeds.stop - branch.speeds.start
        if n:
            joint = model.joints[ids[i][0]]
            order[branch.speeds] = np.arange(joint.idx_v, joint.idx_v + joint.nv)
    own_speeds = speeds[order]
    entries = [*map(np.float64, q_flat), *own_speeds]

    def all_of_it(entries):
        q, v = unpack_motion(system, entries)
        motions = kinematics.link_motions(system, q, v, 0.0)
        forces = applied_forces(system, motions, {}, 0.0)
        solution = dynamics.forward_dynamics(system, forces, None)
        ground = tuple(-x for x in system.gravity)
        mass, bias = [], []
        for subtree in system.topology.subtrees:
            links, own, loads = (
                tuple(p[i] for i in subtree) for p in (system.links, motions, forces.wrenches)
            )
            mass.append(tree.mass_matrix(links, own))
            bias.extend(tree.bias_forces(links, own, ground, loads))
        poses = [(sp.dense(m.pose.rotation), sp.dense(m.pose.translation)) for m in motions]
        accelerations = [a for part in solution.accelerations for a in part]
        return poses, sp.dense(mass), sp.stack(bias), sp.stack(accelerations)

    poses, mass, bias, accelerations = jax.jit(all_of_it)(entries)
    unit = np.eye(model.nv)
    still = pin.rnea(model, data, theirs, speeds, 0 * speeds)
    inertia = np.stack([pin.rnea(model, data, theirs, speeds, e) - still for e in unit])
    np.testing.assert_allclose(
        subtree_rows(system, mass),
        inertia[np.ix_(order, order)],
        rtol=1e-10,
        atol=1e-10 * inertia.max(),
    )
    expected = pin.nonLinearEffects(model, data, theirs, speeds)[order]
    np.testing.assert_allclose(bias, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max())
    expected = pin.aba(model, data, theirs, speeds, np.zeros(model.nv))[order]
    np.testing.assert_allclose(
        accelerations, expected, rtol=1e-10, atol=1e-10 * np.abs(expected).max()
    )
    pin.forwardKinematics(model, data, theirs)
    for branch, (rotation, place) in zip(system.topology.branches, poses, strict=True):
        joint, offset = ids[int(branch.body[1:])]
        pose = data.oMi[joint] * offset
        np.testing.assert_allclose(np.array(rotation), pose.rotation, atol=1e-12)
        np.testing.assert_allclose(np.array(place), pose.translation, atol=1e-11)
    assert layout.size == model.nq - kinds.count("Planar") + model.nv
