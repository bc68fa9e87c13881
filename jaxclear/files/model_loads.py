r"""What acts on the hinges and slides of a model of MuJoCo, as loads on their coordinates: damping
and stiffness, armature, dry friction, limits.

MuJoCo holds limits and dry friction by soft constraints (`model_softness`), :math:`a = (1 - d) a_0
- d (b v + k d r)` as long as the force pushes (a limit's) or is less than the bound (friction's).
Here they are forces on the inertia :math:`m` that the coordinate has in the reference
configuration. MuJoCo weakens by d what presses into a limit, too; a spring and a damper do not, so
they are right in one of two cases:

- "steady": a limit gives way under weight and springs as far as in MuJoCo; where none press into
  it, under any force as far as in MuJoCo deep within it, :math:`m d^2 k / (1 - d)`. The damper has
  MuJoCo's own damping ratio :math:`b / (2 \sqrt{k})`.
- "impact": it stops what runs into it as in MuJoCo, :math:`m d^2 k` and :math:`m d b`, right for
  :math:`a_0 = 0`; under a steady load it gives way 1 / (1 - d) times as far.

Friction has the speed :math:`v_0 = \tau (1 - d) / (m d b)` at which a small steady load creeps as
fast.
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
from jaxclear.files.model_softness import limit_is_soft, pressing, sag, soft_of, steady_force
from jaxclear.files.mujoco_model import SLIDE, SPHERICAL, has_stop

__all__ = ["STOPS", "gives_way", "loads_of"]

# A way [rad, m] over which a limit's damping sets in, where the model has it set in at once.
AT_ONCE = 1e-6
# What gives way is said from this share on: of a limit's width, of what friction holds; whether a
# limit does so as in MuJoCo, to this share of how far.
SAID, ALIKE = 0.01, 0.05
# What a limit is right for, as the module says.
STOPS = ("steady", "impact")


def loads_of(
    model: Any, joints: list[str], stops: str = "steady", sticking: bool = False
) -> Iterator[tuple[str, AbstractLoad]]:
    """Loads on the coordinates of a model's hinges and slides, by name. `sticking`: their joints
    have the friction themselves."""
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
        if model.dof_frictionloss[dof] > 0 and not sticking:
            yield f"{name} friction", _friction(model, dof, name)
        if stopped[k]:
            yield f"{name} limits", _stop(model, k, name, stops)


def _friction(model: Any, dof: int, name: str) -> JointFriction:
    soft = soft_of(model, model.dof_solref[dof], model.dof_solimp[dof])
    if soft.damping <= 0:
        raise ValueError(
            f'solreffriction of joint "{name}" has damping 0; dry friction brings a joint to rest '
            'by it, so it must not be 0, as in the usual solreffriction="0.02 1".'
        )
    torque = float(model.dof_frictionloss[dof])
    creep = (1 - soft.first) / (soft.first * soft.damping)
    return JointFriction(name, torque, torque * creep * float(model.dof_invweight0[dof]))


def _stop(model: Any, k: int, name: str, stops: str) -> JointStop:
    soft, inertia = limit_is_soft(model, k), _inertia(model, k)
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
        depth=max(soft.width * shorter, AT_ONCE),
    )


def _inertia(model: Any, k: int) -> float:
    """That of a hinge's or slide's coordinate in the reference configuration [kg m^2, kg]."""
    return 1 / float(model.dof_invweight0[model.jnt_dofadr[k]])


class Given(NamedTuple):
    """By how much a limit gives way here and in MuJoCo [rad, m] under a force [N m, N] at rest."""

    here: float
    there: float
    force: float


def gives_way(model: Any, joints: list[str], loads: dict[str, Any]) -> Iterator[str]:
    """What gives way under weight and springs, in words: limits by more than a share of their
    width, friction that creeps under more than a share of what it holds."""
    for k, name in enumerate(joints):
        unit = "m" if model.jnt_type[k] == SLIDE else "rad"
        stop, friction = loads.get(f"{name} limits"), loads.get(f"{name} friction")
        if stop is not None:
            yield from _stop_gives_way(model, k, name, stop, unit)
        if friction is not None:
            yield from _friction_creeps(model, k, name, friction, unit)


def _stop_gives_way(model: Any, k: int, name: str, stop: JointStop, unit: str) -> Iterator[str]:
    soft, inertia = limit_is_soft(model, k), _inertia(model, k)
    found = [
        Given(force / float(stop.stiffness), sag(soft, force, inertia), force)
        for force in pressing(model, k)
        if force > 0
    ]
    width = float(np.ptp(model.jnt_range[k]))
    for own in found:
        if max(own.here, own.there) > SAID * width:
            alike = abs(own.here - own.there) <= ALIKE * own.there
            there = "as in MuJoCo" if alike else f"in MuJoCo by {own.there:.3g} {unit}"
            yield (
                f'limits of "{name}" by {own.here:.3g} {unit} ({own.here / width:.2g} of their '
                f"width) under {_force(own.force, unit)}, {there}"
            )


def _friction_creeps(
    model: Any, k: int, name: str, friction: JointFriction, unit: str
) -> Iterator[str]:
    force = abs(steady_force(model, k, float(model.qpos0[model.jnt_qposadr[k]])))
    share = force / float(friction.torque)
    if SAID < share < 1:
        speed = float(friction.transition_speed) * np.arctanh(share)
        yield (
            f'friction of "{name}" by creeping at {speed:.3g} {unit}/s under '
            f"{_force(force, unit)}, {share:.2g} of what it holds (sticking=True holds it)"
        )


def _force(force: float, unit: str) -> str:
    return f"{force:.3g} {'N' if unit == 'm' else 'N m'}"
