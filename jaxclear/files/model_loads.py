r"""What acts on the hinges and slides of a model of MuJoCo, as loads on their coordinates: damping
and stiffness, armature, dry friction, limits.

MuJoCo holds limits and dry friction by soft constraints (see below), :math:`a = (1 - d) a_0
- d (b v + k d r)` as long as the force pushes (a limit's) or is less than the bound (friction's).
Here they are forces on the inertia :math:`m` that the coordinate has in the reference
configuration. MuJoCo weakens by d what presses into a limit, too; a spring and a damper do not, so
they are right in one of two cases:

- "steady": a limit gives way under weight and springs as far as in MuJoCo; where none press into
  it, under any force as far as in MuJoCo deep within it, :math:`m d^2 k / (1 - d)`. The damper has
  MuJoCo's own damping ratio :math:`b / (2 \sqrt{k})`.
- "impact": it stops what runs into it as in MuJoCo, :math:`m d^2 k` and :math:`m d b`, right for
  :math:`a_0 = 0`; under a steady load it gives way 1 / (1 - d) times as far.

Dry friction holds; in MuJoCo it creeps, which is an effect of its solver.

How far MuJoCo's soft limits of hinges and slides give way under what presses into them at rest:

MuJoCo has :math:`a = (1 - d) a_0 - d (b v + k d r)` for the acceleration :math:`a_0` without the
constraint, the way r beyond the limit and the speed v; :math:`k, b` come from `solref`, the
impedance :math:`d(r)` from `solimp`. At rest, :math:`a = v = 0`, a force F on the inertia m
(`dof_invweight0`) gives way by r with :math:`m k d^2 r = (1 - d) F`. F is that of the tree of
bodies: what loops add to it is left out. Source: MuJoCo documentation, "Computation", section
"Constraint model", and "Modeling", "Solver parameters" (mujoco.readthedocs.io, version 3).
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
from jaxclear.files.mujoco_model import SLIDE, SPHERICAL, has_stop, is_disabled

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

    def impedance(self, depth: float) -> float:
        """d at a way [rad, m] beyond where the constraint begins."""
        if self.width <= NARROWEST or self.first == self.last:
            return 0.5 * (self.first + self.last)
        x, mid, p = min(depth / self.width, 1.0), self.middle, self.power
        share = mid * (x / mid) ** p if x <= mid else 1 - (1 - mid) * ((1 - x) / (1 - mid)) ** p
        return self.first + share * (self.last - self.first)


def limit_is_soft(model: Any, k: int) -> Soft:
    """How soft the limit of a joint is."""
    return soft_of(model, model.jnt_solref[k], model.jnt_solimp[k])


def soft_of(model: Any, solref: np.ndarray, solimp: np.ndarray) -> Soft:
    """Numbers of a soft constraint as MuJoCo uses them.

    Args:
        model: MuJoCo's, with its options.
        solref: time constant [s] and damping ratio, or both negative: stiffness and damping.
        solimp: impedances, width, midpoint and power.
    """
    first, last, middle = (float(np.clip(solimp[i], LEAST, MOST)) for i in (0, 1, 3))
    time, ratio = map(float, solref[:2])
    if (time > 0) != (ratio > 0):
        time, ratio = USUAL
    if time > 0:
        # The solver keeps to what its steps resolve, unless told not to.
        if not is_disabled(model, "REFSAFE"):
            time = max(time, 2 * float(model.opt.timestep))
        stiffness, damping = 1 / (last * time * ratio) ** 2, 2 / (last * time)
    else:
        stiffness, damping = -time / last**2, -ratio / last
    width, power = float(solimp[2]), max(1.0, float(solimp[4]))
    return Soft(stiffness, damping, first, last, width, middle, power)


def sag(soft: Soft, force: float, inertia: float) -> float:
    """Deflection [rad, m] of a limit in MuJoCo under a force at rest.

    Args:
        soft: numbers of the limit.
        force: into the limit [N m, N]; 0 or less: no deflection.
        inertia: along the coordinate [kg m2, kg].
    """
    from scipy.optimize import brentq

    if not force > 0:
        return 0.0
    beyond = lambda depth, d: inertia * soft.stiffness * d * d * depth - (1 - d) * force
    least = min(soft.first, soft.last)
    most = (1 - least) * force / (inertia * soft.stiffness * least * least)
    return float(brentq(lambda depth: beyond(depth, soft.impedance(depth)), 0.0, 2 * most))


def pressing(model: Any, k: int) -> tuple[float, float]:
    """Forces [N m, N] by which weight and springs press a joint at rest into its lower and its
    upper limit, the others in the reference configuration; negative where they pull it away."""
    low, high = (steady_force(model, k, float(at)) for at in model.jnt_range[k])
    return -low, high


def steady_force(model: Any, k: int, at: float) -> float:
    """Force [N m, N] of weight and springs on the coordinate of a joint at rest, by MuJoCo.

    Args:
        model: MuJoCo's; other joints stand in its reference configuration.
        k: index of the joint.
        at: its coordinate in MuJoCo's count [rad, m].
    """
    import mujoco

    data, dof = mujoco.MjData(model), model.jnt_dofadr[k]
    data.qpos[:] = model.qpos0
    data.qpos[model.jnt_qposadr[k]] = at
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    return float(data.qfrc_spring[dof] - data.qfrc_bias[dof])


# A way [rad, m] over which a limit's damping sets in, where the model has it set in at once.
LEAST_DEPTH = 1e-6
# What gives way is said from this share of a limit's width on; whether it does so as in MuJoCo, to
# this share of how far.
REPORTED_SHARE, SAME_SHARE = 0.01, 0.05
# What a limit is right for, as the module says.
STOPS = ("steady", "impact")


def loads_of(
    model: Any, joints: list[str], stops: str = "steady"
) -> Iterator[tuple[str, AbstractLoad]]:
    """Loads on the coordinates of a model's hinges and slides, with their names.

    Args:
        model: MuJoCo's.
        joints: names by index.
        stops: "steady": as soft as MuJoCo's limits under weight at rest; else as in an impact.
    """
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
            yield f"{name} friction", JointFriction(name, float(model.dof_frictionloss[dof]))
        if stopped[k]:
            yield f"{name} limits", _make_stop(model, k, name, stops)


def _make_stop(model: Any, k: int, name: str, stops: str) -> JointStop:
    soft, inertia = limit_is_soft(model, k), _joint_inertia(model, k)
    margin, origin = float(model.jnt_margin[k]), float(model.qpos0[model.jnt_qposadr[k]])
    low, high = (float(x) - origin for x in model.jnt_range[k])
    stiffness = impact = inertia * soft.last**2 * soft.stiffness
    if stops == "steady":
        force = max(pressing(model, k))
        steady = force / sag(soft, force, inertia) if force > 0 else impact / (1 - soft.last)
        stiffness = max(steady, impact)
    # What runs into a limit goes in by its speed times sqrt(inertia / stiffness).
    shorter = (impact / stiffness) ** 0.5
    return JointStop(
        name,
        low + margin,
        high - margin,
        stiffness=stiffness,
        damping=inertia * soft.last * soft.damping / shorter,
        depth=max(soft.width * shorter, LEAST_DEPTH),
    )


def _joint_inertia(model: Any, k: int) -> float:
    """That of a hinge's or slide's coordinate in the reference configuration [kg m^2, kg]."""
    return 1 / float(model.dof_invweight0[model.jnt_dofadr[k]])


class Deflection(NamedTuple):
    """By how much a limit gives way here and in MuJoCo [rad, m] under a force [N m, N] at rest."""

    here: float
    there: float
    force: float


def list_deflections(model: Any, joints: list[str], loads: dict[str, Any]) -> Iterator[str]:
    """Sentences for limits that deflect too far under weight and springs, beside their width.

    Args:
        model: MuJoCo's.
        joints: names by index.
        loads: by name, with the stops (`loads_of`).
    """
    for k, name in enumerate(joints):
        stop = loads.get(f"{name} limits")
        if stop is not None:
            unit = "m" if model.jnt_type[k] == SLIDE else "rad"
            yield from _stop_deflections(model, k, name, stop, unit)


def _stop_deflections(model: Any, k: int, name: str, stop: JointStop, unit: str) -> Iterator[str]:
    soft, inertia = limit_is_soft(model, k), _joint_inertia(model, k)
    spring: Any = stop.stiffness
    stiffness = float(spring)
    deflections = [
        Deflection(force / stiffness, sag(soft, force, inertia), force)
        for force in pressing(model, k)
        if force > 0
    ]
    width = float(np.ptp(model.jnt_range[k]))
    for d in deflections:
        if max(d.here, d.there) > REPORTED_SHARE * width:
            same = abs(d.here - d.there) <= SAME_SHARE * d.there
            there = "as in MuJoCo" if same else f"in MuJoCo by {d.there:.3g} {unit}"
            yield (
                f'limits of "{name}" by {d.here:.3g} {unit} ({d.here / width:.2g} of their '
                f"width) under {_format_force(d.force, unit)}, {there}"
            )


def _format_force(force: float, unit: str) -> str:
    return f"{force:.3g} {'N' if unit == 'm' else 'N m'}"
