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
import jax.numpy as jnp
import numpy as np

from jaxclear.errors.observables import Observables, apart, observed, parted
from jaxclear.errors.replicas import Replica, replica, thinned
from jaxclear.errors.told import HALF, QUARTER, Failed, Verified, richardson
from jaxclear.ground.quantity import is_traced
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.promise import Promise
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
) -> Trajectory:
    """The run with what its replicas tell; `again(replica, moved)`: the same run as that
    `Replica` is made, its start moved by so much. `verify`: whether replicas are run (None: where
    they take seconds at the most). What goes wrong in them, Ctrl-C too, leaves the run as it is."""
    why = _why_not(run, verify)
    known: AbstractVerification = Unverified(why)
    if not why:
        try:
            with stoppable():
                known = _verification(run, integrator, again)
        except KeyboardInterrupt:
            known = Unverified("interrupted")
        except (MemoryError, jax.errors.JaxRuntimeError) as error:
            reason = str(error).partition("\n")[0] or "out of memory"
            known = Unverified(f"a replica could not be run: {reason}")
    return dataclasses.replace(run, verification=known)


def _verification(
    run: Trajectory, integrator: AbstractIntegrator, again: Callable[..., Trajectory]
) -> AbstractVerification:
    promise, own, counting = integrator.promise, observed(run), integrator
    if own.rooms is not None:
        counting = integrator.counting_in(jnp.min(own.rooms), own.arm)
    found = [replica(counting, run.time, share) for share in (HALF, QUARTER)]
    plans = [plan for plan in found if plan is not None]
    if len(plans) < len(found):
        return Unverified("its steps cannot be refined")

    def repeated(plan: Replica, moved: float = 0.0) -> Trajectory:
        return thinned(again(plan, moved), plan.every)

    replicas: list[Trajectory] = []
    seen: list[Observables] = []
    for plan in plans:
        replicas.append(repeated(plan))
        if not replicas[-1].succeeded:
            return Failed(replicas[-1].result)
        seen.append(observed(replicas[-1]))
        rows = list(zip(*(apart(run, own, other, seen[-1]) for other in seen), strict=True))
        shares = [(float(richardson([each.share for each in row])), row[0].part) for row in rows]
        limits = [(share, getattr(promise, part)) for share, part in shares]
        if not any(limit is not None and not share <= DOUBT * limit for share, limit in limits):
            break
    errors = [float(richardson([each.off for each in row])) for row in rows]
    values = zip(rows, errors, shares, strict=True)
    numbers = np.array([[row[0].value, error, share] for row, error, (share, _) in values])
    path, lost = None, np.zeros(len(rows), bool)
    if any(p == "gaps" and promise.gaps is not None and not x <= promise.gaps for x, p in shares):
        path, lost = _lost(run, seen[0], repeated(plans[0], TENTH_DIGIT), promise)
    known = tuple(
        dataclasses.replace(each, verification=Unverified(OF_A_REPLICA)) for each in replicas
    )
    answers = tuple((row[0].answer, row[0].part, row[0].place, row[0].unit) for row in rows)
    since = np.asarray(run.time[0])
    return Verified(known, numbers, lost, path, since, promise, answers, integrator.remedy)


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
    run: Trajectory, finer: Observables, moved: Trajectory, promise: Promise
) -> tuple[np.ndarray | None, np.ndarray]:
    """(from when on [s] a path hangs on the tenth digit of its start, and within which time errors
    grow e-fold [s]; None where it does not; which answers are lost by that), from how far a `finer`
    run and the same with its start `moved` are apart."""
    other = observed(moved)
    rows = [(row, getattr(promise, row.part)) for row in apart(run, finer, other, finer)]
    lost = np.array([limit is not None and row.share > limit for row, limit in rows])
    off = parted(finer, other)
    beyond = off > promise.gaps
    if not moved.succeeded or not beyond.any():
        return None, np.zeros(len(rows), bool)
    first = int(np.argmax(beyond))
    elapsed = float(run.time[first] - run.time[0])
    began = max(float(off[0]), TENTH_DIGIT)
    growth = elapsed / max(math.log(float(off[first]) / began), 1.0)
    return np.array([float(run.time[first]), growth]), lost
