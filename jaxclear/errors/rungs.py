"""The rungs among which steps are chosen, each from coarse to fine, and what a run by them takes.

The first lengths of steps follow from how fast contacts answer (`contact_rates`): longer ones pass
over impacts, and agree with each other in what they all miss.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxclear.formulations.contact_rates import contact_rates
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.fixed_step import USUAL_STEP, FixedStep
from jaxclear.integrators.implicit_step import DAMPED_ITERATIONS, ITERATIONS, ImplicitStep
from jaxclear.integrators.moreau_jean import MoreauJean
from jaxclear.integrators.stepping import SLIVER
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.trajectory import Trajectory

# Evaluations of forces in a step of Dormand and Prince's kind (the last is the next one's first)
# and of the classical Runge-Kutta method.
TSIT5, RK4 = 6, 4
# Share of 1 / rate of a contact that the first steps have: near where rk4 is stable at all.
FIRST_SHARE = 1.44
# Tolerances: the loosest where nothing touches, the tightest; each ten times tighter, which takes
# the fifth root of that more steps. Where joints have clearance looser ones than the usual count as
# the usual (`Adaptive`).
LOOSEST, TIGHTEST, TIGHTER = 1e-4, 1e-12, 0.1
ORDER = 5
ABSOLUTE = 0.01


class Rung(NamedTuple):
    """Settings from `first` on, each followed by a `finer` one (None: by none); `evaluations` of
    forces in a step; whether steps are under error control (`controlled`), and then by what factor
    the work grows from one to the next; how an integrator is `typed`; the
    `usual` one."""

    first: AbstractIntegrator
    finer: Callable[[AbstractIntegrator], AbstractIntegrator | None]
    evaluations: int
    controlled: bool
    growth: float
    typed: Callable[[AbstractIntegrator], str]
    usual: AbstractIntegrator

    def work_of(self, run: Trajectory) -> int:
        """Evaluations of forces that a run took."""
        return self.evaluations * (int(run.accepted_steps) + int(run.rejected_steps))

    def work_before(self, setting: AbstractIntegrator, times: np.ndarray) -> float | None:
        """The same before the run, saved at these times [s]; None where steps follow the motion."""
        step = setting.asked_step()
        if step is None:
            return None
        counts = np.ceil(np.diff(times) / float(step) * (1 - SLIVER))
        return self.evaluations * float(np.sum(np.maximum(counts, 1)))


def rungs_of(
    mechanism: Mechanism, times: np.ndarray, accepts: Callable[[AbstractIntegrator], None]
) -> list[Rung]:
    """Rungs that solve the model of a mechanism as it is stated, for a run saved at these times
    [s]; rigid contact only where no other takes it and no law is compliant. `accepts` raises
    `ValueError` for an integrator that does not suit the mechanism, and so does this where none
    does."""
    laws = [
        own.contact
        for joint in mechanism.topology.clearances
        for own in mechanism.connections[joint].joint.contact_laws()
    ]
    interval = float(np.min(np.diff(times)))
    first = min(interval, _resolved(mechanism, times))
    damped = any(law.restitution is None for law in laws)
    iterations = (DAMPED_ITERATIONS if damped else ITERATIONS) if laws else 0
    implicit = ImplicitStep(first, rebound=1.0)
    rungs = [
        _controlled(bool(laws)),
        _stepping(implicit, "ImplicitStep({:.9g}, rebound=1.0)", 1 + iterations),
        _stepping(FixedStep(first), "FixedStep({:.9g})", RK4),
    ]
    found = [rung for rung in rungs if _suits(rung, accepts)]
    if not found and any(law.compliant for law in laws):
        accepts(rungs[0].first)
    if not found:
        rigid = MoreauJean(min(interval, float(MoreauJean().step)))
        accepts(rigid)
        found = [_stepping(rigid, "MoreauJean({:.9g})", 1)]
    return found


def _suits(rung: Rung, accepts: Callable[[AbstractIntegrator], None]) -> bool:
    try:
        accepts(rung.first)
    except ValueError:
        return False
    return True


def _controlled(touches: bool) -> Rung:
    """Steps under error control; `touches`: some joint has clearance."""
    usual = Adaptive()
    loosest = float(usual.rtol) if touches else LOOSEST

    def finer(setting):
        rtol = TIGHTER * float(setting.rtol)
        return _at(rtol) if rtol > TIGHTEST * (1 - SLIVER) else None

    def typed(setting):
        return f"Adaptive(rtol={float(setting.rtol):.3g}, atol={float(setting.atol):.3g})"

    first = usual if touches else _at(loosest)
    return Rung(first, finer, TSIT5, True, TIGHTER ** (-1 / ORDER), typed, usual)


def _at(rtol: float) -> Adaptive:
    return Adaptive(rtol=rtol, atol=ABSOLUTE * rtol)


def _stepping(first: AbstractIntegrator, typed: str, evaluations: int) -> Rung:
    """Steps of a length, each setting half as long as the one before."""
    told = lambda setting: typed.format(float(setting.asked_step()))
    return Rung(first, lambda own: own.with_finer_steps(0.5), evaluations, False, 2.0, told, first)


def _resolved(mechanism: Mechanism, times: np.ndarray) -> float:
    """The longest step [s] that resolves a contact; endless where none may open and close."""
    if not mechanism.topology.clearances:
        return math.inf
    duration = float(times[-1] - times[0])
    rates = contact_rates(mechanism, duration, min(USUAL_STEP, duration)).values()
    fastest = max((rate.contact for rate in rates), default=0.0)
    return _shortened(FIRST_SHARE / fastest) if fastest > 0 else math.inf


def _shortened(step: float) -> float:
    """The next shorter length [s] of two digits, which is told as it is."""
    power = math.floor(math.log10(step)) - 1
    return float(f"{math.floor(step / 10.0**power)}e{power}")
