"""A run and its replicas: the numerical errors of its standard answers, and of any other.

An error that falls in proportion to the step is twice what half of it changes, one that falls
faster is less (Richardson). Where a first replica finds something beyond half of what the
integrator promises, a second one with quarter steps is asked, as two runs may agree by chance; and
where paths in gaps have parted, a replica of the finer run whose start is moved in the tenth digit:
if these two agree, steps were too long; if not, the path is no answer.

Sources: Richardson 1911, Phil. Trans. R. Soc. A 210, 307, doi:10.1098/rsta.1911.0009; Roache 1994,
J. Fluids Eng. 116, 405, doi:10.1115/1.2910291.
"""

import dataclasses
import math
from collections.abc import Callable

import jax
import numpy as np

from jaxclear.errors.accuracy import Asked, Seen
from jaxclear.errors.observables import parted
from jaxclear.errors.replicas import Replica, replica, thinned
from jaxclear.errors.told import HALF, QUARTER, Failed, Verified, richardson
from jaxclear.ground.quantity import is_traced
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.multibody.reach import narrowest
from jaxclear.native import stoppable
from jaxclear.results.trajectory import Trajectory
from jaxclear.results.verification import AbstractVerification, Unverified

# Share of the promise from which on a second replica is asked.
DOUBT = 0.5
# Steps of a run up to which its replicas are run unasked: seconds in any mechanism.
MOST_STEPS = 100_000
# By how much of a radian or of a metre the start of a replica is moved.
TENTH_DIGIT = 1e-10
OF_A_REPLICA = "a replica of another run"


def verified(
    run: Trajectory,
    integrator: AbstractIntegrator,
    again: Callable[..., Trajectory],
    verify: bool | None,
    asked: Asked | None = None,
) -> Trajectory:
    """The run with what its replicas tell; `again(replica, moved)`: the same run as that
    `Replica` is made, its start moved by so much. `verify`: whether replicas are run (None: where
    they take seconds at the most). `asked`: the accuracy (None: what the integrator promises). What
    goes wrong in replicas, Ctrl-C too, leaves the run as it is."""
    asked = Asked(integrator.promise) if asked is None else asked
    why = _why_not(run, verify)
    known: AbstractVerification = Unverified(_and_chosen(why, asked))
    if not why:
        try:
            with stoppable():
                known = _verification(run, integrator, again, asked)
        except KeyboardInterrupt:
            known = Unverified("interrupted")
        except (MemoryError, jax.errors.JaxRuntimeError) as error:
            reason = str(error).partition("\n")[0] or "out of memory"
            known = Unverified(f"a replica could not be run: {reason}")
    return dataclasses.replace(run, verification=known)


def _and_chosen(why: str, asked: Asked) -> str:
    return f"{why}. {asked.why.removesuffix('.')}" if asked.why else why


def _verification(
    run: Trajectory, integrator: AbstractIntegrator, again: Callable[..., Trajectory], asked: Asked
) -> AbstractVerification:
    own, counting = asked.seen(run), integrator
    if own.standard.rooms is not None:
        counting = integrator.counting_in(
            narrowest(own.standard.rooms, own.standard.arm), own.standard.arm
        )
    found = [replica(counting, run.time, share) for share in (HALF, QUARTER)]
    plans = [plan for plan in found if plan is not None]
    if len(plans) < len(found):
        return Unverified("its steps cannot be refined")

    def repeated(plan: Replica, moved: float = 0.0) -> Trajectory:
        return thinned(again(plan, moved), plan.every)

    replicas: list[Trajectory] = []
    seen: list[Seen] = []
    for plan in plans:
        replicas.append(repeated(plan))
        if not replicas[-1].succeeded:
            return Failed(replicas[-1].result)
        seen.append(asked.seen(replicas[-1]))
        rows = list(zip(*(asked.apart(run, own, other, seen[-1]) for other in seen), strict=True))
        promised = np.array([_number(asked.promised(row[-1])) for row in rows])
        shares = np.array([float(richardson([each.share for each in row])) for row in rows])
        if not np.any(~np.isnan(promised) & ~(shares <= DOUBT * promised)):
            break
    errors = [float(richardson([each.off for each in row])) for row in rows]
    numbers = np.stack([[row[0].value for row in rows], errors, shares, promised], axis=1)
    path, lost = None, np.zeros(len(rows), bool)
    gaps = np.array([row[0].part == "gaps" for row in rows])
    if np.any(gaps & ~np.isnan(promised) & ~(shares <= promised)):
        limit = float(np.nanmin(promised[gaps]))
        path, lost = _lost(run, asked, seen[0], repeated(plans[0], TENTH_DIGIT), limit)
    known = tuple(
        dataclasses.replace(each, verification=Unverified(OF_A_REPLICA)) for each in replicas
    )
    answers = tuple((row[0].answer, row[0].part, row[0].place, row[0].unit) for row in rows)
    ends = np.asarray(run.time[0]), asked.promise, answers, integrator.remedy, asked.why
    return Verified(known, numbers, lost, path, *ends)


def _number(promised: float | None) -> float:
    return math.nan if promised is None else promised


def _why_not(run: Trajectory, verify: bool | None) -> str:
    """Why a run has no replicas; "" where it is to have some."""
    if verify is False:
        return "verify=False"
    if is_traced((run.outcome, run.states)):
        return "a run that is traced has no replicas"
    if not run.succeeded:
        return "the run ended early"
    if verify is None and int(run.accepted_steps) > MOST_STEPS:
        return f"beyond {MOST_STEPS} steps replicas are run with verify=True"
    return ""


def _lost(
    run: Trajectory, asked: Asked, finer: Seen, moved: Trajectory, limit: float
) -> tuple[np.ndarray | None, np.ndarray]:
    """(from when on [s] a path hangs on the tenth digit of its start, and within which time errors
    grow e-fold [s]; None where it does not; which answers are lost by that), from how far a `finer`
    run and the same with its start `moved` are apart, in gaps by more than the `limit`."""
    other = asked.seen(moved)
    rows = [(row.share, asked.promised(row)) for row in asked.apart(run, finer, other, finer)]
    lost = np.array([most is not None and share > most for share, most in rows])
    off = parted(finer.standard, other.standard)
    beyond = off > limit
    if not moved.succeeded or not beyond.any():
        return None, np.zeros(len(rows), bool)
    first = int(np.argmax(beyond))
    elapsed = float(run.time[first] - run.time[0])
    began = max(float(off[0]), TENTH_DIGIT)
    growth = elapsed / max(math.log(float(off[first]) / began), 1.0)
    return np.array([float(run.time[first]), growth]), lost
