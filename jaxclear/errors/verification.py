"""A run and its replicas: the numerical errors of its standard answers, and of any other.

An error that falls in proportion to the step is twice what half of it changes, one that falls
faster is less (Richardson). A second replica is run only where the first does not decide. Where
paths in gaps have parted, its start is moved in the tenth digit: if the two agree, steps were too
long; if not, the path is no answer, and the second is one more sample of the means. Otherwise,
where an error is within what the integrator promises but beyond half of that, it has quarter
steps, as two runs may agree by chance: an error that is beyond the promise stays beyond it.

Sources: Richardson 1911, Phil. Trans. R. Soc. A 210, 307, doi:10.1098/rsta.1911.0009; Roache 1994,
J. Fluids Eng. 116, 405, doi:10.1115/1.2910291.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.errors.accuracy import Bounds, Observed
from jaxclear.errors.estimates import HALF, QUARTER, Failed, Verified, factors_of_cells, richardson
from jaxclear.errors.observables import distance_in_gaps
from jaxclear.ground.quantity import concrete, is_traced, with_fields
from jaxclear.integrators.base import SLIVER, AbstractIntegrator
from jaxclear.integrators.events import Events
from jaxclear.multibody.length_scales import narrowest
from jaxclear.native import stoppable
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.trajectory import Trajectory
from jaxclear.results.verification import AbstractVerification, Unverified

# Share of a run's time in which steps may be as long as the run's own.
NEXT_TO_NOTHING = 0.01


class Replica(NamedTuple):
    """How a run is made: by an `integrator`, saved at these `times` [s], of which every so many-th
    is asked for; surfaces wear by so many times as many `updates`, on cells as wide as so many
    (`coarseness`)."""

    integrator: AbstractIntegrator
    times: Any
    every: int = 1
    updates: int = 1
    coarseness: float = 1.0

    @property
    def work(self) -> float:
        """About so many times the run's own."""
        return float(max(self.every, self.updates))


def replica(integrator: AbstractIntegrator, times: Any, share: float) -> Replica | None:
    """How a run is repeated with finer steps; None where the integrator has none.

    Args:
        integrator: of the run.
        times: its saving times [s].
        share: ratio of the steps to those of the run, one over a whole number.
    """
    finer = round(1 / share)
    if integrator.steps_between_saves is not None:
        return Replica(integrator, refine_times(times, finer), finer)
    if integrator.requested_step() is not None:
        step = concrete(integrator.requested_step())
        if step is None:
            return None
        share = share * step_taken(times, step) / step
    refined = integrator.with_finer_steps(share)
    return None if refined is None else Replica(refined, np.asarray(times), updates=finer)


def step_taken(times: Any, step: float) -> float:
    """The shortest step [s] that is taken between saving times [s] where one of `asked` [s] is
    asked for (steps end at all of them), but for intervals that together are next to nothing: of
    two saving times side by side no step is to be that short everywhere."""
    intervals = np.diff(np.asarray(times))
    taken = intervals / np.maximum(np.ceil(intervals / step * (1 - SLIVER)), 1)
    order = np.argsort(taken)
    elapsed = np.cumsum(intervals[order])
    return float(taken[order][np.searchsorted(elapsed, NEXT_TO_NOTHING * elapsed[-1])])


def refine_times(times: Any, every: int) -> np.ndarray:
    """The times with so many intervals in the place of each, the given ones bit for bit."""
    times = np.asarray(times)
    shares = np.arange(every) / every
    inside = times[:-1, None] + shares * np.diff(times)[:, None]
    return np.append(inside.ravel(), times[-1])


def thin_run(run: Trajectory, every: int) -> Trajectory:
    """A run as saved at every so many-th of its saving times: what a response sees of a replica."""
    if every == 1:
        return run
    history = run.history
    sparse = dataclasses.replace(
        history,
        time=history.time[::every],
        states=history.states[::every],
        read=jax.tree.map(lambda depths: depths[::every], history.read),
    )
    noted = None if run.noted is None else _join_intervals(run.noted, every)
    return dataclasses.replace(run, history=sparse, noted=noted)


def _join_intervals(noted: Events, every: int) -> Events:
    """The events of so many saving intervals at a time, of each contact the first ones."""
    counts = np.asarray(noted.counts)
    most = noted.times.shape[-1]
    missing = np.arange(most) >= counts[..., None]
    together = lambda each: np.concatenate([each[k::every] for k in range(every)], axis=-1)
    first = np.argsort(together(missing), axis=-1, stable=True)[..., :most]
    at = lambda each: jnp.asarray(np.take_along_axis(together(np.asarray(each)), first, axis=-1))
    of_all = counts.reshape(-1, every, counts.shape[-1]).sum(axis=1)
    return Events(at(noted.times), at(noted.rates), jnp.asarray(of_all))


