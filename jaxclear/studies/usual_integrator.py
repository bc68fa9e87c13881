"""The integrator of a study that asks for none: steps of a fixed length, explicit where contacts
allow it, implicit where friction or damping answer faster than such a step.

It is chosen before anything is compiled, from the nominal numbers, so that all samples of a study
are run alike.
"""

from typing import Any

from jaxclear.formulations.contact_rates import ContactRates, contact_rates
from jaxclear.ground.quantity import is_traced
from jaxclear.integrators import AbstractIntegrator, FixedStep, ImplicitStep
from jaxclear.laws.friction.base import AbstractForceFriction
from jaxclear.multibody.mechanism import Mechanism

# Share of 1 / rate that an explicit step may have in friction and damping: rk4 is stable up to
# 2.78, and damps as it should up to here.
EXPLICIT_SHARE = 2.0
# Share of 1 / rate that an implicit step has in a contact, so that impacts, and with them friction
# loss and wear, are within 2 % (benchmarks/claims/loaded_bearing.py).
IMPLICIT_SHARE = 0.1


def usual_integrator(mechanism: Mechanism, duration: Any) -> tuple[AbstractIntegrator, str]:
    """The integrator for a run of `duration` [s], and why, in a sentence; "" for `FixedStep()`,
    which is the usual one."""
    explicit = FixedStep()
    step = float(explicit.step)
    if not _rubs(mechanism) or is_traced((mechanism, duration)):
        return explicit, ""
    try:
        rates = contact_rates(mechanism, float(duration), step)
    except ValueError:
        # It cannot start; the run says why.
        return explicit, ""
    if not rates:
        return explicit, ""
    name, hardest = max(rates.items(), key=lambda item: _stiffness(item[1]))
    bristles = [joint for joint in rates if _bristles(mechanism, joint)]
    too_fast = step * _stiffness(hardest) > EXPLICIT_SHARE
    if not (too_fast or bristles):
        return explicit, ""
    contact = max(rate.contact for rate in rates.values())
    short = min(step, IMPLICIT_SHARE / contact) if contact > 0 else step
    if too_fast:
        cause = (
            f'friction in joint "{name}" answers within {1 / _stiffness(hardest):.2g} s under '
            f"{hardest.force:.3g} N"
        )
    else:
        cause = f'friction in joint "{bristles[0]}" remembers deflections that settle at once'
    sentence = (
        f"Run with integrator.ImplicitStep({short:.3g}, rebound=1.0), because {cause}, too fast "
        f"for the usual explicit steps of {step:.3g} s."
    )
    return ImplicitStep(short, rebound=1.0), sentence


def _stiffness(rates: ContactRates) -> float:
    """The faster of friction and damping [1/s]."""
    return max(rates.friction, rates.damping)


def _laws(mechanism: Mechanism, joint: str) -> list[AbstractForceFriction]:
    laws = mechanism.connections[joint].joint.contact_laws()
    return [x.friction for x in laws if x.friction is not None and not x.friction.set_valued]


def _rubs(mechanism: Mechanism) -> bool:
    return any(_laws(mechanism, joint) for joint in mechanism.topology.clearances)


def _bristles(mechanism: Mechanism, joint: str) -> bool:
    return any(law.bristles > 0 for law in _laws(mechanism, joint))
