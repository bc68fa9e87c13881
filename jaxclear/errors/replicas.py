"""Replicas of a run: the same question with everything that discretises it refined. Steps are so
many times shorter than those that were taken (tolerances tighter by the fourth power, where steps
follow an error), surfaces wear so many times as often, and where the steps between saving times are
counted there are so many times as many of these.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.ground.quantity import concrete
from jaxclear.integrators.base import SLIVER, AbstractIntegrator
from jaxclear.integrators.events import Events
from jaxclear.results.trajectory import Trajectory

# Share of a run's time in which steps may be as long as the run's own.
NEXT_TO_NOTHING = 0.01


class Replica(NamedTuple):
    """How a run is made: by an `integrator`, saved at these `times` [s], of which every so many-th
    is asked for; in every saving interval surfaces wear by so many `updates`."""

    integrator: AbstractIntegrator
    times: Any
    every: int = 1
    updates: int = 1

    @property
    def work(self) -> float:
        """About so many times the run's own."""
        return float(max(self.every, self.updates))


def replica(integrator: AbstractIntegrator, times: Any, share: float) -> Replica | None:
    """How a run that is saved at these times [s] is repeated with steps of this share, one of a
    whole number; None where the integrator knows no finer steps."""
    finer = round(1 / share)
    if integrator.steps_between_saves is not None:
        return Replica(integrator, between(times, finer), finer)
    if integrator.asked_step() is not None:
        asked = concrete(integrator.asked_step())
        if asked is None:
            return None
        share = share * step_taken(times, asked) / asked
    own = integrator.with_finer_steps(share)
    return None if own is None else Replica(own, np.asarray(times), updates=finer)


def step_taken(times: Any, asked: float) -> float:
    """The shortest step [s] that is taken between saving times [s] where one of `asked` [s] is
    asked for (steps end at all of them), but for intervals that together are next to nothing: of
    two saving times side by side no step is to be that short everywhere."""
    intervals = np.diff(np.asarray(times))
    taken = intervals / np.maximum(np.ceil(intervals / asked * (1 - SLIVER)), 1)
    order = np.argsort(taken)
    passed = np.cumsum(intervals[order])
    return float(taken[order][np.searchsorted(passed, NEXT_TO_NOTHING * passed[-1])])


def between(times: Any, every: int) -> np.ndarray:
    """The times with so many intervals in the place of each, the given ones bit for bit."""
    times = np.asarray(times)
    shares = np.arange(every) / every
    inside = times[:-1, None] + shares * np.diff(times)[:, None]
    return np.append(inside.ravel(), times[-1])


def thinned(run: Trajectory, every: int) -> Trajectory:
    """A run as saved at every so many-th of its saving times: what a response sees of a replica."""
    if every == 1:
        return run
    history = run.history
    kept = dataclasses.replace(
        history,
        time=history.time[::every],
        states=history.states[::every],
        read=jax.tree.map(lambda depths: depths[::every], history.read),
    )
    noted = None if run.noted is None else _joined(run.noted, every)
    return dataclasses.replace(run, history=kept, noted=noted)


def _joined(noted: Events, every: int) -> Events:
    """The events of so many saving intervals at a time, of each contact the first ones."""
    counts = np.asarray(noted.counts)
    most = noted.times.shape[-1]
    missing = np.arange(most) >= counts[..., None]
    together = lambda each: np.concatenate([each[k::every] for k in range(every)], axis=-1)
    first = np.argsort(together(missing), axis=-1, stable=True)[..., :most]
    kept = lambda each: jnp.asarray(np.take_along_axis(together(np.asarray(each)), first, axis=-1))
    of_all = counts.reshape(-1, every, counts.shape[-1]).sum(axis=1)
    return Events(kept(noted.times), kept(noted.rates), jnp.asarray(of_all))
