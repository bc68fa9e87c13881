"""The rungs among which steps are chosen, each from coarse to fine, and what a run by them takes.

The first lengths of steps follow from how fast contacts answer (`contact_rates`): longer ones pass
over impacts, and agree with each other in what they all miss.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxclear.formulations.contact_rates import contact_rates
from jaxclear.integrators.adaptive import Adaptive
from jaxclear.integrators.base import SLIVER, AbstractIntegrator
from jaxclear.integrators.fixed_step import USUAL_STEP, FixedStep
from jaxclear.integrators.implicit_step import ImplicitStep
from jaxclear.integrators.moreau_jean import MoreauJean
from jaxclear.integrators.non_colliding import NonColliding
from jaxclear.multibody.mechanism import Mechanism

# Share of 1 / rate of a contact that the first steps have: near where rk4 is stable at all.
FIRST_SHARE = 1.44
# Tolerances: the loosest where nothing touches, the tightest; each ten times tighter, which takes
# the fifth root of that more steps. Where joints have clearance looser ones than the usual count as
# the usual (`Adaptive`).
LOOSEST, TIGHTEST, TIGHTER = 1e-4, 1e-12, 0.1
ORDER = 5
ABSOLUTE = 0.01
# What a setting of a rung is to the one before, by its steps or by the errors of its tolerances.
HALF = 0.5
# Short steps in contact to one in flight: as far as a bounce is stiffer than the motion in most
# bearings.
SHORT_STEPS = 20.0


class Rung(NamedTuple):
    """Settings from `first` on, each followed by a `finer` one (None: by none); `evaluations` of
    forces in a step; whether steps are under error control (`controlled`), and then by what factor
    the work grows from one to the next (`growth`)."""

    first: AbstractIntegrator
    finer: Callable[[AbstractIntegrator], AbstractIntegrator | None]
    evaluations: int
    controlled: bool = False
    growth: float = 2.0

    def work_of(self, run: Any) -> int:
        """Evaluations of forces that a run took."""
        return self.evaluations * (int(run.accepted_steps) + int(run.rejected_steps))

    def work_before(self, setting: AbstractIntegrator, times: np.ndarray) -> float | None:
        """The same before the run, saved at these times [s]; None where steps follow the motion."""
        step, counted = setting.asked_step(), setting.steps_between_saves
        if counted is not None:
            return float(self.evaluations * counted * (len(times) - 1))
        if step is None:
            return None
        counts = np.ceil(np.diff(times) / float(step) * (1 - SLIVER))
        return self.evaluations * float(np.sum(np.maximum(counts, 1)))

    def share(self, setting: AbstractIntegrator, finer: AbstractIntegrator) -> float | None:
        """The share of its steps that a finer setting has; None where nobody knows."""
        step, shorter = setting.asked_step(), finer.asked_step()
        return None if step is None or shorter is None else float(shorter / step)


def rungs_of(
    mechanism: Mechanism, times: np.ndarray, accepts: Callable[[AbstractIntegrator], None]
) -> list[Rung]:
    """Rungs that solve the model of a mechanism as it is stated, for a run saved at these times
    [s]; rigid contact only where no other takes it and no law is compliant. `accepts` raises
    `ValueError` for an integrator that does not suit the mechanism, and so does this where none
    does."""
    first = _first(mechanism, times)
    rungs = [
        _controlled(mechanism),
        halving(ImplicitStep(first, rebound=1.0), mechanism),
        halving(FixedStep(first), mechanism),
    ]
    found = [rung for rung in rungs if _suits(rung, accepts)]
    if not found and _complies(mechanism):
        accepts(rungs[0].first)
    if not found:
        interval = float(np.min(np.diff(times)))
        rigid = MoreauJean(min(interval, float(MoreauJean().step)))
        accepts(rigid)
        found = [halving(rigid, mechanism)]
    return found


def others_of(
    mechanism: Mechanism, times: np.ndarray, accepts: Callable[[AbstractIntegrator], None]
) -> tuple[list[Rung], list[Rung]]:
    """Further rungs that solve the model of a mechanism as it is stated: of order 1, or with short
    steps in contact alone; and those of other models of contact, rigid and permanent."""
    first, interval = _first(mechanism, times), float(np.min(np.diff(times)))
    rungs = [FixedStep(first, "semi_implicit")]
    models: list[AbstractIntegrator] = []
    if mechanism.topology.clearances:
        rungs.append(FixedStep(min(interval, SHORT_STEPS * first), contact_steps=SHORT_STEPS))
    if _complies(mechanism):
        models = [
            type(own)(min(_shortened(interval), float(own.step)))
            for own in (MoreauJean(), NonColliding())
        ]
    halved = ([halving(own, mechanism) for own in each] for each in (rungs, models))
    stated, other = ([rung for rung in each if _suits(rung, accepts)] for each in halved)
    return stated, other


def listed_rung(settings: Sequence[AbstractIntegrator], mechanism: Mechanism) -> Rung:
    """A rung of these settings, coarse to fine."""
    settings = list({id(own): own for own in settings}.values())
    places = dict(zip(map(id, settings), settings[1:], strict=False))
    first = settings[0]
    controlled = first.asked_step() is None and first.steps_between_saves is None
    growth = TIGHTER ** (-1 / ORDER) if controlled else 1 / HALF
    follow = lambda own: places.get(id(own))
    return Rung(first, follow, first.evaluations(mechanism), controlled, growth)


def halving(first: AbstractIntegrator, mechanism: Mechanism) -> Rung:
    """Steps of a length, each setting half as long as the one before."""
    return Rung(first, lambda own: own.with_finer_steps(HALF), first.evaluations(mechanism))


def _suits(rung: Rung, accepts: Callable[[AbstractIntegrator], None]) -> bool:
    try:
        accepts(rung.first)
    except ValueError:
        return False
    return True


def _complies(mechanism: Mechanism) -> bool:
    """Whether a contact of the mechanism has an elastic law."""
    joints = [mechanism.connections[name].joint for name in mechanism.topology.clearances]
    return any(own.contact.compliant for joint in joints for own in joint.contact_laws())


def _controlled(mechanism: Mechanism) -> Rung:
    """Steps under error control."""
    usual = Adaptive()
    first = usual if mechanism.topology.clearances else _at(LOOSEST)

    def finer(setting):
        rtol = TIGHTER * float(setting.rtol)
        return _at(rtol) if rtol > TIGHTEST * (1 - SLIVER) else None

    return Rung(first, finer, usual.evaluations(mechanism), True, TIGHTER ** (-1 / ORDER))


def _at(rtol: float) -> Adaptive:
    return Adaptive(rtol=rtol, atol=ABSOLUTE * rtol)


def _first(mechanism: Mechanism, times: np.ndarray) -> float:
    """The longest step [s] of a run saved at these times [s] that resolves its contacts."""
    return min(float(np.min(np.diff(times))), _resolved(mechanism, times))


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
