"""The rungs that are tried, with steps and tolerances drawn at random, and what each is compared
with.

A rung is judged by its own model: compliant rungs by `Adaptive` at two tight tolerances, rigid
contact and joints that always touch by their own steps at two short lengths. What a model is off
is another question (`benchmarks.claims.work_precision`).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jaxclear as jc
from benchmarks.attacks.bearings import Case
from benchmarks.attacks.numbers import Draw
from jaxclear.integrators.base import STUDIES, Promise
from jaxclear.studies.usual_integrator import usual_integrator

I = jc.integrator  # noqa: E741


class Rung(NamedTuple):
    """`make(draw, case)`: the integrator, None for the one that `simulate` takes unasked;
    `promised`: what it is held to (None: to what its integrator promises)."""

    make: Callable[[Draw, Case], Any]
    model: str = "compliant"
    promised: Promise | None = None


def promise_of(rung: Rung, integrator: Any) -> Promise:
    """What this integrator of a rung is held to."""
    return rung.promised or (integrator or I.Adaptive()).promise


# Steps [s] are drawn about those that the book names.
RUNGS: dict[str, Rung] = {
    "default": Rung(lambda n, _: None),
    "default of studies": Rung(lambda _, case: of_studies(case), promised=STUDIES),
    "FixedStep as it comes": Rung(lambda n, _: I.FixedStep(), promised=STUDIES),
    "Adaptive, tight": Rung(lambda n, _: _adaptive(n.log(1e-9, 1e-7, 1e-8))),
    "Adaptive, loose": Rung(lambda n, _: _adaptive(n.log(1e-6, 1e-4, 1e-5))),
    "FixedStep": Rung(lambda n, _: I.FixedStep(n.log(1e-6, 1e-4, 2e-5))),
    "FixedStep semi_implicit": Rung(
        lambda n, _: I.FixedStep(n.log(1e-6, 1e-4, 1e-5), "semi_implicit")
    ),
    "FixedStep heun": Rung(lambda n, _: I.FixedStep(n.log(1e-6, 1e-4, 1e-5), "heun")),
    "FixedStep, contact_steps": Rung(
        lambda n, _: I.FixedStep(n.log(1e-5, 1e-3, 1e-4), contact_steps=20)
    ),
    "FixedStep munthe_kaas4": Rung(
        lambda n, _: I.FixedStep(n.log(1e-6, 1e-4, 2e-5), "munthe_kaas4")
    ),
    "ImplicitStep": Rung(lambda n, _: I.ImplicitStep(n.log(1e-5, 1e-3, 1e-4))),
    "MoreauJean": Rung(lambda n, _: I.MoreauJean(n.log(1e-5, 1e-3, 1e-4)), "rigid"),
    "NonColliding": Rung(lambda n, _: I.NonColliding(n.log(1e-4, 1e-2, 1e-3)), "permanent"),
}
# Steps [s] of references.
SHORTEST = 5e-7
# Every mechanism is run on these, and on some of the others in turn.
ALWAYS = ("default", "default of studies", "Adaptive, loose", "ImplicitStep")
# Behind those that take turns, so that these keep their numbers.
LAST = ("FixedStep as it comes",)
TAKING_TURNS = tuple(name for name in RUNGS if name not in ALWAYS + LAST)


def _adaptive(rtol: float) -> Any:
    return I.Adaptive(rtol=rtol, atol=1e-2 * rtol)


def of_studies(case: Case) -> Any:
    """What a `Problem` of this mechanism takes when no integrator is given."""
    return usual_integrator(case.mechanism, case.duration)[0]


def references(model: str, step: float | None) -> tuple[Any, Any]:
    """The looser and the tighter reference of a model; `step` [s] is that of the rung."""
    if model == "compliant":
        return _adaptive(1e-9), _adaptive(1e-10)
    kind = {"rigid": I.MoreauJean, "permanent": I.NonColliding}[model]
    # No shorter than what ends in a minute: a run of still shorter steps is compared with these.
    return kind(max(step / 16, 2 * SHORTEST)), kind(max(step / 32, SHORTEST))
