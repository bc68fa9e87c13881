"""Accelerations of a model as MuJoCo has them and as ours, at random places and speeds; without
limits and dry friction, which are forces here and constraints there."""

import sysconfig
import warnings
from pathlib import Path

import jax
import mujoco
import numpy as np

import jaxclear as jc
from jaxclear.files.mujoco_model import compiled, names_of
from jaxclear.ground import sparse as sp
from jaxclear.multibody import dynamics, kinematics
from jaxclear.multibody.forces import applied_forces
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import prepare

# Of the package example-robot-data.
ROBOTS = (
    Path(sysconfig.get_path("purelib")) / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
)
# What a mechanism has not or has otherwise, switched off there and left out here.
OTHERWISE = (jc.load.JointStop, jc.load.JointFriction)
BIT = mujoco.mjtDisableBit
OFF = (
    BIT.mjDSBL_CONTACT,
    BIT.mjDSBL_LIMIT,
    BIT.mjDSBL_FRICTIONLOSS,
    BIT.mjDSBL_EQUALITY,
    BIT.mjDSBL_ACTUATION,
)


def rotation(quaternion):
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, quaternion)
    return flat.reshape(3, 3)


def unit(rng):
    quaternion = rng.normal(size=4)
    return quaternion / np.linalg.norm(quaternion)


def ideal_tree(path, floating):
    """MuJoCo's model without what the mechanism does not take over, and names of its joints."""
    model = compiled(path, floating=floating).model
    # That of balls and free joints is not taken over.
    model.dof_armature[model.jnt_type[model.dof_jntid] <= 1] = 0
    for bit in OFF:
        model.opt.disableflags |= int(bit)
    return model, names_of(model)[1]


def drawn(model, rng):
    """Random coordinates and speeds, in place of `data`."""
    data = mujoco.MjData(model)
    for k in range(model.njnt):
        at = model.jnt_qposadr[k]
        if model.jnt_type[k] == mujoco.mjtJoint.mjJNT_FREE:
            data.qpos[at : at + 7] = [*rng.normal(size=3), *unit(rng)]
        elif model.jnt_type[k] == mujoco.mjtJoint.mjJNT_BALL:
            data.qpos[at : at + 4] = unit(rng)
        else:
            data.qpos[at] = model.qpos0[at] + rng.uniform(-2, 2)
    data.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    return data


def ours_of(model, data, k):
    """Coordinates, speeds and accelerations of MuJoCo's joint in our convention: a free joint's in
    its body's axes."""
    at, row = model.jnt_qposadr[k], model.jnt_dofadr[k]
    if model.jnt_type[k] == mujoco.mjtJoint.mjJNT_FREE:
        back = rotation(data.qpos[at + 3 : at + 7]).T
        velocity, spin = back @ data.qvel[row : row + 3], data.qvel[row + 3 : row + 6]
        acceleration = back @ data.qacc[row : row + 3] - np.cross(spin, velocity)
        rates = [*acceleration, *data.qacc[row + 3 : row + 6]]
        return data.qpos[at : at + 7], [*velocity, *spin], rates
    if model.jnt_type[k] == mujoco.mjtJoint.mjJNT_BALL:
        own = slice(row, row + 3)
        return data.qpos[at : at + 4], data.qvel[own], data.qacc[own]
    return [data.qpos[at] - model.qpos0[at]], [data.qvel[row]], [data.qacc[row]]


def largest_difference(path, *, floating=False, draws=3):
    """Largest difference of the accelerations beside the largest of them, and their number."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jc.NotImported)
        mechanism = jc.read_mjcf(path, floating=floating)
    alike = {n: x for n, x in mechanism.loads.items() if not isinstance(x, OTHERWISE)}
    mechanism = mechanism.with_loads(alike)
    # Equalities, a URDF's mimic among them.
    for name in mechanism.couplings:
        mechanism = mechanism.with_coupling(name, None)
    model, joints = ideal_tree(path, floating)
    system = prepare(mechanism)

    @jax.jit
    def accelerations(entries):
        q, v = unpack_motion(system, entries)
        motions = kinematics.link_motions(system, q, v, 0.0)
        springs = applied_forces(system, motions, {}, 0.0)
        solution = dynamics.forward_dynamics(system, springs, None)
        return sp.stack([a for part in solution.accelerations for a in part])

    worst = 0.0
    for seed in range(draws):
        data = drawn(model, np.random.default_rng(seed))
        moving = [b for b in system.topology.branches if b.speed_count]
        found = [ours_of(model, data, joints.index(b.connection)) for b in moving]
        q, v, wanted = (np.concatenate([part[i] for part in found]) for i in range(3))
        ours = np.asarray(accelerations([*map(np.float64, q), *map(np.float64, v)]))
        worst = max(worst, float(np.abs(ours - wanted).max() / np.abs(wanted).max()))
    return worst, model.nv
