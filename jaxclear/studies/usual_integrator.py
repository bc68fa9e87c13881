"""The integrator of a study that asks for none: steps of a fixed length, explicit where contacts
allow it, implicit where films, friction or damping answer faster than explicit steps should be
long.

It is chosen before anything is compiled, from the nominal numbers, so that all samples of a study
are run alike.
"""

import math
from typing import Any

from jaxclear.formulations.contact_rates import ContactRates, contact_rates
from jaxclear.ground.quantity import is_traced, on_host
from jaxclear.integrators import AbstractIntegrator, Adaptive, FixedStep, ImplicitStep
from jaxclear.laws.friction.base import AbstractForceFriction
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.multibody.topology import rubbing_in

# Share of 1 / rate that an explicit step may have in friction and damping: rk4 is stable up to
# 2.78, and damps as it should up to here.
EXPLICIT_SHARE = 2.0
# The same where that is what sets its length.
CAREFUL_SHARE = 1.0
# Shares of 1 / rate that steps have in a contact, so that impacts, and with them friction loss and
# wear, are within 2 %: of explicit steps (the four-bar of jaxclear.commands) and of implicit ones
# (loaded bearings beside `Adaptive` at 1e-9: at 0.1 one of 240 lost 2.2 % too much).
IMPACT_SHARE, IMPLICIT_SHARE = 0.36, 0.09
# The same of implicit steps where bristles creep: at 0.1 a journal's wear was 2.8 % off.
BRISTLE_SHARE = 0.07
# Lengths of steps that a reader takes in at a glance, a decade of them.
ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0)


def usual_integrator(mechanism: Mechanism, duration: Any) -> tuple[AbstractIntegrator, str]:
    """The integrator for a run of `duration` [s], and why, in a sentence; "" for `FixedStep()`,
    which is the usual one."""
    rubbing = [name for name, j in rubbing_in(mechanism.connections).items() if j.friction]
    if rubbing:
        return Adaptive(), (
            f'Run with integrator.Adaptive(), because friction in joint "{rubbing[0]}" follows its '
            "reaction, and how fast it answers is known in the run only."
        )
    explicit = FixedStep()
    step = float(explicit.step)
    numbers = on_host(mechanism)
    films = [name for name in mechanism.topology.clearances if _is_filled(numbers, name)]
    if not (films or _touches(numbers)) or is_traced((mechanism, duration)):
        return explicit, ""
    try:
        rates = contact_rates(mechanism, float(duration), step)
    except ValueError:
        # It cannot start; the run says why.
        return explicit, ""
    # Films are there so that nothing touches behind them.
    rates = {name: rate for name, rate in rates.items() if name not in films}
    if not (rates or films):
        return explicit, ""
    bristles = [joint for joint in rates if _bristles(numbers, joint)]
    allowed, cause = _longest(rates, step) if rates else (step, "")
    contact = max((rate.contact for rate in rates.values()), default=0.0)
    share = BRISTLE_SHARE if bristles else IMPLICIT_SHARE
    implicit = min(step, share / contact) if contact > 0 else step
    if bristles:
        cause = f'friction in joint "{bristles[0]}" remembers deflections that settle at once'
    elif films:
        cause = f'the film in joint "{films[0]}" answers the faster the thinner it is'
    elif allowed >= step:
        return explicit, ""
    usual = f"too fast for the usual explicit steps of {step:.3g} s."
    if bristles or films or _rounded(allowed) < implicit:
        sentence = f"Run with integrator.ImplicitStep({implicit:.3g}, rebound=1.0)"
        return ImplicitStep(implicit, rebound=1.0), f"{sentence}, because {cause}, {usual}"
    sentence = f"Run with integrator.FixedStep({_rounded(allowed):.3g})"
    return FixedStep(_rounded(allowed)), f"{sentence}, because {cause}, {usual}"


def _longest(rates: dict[str, ContactRates], step: float) -> tuple[float, str]:
    """The longest explicit step [s] that contacts allow, and what sets it if that is shorter than
    `step` [s]."""
    name, hardest = max(rates.items(), key=lambda item: item[1].contact)
    impacts = IMPACT_SHARE / hardest.contact if hardest.contact > 0 else math.inf
    place, stiffest = max(rates.items(), key=lambda item: _stiffness(item[1]))
    rate = _stiffness(stiffest)
    friction = CAREFUL_SHARE / rate if rate * step > EXPLICIT_SHARE else math.inf
    if friction < impacts:
        within = f'in joint "{place}" answers within {1 / rate:.2g} s'
        if stiffest.friction < stiffest.damping:
            return friction, f"damping {within}"
        return friction, f"friction {within} under {stiffest.force:.3g} N"
    # Half a vibration of the contact.
    lasts = math.pi * impacts / IMPACT_SHARE
    return impacts, f'an impact in joint "{name}" is over within {lasts:.2g} s'


def _rounded(step: float) -> float:
    """The next shorter length [s] of those in `ROUND`."""
    decade = 10.0 ** math.floor(math.log10(step))
    return max((x for x in ROUND if x * decade <= step), default=ROUND[0]) * decade


def _stiffness(rates: ContactRates) -> float:
    """The faster of friction and damping [1/s]."""
    return max(rates.friction, rates.damping)


def _touches(mechanism: Mechanism) -> bool:
    """Whether a contact may open and close."""
    laws = (
        law.contact
        for joint in mechanism.topology.clearances
        for law in mechanism.connections[joint].joint.contact_laws()
    )
    return any(law.compliant for law in laws)


def _is_filled(mechanism: Mechanism, joint: str) -> bool:
    """Whether a film fills the gap of a joint."""
    return mechanism.connections[joint].joint.gap_load(joint) is not None


def _bristles(mechanism: Mechanism, joint: str) -> bool:
    laws: list[AbstractForceFriction] = [
        law.friction
        for law in mechanism.connections[joint].joint.contact_laws()
        if law.friction is not None and not law.friction.set_valued
    ]
    return any(law.bristles > 0 for law in laws)
