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

from jaxclear.errors.observables import Observables, apart, observed, parted
from jaxclear.errors.replicas import Replica, replica, thinned
from jaxclear.errors.told import HALF, QUARTER, Failed, Lost, Told, Verified, told
from jaxclear.ground.quantity import is_traced
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.native import stoppable
from jaxclear.results.trajectory import Trajectory
from jaxclear.results.verification import AbstractVerification, Unverified

# Share of the promise from which on a second replica is asked.
DOUBT = 0.5
# Steps of a run up to which its replicas are run unasked: seconds in any mechanism.
MOST_STEPS = 100_000
# By how much of a radian or of a metre the start of a replica is moved.
TENTH_DIGIT = 1e-10


def verified(
    run: Trajectory,
    integrator: AbstractIntegrator,
    again: Callable[[Replica], Trajectory],
    verify: bool | None,
) -> Trajectory:
    """The run with what its replicas tell; `again`: runs one. `verify`: whether they are run (None:
    where they take seconds at the most). What goes wrong in them, Ctrl-C too, leaves the run as it
    is."""
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


def _verification(
    run: Trajectory, integrator: AbstractIntegrator, again: Callable[[Replica], Trajectory]
) -> AbstractVerification:
    own = integrator.counting_in(run.history.model().system)
    plans = [replica(own, run.time, share, bool(run.worn)) for share in (HALF, QUARTER)]
    if None in plans:
        return Unverified("its steps cannot be refined")
    repeated = lambda plan: thinned(again(plan), plan.every)
    promise, here = integrator.promise, observed(run)
    replicas: list[Trajectory] = []
    seen: list[Observables] = []
    rows: list[Told] = []
    for plan in plans:
        replicas.append(repeated(plan))
        if not replicas[-1].succeeded:
            return Failed(replicas[-1].result)
        seen.append(observed(replicas[-1]))
        rows = told([apart(run, here, other) for other in seen], promise)
        if not any(t.promised is not None and not t.share <= DOUBT * t.promised for t in rows):
            break
    lost = None
    if any(each.beyond and each.part == "gaps" for each in rows):
        lost = _lost(run, seen[0], repeated(plans[0]._replace(moved=TENTH_DIGIT)), promise.gaps)
    return Verified(tuple(replicas), rows, lost, float(run.time[0]), promise, integrator.remedy)


def _lost(
    run: Trajectory, finer: Observables, moved: Trajectory, limit: float | None
) -> Lost | None:
    """Where a path hangs on the tenth digit of its start, from how far a finer run and the same
    with its start moved are apart in gaps; None where they agree."""
    if not moved.succeeded or limit is None:
        return None
    off = parted(finer, observed(moved))
    beyond = off > limit
    if not beyond.any():
        return None
    first = int(np.argmax(beyond))
    elapsed = float(run.time[first] - run.time[0])
    began = max(float(off[0]), TENTH_DIGIT)
    return Lost(float(run.time[first]), elapsed / max(math.log(float(off[first]) / began), 1.0))
