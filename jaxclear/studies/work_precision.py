"""Which settings an advisor tries: every kind of integrator from long steps to short ones.

Steps go down in numbers a person would choose (1, 2, 5), from the saving interval on. Tolerances go
down (1, 3) to the reference's.
"""

from collections.abc import Iterator, Mapping, Sequence

import equinox as eqx
import numpy as np

from jaxclear.integrators import AbstractIntegrator, Adaptive, FixedStep, ImplicitStep
from jaxclear.studies.problem import Problem

# Integrators by the name of their method, each from coarse to fine.
Candidates = Mapping[str, Sequence[AbstractIntegrator]]

# Tolerances of the reference, and how much looser the run is that tells how far it can be trusted.
REFERENCE_RTOL, REFERENCE_ATOL, LOOSER = 1e-10, 1e-12, 10.0
# Steps tried [s]: from a hundredth of a second, which no machine is still at, to a
# hundred-thousandth of the period of 1e4 rad/s, where a journal on steel bounces.
LONGEST, SHORTEST = 1e-2, 1e-8
# Short steps in contact to one in flight: as far as a bounce is stiffer than the motion in most
# bearings.
SHORT_STEPS = 20.0
# Decades of tolerance between the loosest try and the reference; the last of them is its looser
# run.
DECADES = 7


def tight_reference() -> Adaptive:
    """What is taken for the truth by default."""
    return Adaptive(rtol=REFERENCE_RTOL, atol=REFERENCE_ATOL)


def loosened(integrator: Adaptive, factor: float) -> Adaptive:
    """The same solver, its tolerances `factor` times as large."""
    return eqx.tree_at(
        lambda i: (i.rtol, i.atol), integrator, (integrator.rtol * factor, integrator.atol * factor)
    )


def steps(longest: float) -> Iterator[float]:
    """1, 2 or 5 times a power of ten, from at most `longest` down."""
    for power in range(int(np.floor(np.log10(longest))), int(np.log10(SHORTEST)) - 1, -1):
        for digit in (5, 2, 1):
            if float(f"{digit}e{power}") <= longest * (1 + 1e-9):
                yield float(f"{digit}e{power}")


def _factors() -> Iterator[float]:
    """1 or 3 times a power of ten, from `DECADES` of them down to one."""
    for decade in range(DECADES, 1, -1):
        yield from (10.0**decade, 3 * 10.0 ** (decade - 1))
    yield 10.0


def default_candidates(problem: Problem, tight: Adaptive) -> dict[str, list[AbstractIntegrator]]:
    """The kinds that jaxclear has, coarse to fine. Without clearances nothing has a contact to take
    short steps in.
    """
    interval = float(np.max(np.diff(problem.shares * problem.duration)))
    lengths = list(steps(min(LONGEST, interval)))
    candidates: dict[str, list[AbstractIntegrator]] = {
        "Adaptive": [loosened(tight, factor) for factor in _factors()],
        "FixedStep rk4": [FixedStep(step) for step in lengths],
        "ImplicitStep": [ImplicitStep(step) for step in lengths],
        "FixedStep semi_implicit": [FixedStep(step, method="semi_implicit") for step in lengths],
    }
    if problem.mechanism.topology.clearances:
        candidates["FixedStep contact_steps"] = [
            FixedStep(step, contact_steps=SHORT_STEPS) for step in lengths
        ]
    return candidates


def check_candidates(candidates: Candidates, reserved: tuple[str, ...]) -> None:
    """Raises `ValueError` with a sentence for what cannot be tried, and for `reserved` names."""
    if not isinstance(candidates, Mapping) or not candidates:
        raise ValueError(
            f"candidates is {candidates!r}; it must name one or more sequences of integrators, "
            "coarse to fine."
        )
    for name, settings in candidates.items():
        if name in reserved:
            raise ValueError(f'no method may be called "{name}"; the advice has one of that name.')
        known = isinstance(settings, Sequence) and settings
        if not known or not all(isinstance(i, AbstractIntegrator) for i in settings):
            raise ValueError(
                f'candidates["{name}"] is {settings!r}; it must be a sequence of integrators, '
                "coarse to fine."
            )