# Share of the promise from which on up to the promise a replica with quarter steps is run.
DOUBT = 0.5
# Steps of a run up to which its replicas are run unasked: seconds in any mechanism.
MOST_STEPS = 100_000
# By how much of a radian or of a metre the start of a replica is moved.
TENTH_DIGIT = 1e-10
OF_A_REPLICA = "a replica of another run"
LONG = f"beyond {MOST_STEPS} steps replicas are run with verify=True"


def verify_run(
    run: Trajectory,
    integrator: AbstractIntegrator,
    again: Callable[..., Trajectory],
    verify: bool | None,
    bounds: Bounds | None = None,
) -> Trajectory:
    """The run with what its replicas tell; an error or Ctrl-C in replicas leaves the run as it is.

    Args:
        run: trajectory that is verified.
        integrator: of the run.
        again: `again(replica, moved)`: the same run as the `Replica` says, from a shifted start.
        verify: whether replicas are run; None: where they take seconds at most.
        bounds: required accuracy; None: what the integrator promises.
    """
    why = _why_unverified(run, verify)
    # Worn depths hang on updates and cells, which nothing but replicas looks at.
    warns = why == LONG and bool(run.worn)
    verification: AbstractVerification = _unverified(_with_choice_reason(why, bounds), warns)
    if not why:
        bounds = Bounds(integrator.promise) if bounds is None else bounds
        try:
            with stoppable():
                verification = _verify_by_replicas(run, integrator, again, bounds)
        except KeyboardInterrupt:
            verification = Unverified("interrupted")
        except (MemoryError, jax.errors.JaxRuntimeError) as error:
            reason = str(error).partition("\n")[0] or "out of memory"
            verification = Unverified(f"a replica could not be run: {reason}")
    return with_fields(run, verification=verification)


# Built once for each reason.
_unverified = functools.lru_cache(maxsize=16)(Unverified)


def _with_choice_reason(why: str, bounds: Bounds | None) -> str:
    return f"{why}. {bounds.why.removesuffix('.')}" if bounds is not None and bounds.why else why


def _verify_by_replicas(
    run: Trajectory,
    integrator: AbstractIntegrator,
    again: Callable[..., Trajectory],
    bounds: Bounds,
) -> AbstractVerification:
    coarse, counting = bounds.observe(run), integrator
    plain = type(integrator).counting_in is AbstractIntegrator.counting_in
    if coarse.standard.rooms is not None and not plain:
        counting = _counting(integrator, coarse.standard.rooms, coarse.standard.arm)

    def repeated(plan: Replica, moved: float = 0.0) -> Trajectory:
        return thin_run(again(plan, moved), plan.every)

    half = replica(counting, run.time, HALF)
    if half is None:
        return Unverified("its steps cannot be refined")
    replicas, ratios = [repeated(half)], [HALF]
    finer: list[Observed] = []
    path, chaotic, moved = None, None, (run, coarse)
    while True:
        if not replicas[-1].succeeded:
            return Failed(replicas[-1].result)
        finer.append(bounds.observe(replicas[-1]) if path is None else moved[1])
        pairs = (bounds.differences(run, coarse, other, finer[-1]) for other in finer)
        rows = list(zip(*pairs, strict=True))
        promised = np.array([_number_or_nan(bounds.tolerance(row[-1])) for row in rows])
        safety = np.array([row[0].safety for row in rows])
        shares = safety * [float(richardson([d.share for d in row], ratios)) for row in rows]
        gaps = np.array([row[0].part == "gaps" for row in rows])
        second: tuple[Trajectory, float] | None = None
        if chaotic is None and np.any(gaps & ~np.isnan(promised) & ~(shares <= promised)):
            other, limit = repeated(half, TENTH_DIGIT), float(np.nanmin(promised[gaps]))
            moved = other, bounds.observe(other)
            path, chaotic = _find_chaotic(run, bounds, finer[0], moved, limit)
            second = None if path is None else (other, HALF)
        if len(replicas) == 1 and path is None:
            undecided = np.any((shares > DOUBT * promised) & (shares <= promised))
            plan = replica(counting, run.time, QUARTER) if undecided else None
            second = None if plan is None else (repeated(plan), QUARTER)
        if len(replicas) > 1 or second is None:
            break
        replicas, ratios = [*replicas, second[0]], [*ratios, second[1]]
    errors = list(safety * [float(richardson([d.off for d in row], ratios)) for row in rows])
    coarser = _run_on_coarser_cells(run, integrator, repeated)
    if coarser is not None:
        rows_of_cells = bounds.differences(run, coarse, bounds.observe(coarser), finer[-1])
        shares_of_cells = factors_of_cells(run)
        most = max(shares_of_cells.values(), default=1.0)
        wear = np.array(
            [
                shares_of_cells.get(row.place, most) if row.part == "losses" else 0.0
                for row in rows_of_cells
            ]
        )
        errors = list(errors + wear * [row.off for row in rows_of_cells])
        shares = shares + wear * [row.share for row in rows_of_cells]
    # Steps that miss a contact agree on its peak: it is no surer than a mean beyond its promise.
    means = {
        row[0].place: share
        for row, share, most in zip(rows, shares, promised, strict=True)
        if row[0].part == "mean_force" and share > most
    }
    for k, (row, *_) in enumerate(rows):
        if row.part == "peak_force" and shares[k] < means.get(row.place, 0.0):
            shares[k] = means[row.place]
            errors[k] = shares[k] * abs(row.value)
    numbers = np.stack([[row[0].value for row in rows], errors, shares, promised], axis=1)
    chaotic = np.zeros(len(rows), bool) if chaotic is None else chaotic
    of_replica = _unverified(OF_A_REPLICA, False)
    companions = tuple(with_fields(each, verification=of_replica) for each in replicas)
    coarser = coarser and with_fields(coarser, verification=of_replica)
    answers = tuple((row[0].answer, row[0].part, row[0].place, row[0].unit) for row in rows)
    ends = np.asarray(run.time)[0], bounds.promise, answers, integrator.remedy, bounds.why
    # What runs hold needs no look, which takes longer than all the rest.
    verified = Verified((), numbers, chaotic, path, *ends, step_ratios=tuple(ratios))
    return with_fields(verified, replicas=companions, coarser=coarser)


