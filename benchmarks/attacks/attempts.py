"""One run as a user makes it, the references that judge it, and what is found.

References are one run of the tight reference, one of the looser, and one of the looser for numbers
that are off in the fifth digit. Forces at saved instants also say how far every second instant
tells something else than the others: impacts shorter than that time are caught by chance. Compliant
references are saved so often that their peaks are those of the saved instants.
"""

import warnings
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxclear as jc
from benchmarks.attacks import answers, rungs, verdicts
from benchmarks.attacks.bearings import Case
from benchmarks.attacks.verdicts import Verdict
from jaxclear.integrators.base import Promise

# By how much the numbers of a mechanism are never known: answers that this changes beyond the
# accuracy are no run's to give.
NUDGE = 1e-5
# Saving times of a compliant reference for each of a run: its peaks are the largest forces there,
# which the responses that are judged have no part in.
DENSE = 100
NONE: Mapping[str, Any] = MappingProxyType({})


class Asked(NamedTuple):
    """How a case is run: number of saving times, whether the energy balance is kept, how often it
    is saved for each of these times, and whether replicas tell its errors."""

    saves: int = 201
    balance: bool = True
    every: int = 1
    verify: bool = True


class Attempt(NamedTuple):
    """What came of a run: its answers, or the sentence it ended with; `raw`: no sentence but a
    traceback; `warned`: the responses that its warnings concern, `sentences` the warnings; `told`:
    the errors that it tells of its responses, as shares."""

    answers: Any
    ended: str
    raw: bool = False
    warned: frozenset[str] = frozenset()
    sentences: tuple[str, ...] = ()
    told: Mapping[str, float] = NONE


class Finding(NamedTuple):
    """Verdict on a run; verdicts, errors and doubts (how far references are apart) by response,
    what was said, the responses that were warned of, the errors that the run told of them, what is
    promised of them, and how far the references of these very numbers are apart."""

    verdict: Verdict
    verdicts: dict[str, Verdict]
    errors: dict[str, float]
    doubts: dict[str, float]
    said: tuple[str, ...]
    warned: frozenset[str] = frozenset()
    told: Mapping[str, float] = NONE
    limits: Mapping[str, float | None] = NONE
    between: Mapping[str, float] = NONE


def attempt(case: Case, integrator: Any, asked: Asked) -> Attempt:
    """Run a case as a user would."""
    try:
        with warnings.catch_warnings():
            # That steps are shortened to the saving times is no doubt about the answers.
            warnings.simplefilter("ignore")
            run = _run(case, integrator, asked)
        if not run.succeeded:
            return Attempt(None, run.result)
        wears = answers.surfaces(case.mechanism)
        found, told = answers.read(run, asked.balance, wears, asked.every), answers.told(run)
        shared = verdicts.OF_ALL_MODELS if case.seated else verdicts.OF_THE_MODEL
        promised = (integrator or jc.integrator.Adaptive()).promise
        warned = verdicts.concerned(run, told, promised, shared)
        return Attempt(found, "", False, warned, run.warnings, told)
    except ValueError as error:
        return Attempt(None, str(error))
    except Exception as error:
        return Attempt(None, f"{type(error).__name__}: {error}", True)


def _run(case: Case, integrator: Any, asked: Asked) -> jc.Trajectory:
    return jc.simulate(
        case.mechanism,
        case.duration,
        integrator=integrator,
        save=asked.every * (asked.saves - 1) + 1,
        state=_begin(case, integrator),
        balance=asked.balance,
        throw=False,
        verify=asked.verify,
    )


def _begin(case: Case, integrator: Any) -> jc.State | None:
    """Where a case begins. Joints that always touch are seated by themselves."""
    if case.seated:
        always = isinstance(integrator, jc.integrator.NonColliding)
        return None if always else jc.resting_state(case.mechanism)
    return jc.State(concentric=case.concentric)


def judges(case: Case, model: str, step: float | None, asked: Asked) -> tuple[Attempt, ...]:
    """The references: the tight one, the looser one, and that of slightly other numbers."""
    loose, tight = rungs.references(model, step)
    rig = case.reference or case.mechanism
    near = nudged(rig)
    asked = asked._replace(verify=False)
    if model == "compliant" and rig.topology.clearances:
        asked = asked._replace(every=DENSE)
    return tuple(
        attempt(case._replace(mechanism=one), integrator, asked)
        for one, integrator in ((rig, tight), (rig, loose), (near, loose))
    )


def nudged(rig: jc.Mechanism) -> jc.Mechanism:
    """The mechanism with every number off by `NUDGE`, up or down at random, but those that are 1:
    shares may not be more, nor the coarseness of cells less."""
    signs = np.random.default_rng(0)

    def moved(leaf: Any) -> Any:
        if not eqx.is_inexact_array(leaf):
            return leaf
        share = 1 + NUDGE * signs.choice([-1.0, 1.0])
        return jnp.where(leaf == 1, leaf, leaf * share)

    return jax.tree.map(moved, rig)


def find(run: Attempt, known: tuple[Attempt, ...], promise: Promise) -> Finding:
    """The verdict on a run beside its references, held to what is promised of it."""
    said = tuple(sentence for sentence in (run.ended, *run.sentences) if sentence)
    if run.raw:
        return Finding(Verdict.RAW, {}, {}, {}, said)
    if run.answers is None:
        return Finding(Verdict.REFUSED, {}, {}, {}, said)
    if any(one.answers is None for one in known):
        why = tuple(f"reference: {one.ended}" for one in known if one.ended)
        verdict = Verdict.SAID if run.warned else Verdict.NO_REFERENCE
        return Finding(verdict, {}, {}, {}, said + why)
    tight, loose, near = (one.answers for one in known)
    errors = answers.apart(run.answers, tight)
    doubts, spread = answers.apart(loose, tight), answers.apart(near, tight)
    sampled = answers.sampling(tight)
    spread = {name: max(value, sampled.get(name, value)) for name, value in spread.items()}
    found = verdicts.judged(errors, doubts, spread, promise, run.warned)
    unsure = {name: max(doubts[name], spread[name]) for name in errors}
    verdict = verdicts.worst(found.values())
    limits = verdicts.accuracy(promise)
    return Finding(verdict, found, errors, unsure, said, run.warned, run.told, limits, doubts)
