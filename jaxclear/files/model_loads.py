r"""What acts on the hinges and slides of a model of MuJoCo, as loads on their coordinates: damping
and stiffness, armature, dry friction, limits.

MuJoCo holds limits and dry friction by soft constraints: with the acceleration :math:`a_0` of the
motion without them, :math:`a = (1 - d) a_0 - d (b v + k d r)` as long as the force pushes (a
limit's) or is less than the bound (friction's), where :math:`k, b` come from `solref` and
:math:`d` from `solimp`. Here they are forces that do the same to the inertia :math:`m` that the
coordinate has in the reference configuration (`dof_invweight0`): a limit the spring
:math:`m d^2 k` and the damper :math:`m d b`, right for :math:`a_0 = 0`; friction the speed
:math:`v_0 = \tau (1 - d) / (m d b)` at which a small steady load creeps as fast. Source: MuJoCo
documentation, chapter "Computation", section "Constraint model", and "Modeling", "Solver
parameters" (mujoco.readthedocs.io, version 3).
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from jaxclear.components.load import (
    AbstractLoad,
    JointFriction,
    JointSpring,
    JointStop,
    RotorInertia,
)
from jaxclear.files.mujoco_model import SPHERICAL, has_stop, off

__all__ = ["loads_of"]

# Of impedances MuJoCo itself takes no less and no more than these (mjMINIMP, mjMAXIMP).
LEAST, MOST = 1e-4, 0.9999
# What it takes in place of a `solref` that is neither of its two forms.
USUAL = 0.02, 1.0
# A way [rad, m] over which a limit's damping sets in, where the model has it set in at once.
AT_ONCE = 1e-6


class Soft(NamedTuple):
    """How soft a constraint is: stiffness [1/s^2] and damping [1/s] by unit of inertia, impedance
    [1] where it begins and far behind it, and the way in between [rad, m]."""

    stiffness: float
    damping: float
    first: float
    last: float
    width: float


def loads_of(model: Any, joints: list[str]) -> Iterator[tuple[str, AbstractLoad]]:
    """Loads on the coordinates of a model's hinges and slides, by name."""
    stopped = has_stop(model)
    for k, name in enumerate(joints):
        if model.jnt_type[k] <= SPHERICAL:
            continue
        dof, at = model.jnt_dofadr[k], model.jnt_qposadr[k]
        stiffness, damping = float(model.jnt_stiffness[k]), float(model.dof_damping[dof])
        if stiffness or damping:
            rest = float(model.qpos_spring[at] - model.qpos0[at])
            yield f"{name} spring", JointSpring(name, stiffness or None, rest, damping or None)
        if model.dof_armature[dof] > 0:
            yield f"{name} armature", RotorInertia(name, float(model.dof_armature[dof]))
        if model.dof_frictionloss[dof] > 0:
            yield f"{name} friction", _friction(model, dof, name)
        if stopped[k]:
            yield f"{name} limits", _stop(model, k, name)


def _friction(model: Any, dof: int, name: str) -> JointFriction:
    soft = _soft(model, model.dof_solref[dof], model.dof_solimp[dof])
    if soft.damping <= 0:
        raise ValueError(
            f'solreffriction of joint "{name}" has damping 0; dry friction brings a joint to rest '
            'by it, so it must not be 0, as in the usual solreffriction="0.02 1".'
        )
    torque = float(model.dof_frictionloss[dof])
    creep = (1 - soft.first) / (soft.first * soft.damping)
    return JointFriction(name, torque, torque * creep * float(model.dof_invweight0[dof]))


def _stop(model: Any, k: int, name: str) -> JointStop:
    soft = _soft(model, model.jnt_solref[k], model.jnt_solimp[k])
    margin, origin = float(model.jnt_margin[k]), float(model.qpos0[model.jnt_qposadr[k]])
    low, high = (float(x) - origin for x in model.jnt_range[k])
    inertia = 1 / float(model.dof_invweight0[model.jnt_dofadr[k]])
    return JointStop(
        name,
        low + margin,
        high - margin,
        stiffness=inertia * soft.last**2 * soft.stiffness,
        damping=inertia * soft.last * soft.damping,
        depth=max(soft.width, AT_ONCE),
    )


def _soft(model: Any, solref: np.ndarray, solimp: np.ndarray) -> Soft:
    """What MuJoCo reads from a constraint's `solref` and `solimp`."""
    first, last = (float(np.clip(x, LEAST, MOST)) for x in solimp[:2])
    time, ratio = map(float, solref[:2])
    if (time > 0) != (ratio > 0):
        time, ratio = USUAL
    if time > 0:
        # The solver keeps to what its steps resolve, unless told not to.
        if not off(model, "REFSAFE"):
            time = max(time, 2 * float(model.opt.timestep))
        stiffness, damping = 1 / (last * time * ratio) ** 2, 2 / (last * time)
    else:
        stiffness, damping = -time / last**2, -ratio / last
    return Soft(stiffness, damping, first, last, float(solimp[2]))