def _run_on_coarser_cells(
    run: Trajectory, integrator: AbstractIntegrator, repeated: Callable[[Replica], Trajectory]
) -> Trajectory | None:
    """The run on worn surfaces whose cells are twice as wide; None where none has cells that a loss
    is shared among, or the run fails so."""
    if not any(depths.size > 1 for surfaces in run.worn.values() for depths in surfaces.values()):
        return None
    coarser = repeated(Replica(integrator, np.asarray(run.time), coarseness=2.0))
    return coarser if coarser.succeeded else None


@compiled_quickly
def _counting(integrator: AbstractIntegrator, rooms: Any, arm: Any) -> AbstractIntegrator:
    return integrator.counting_in(narrowest(rooms, arm), arm)


def _number_or_nan(promised: float | None) -> float:
    return math.nan if promised is None else promised


def _why_unverified(run: Trajectory, verify: bool | None) -> str:
    """Why a run has no replicas; "" where it is to have some."""
    if verify is False:
        return "verify=False"
    if is_traced((run.outcome, run.states)):
        return "a run that is traced has no replicas"
    if not run.succeeded:
        return "the run ended early"
    if verify is None and int(run.accepted_steps) > MOST_STEPS:
        return LONG
    return ""


def _find_chaotic(
    run: Trajectory,
    bounds: Bounds,
    finer: Observed,
    moved: tuple[Trajectory, Observed],
    limit: float,
) -> tuple[np.ndarray | None, np.ndarray]:
    """(from when on [s] a path hangs on the tenth digit of its start, and within which time errors
    grow e-fold [s]; None where it does not; which answers are lost by that), from how far a `finer`
    run and the same with its start `moved` are apart, in gaps by more than the `limit`."""
    trajectory, other = moved
    differences = bounds.differences(run, finer, other, finer)
    rows = [(row.share, bounds.tolerance(row)) for row in differences]
    chaotic = np.array([most is not None and share > most for share, most in rows])
    off = distance_in_gaps(finer.standard, other.standard)
    beyond = off > limit
    if not trajectory.succeeded or not beyond.any():
        return None, np.zeros(len(rows), bool)
    first = int(np.argmax(beyond))
    elapsed = float(run.time[first] - run.time[0])
    began = max(float(off[0]), TENTH_DIGIT)
    growth = elapsed / max(math.log(float(off[first]) / began), 1.0)
    return np.array([float(run.time[first]), growth]), chaotic
