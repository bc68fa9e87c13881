r"""How far MuJoCo's soft constraints on hinges and slides give way: limits under what presses into
them at rest, dry friction under what it holds.

MuJoCo has :math:`a = (1 - d) a_0 - d (b v + k d r)` for the acceleration :math:`a_0` without the
constraint, the way r beyond the limit and the speed v; :math:`k, b` come from `solref`, the
impedance :math:`d(r)` from `solimp`. At rest, :math:`a = v = 0`, a force F on the inertia m
(`dof_invweight0`) gives way by r with :math:`m k d^2 r = (1 - d) F`. F is that of the tree of
bodies: what loops add to it is left out. Source: MuJoCo documentation, "Computation", section
"Constraint model", and "Modeling", "Solver parameters" (mujoco.readthedocs.io, version 3).
"""

from typing import Any, NamedTuple

import numpy as np

from jaxclear.files.mujoco_model import off

__all__ = ["Soft", "limit_is_soft", "pressing", "sag", "soft_of"]

# Of impedances MuJoCo itself takes no less and no more than these (mjMINIMP, mjMAXIMP), of widths
# no less than this (mjMINVAL).
LEAST, MOST, NARROWEST = 1e-4, 0.9999, 1e-15
# What it takes in place of a `solref` that is neither of its two forms.
USUAL = 0.02, 1.0


class Soft(NamedTuple):
    """How soft a constraint is: stiffness [1/s^2] and damping [1/s] by unit of inertia, impedance
    [1] where it begins and far behind it, the way in between [rad, m], and the share of the way and
    the power by which it grows."""

    stiffness: float
    damping: float
    first: float
    last: float
    width: float
    middle: float
    power: float

    def impedance(self, way: float) -> float:
        """d at a way [rad, m] beyond where the constraint begins."""
        if self.width <= NARROWEST or self.first == self.last:
            return 0.5 * (self.first + self.last)
        x, mid, p = min(way / self.width, 1.0), self.middle, self.power
        share = mid * (x / mid) ** p if x <= mid else 1 - (1 - mid) * ((1 - x) / (1 - mid)) ** p
        return self.first + share * (self.last - self.first)


def limit_is_soft(model: Any, k: int) -> Soft:
    """How soft the limit of a joint is."""
    return soft_of(model, model.jnt_solref[k], model.jnt_solimp[k])


def soft_of(model: Any, solref: np.ndarray, solimp: np.ndarray) -> Soft:
    """What MuJoCo reads from a constraint's `solref` and `solimp`."""
    first, last, middle = (float(np.clip(solimp[i], LEAST, MOST)) for i in (0, 1, 3))
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
    width, power = float(solimp[2]), max(1.0, float(solimp[4]))
    return Soft(stiffness, damping, first, last, width, middle, power)


def sag(soft: Soft, force: float, inertia: float) -> float:
    """How far [rad, m] a limit gives way in MuJoCo under a force [N m, N] at rest."""
    from scipy.optimize import brentq

    if not force > 0:
        return 0.0
    beyond = lambda way, d: inertia * soft.stiffness * d * d * way - (1 - d) * force
    least = min(soft.first, soft.last)
    most = (1 - least) * force / (inertia * soft.stiffness * least * least)
    return float(brentq(lambda way: beyond(way, soft.impedance(way)), 0.0, 2 * most))


def pressing(model: Any, k: int) -> tuple[float, float]:
    """Forces [N m, N] by which weight and springs press a joint at rest into its lower and its
    upper limit, the others in the reference configuration; negative where they pull it away."""
    low, high = (steady_force(model, k, float(at)) for at in model.jnt_range[k])
    return -low, high


def steady_force(model: Any, k: int, at: float) -> float:
    """Force [N m, N] of weight and springs on the coordinate of a joint that stands still, in
    MuJoCo's own count, the others in the reference configuration."""
    import mujoco

    data, dof = mujoco.MjData(model), model.jnt_dofadr[k]
    data.qpos[:] = model.qpos0
    data.qpos[model.jnt_qposadr[k]] = at
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    return float(data.qfrc_spring[dof] - data.qfrc_bias[dof])
