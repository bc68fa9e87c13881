"""Replicas of a run: the same question with everything that discretises it refined. Steps are so
many times shorter than those that were taken (tolerances tighter by the fourth power, where steps
follow an error), surfaces wear so many times as often, and where the steps between saving times are
counted there are so many times as many of these.
"""

import dataclasses
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxclear.ground.quantity import concrete
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.stepping import SLIVER
from jaxclear.results.trajectory import Trajectory


class Replica(NamedTuple):
    """How a run is made: by an `integrator`, saved at these `times` [s], of which every so many-th
    is asked for; in every saving interval surfaces wear by so many `updates`."""

    integrator: AbstractIntegrator
    times: Any
    every: int = 1
    updates: int = 1


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
    asked for: steps end at all of them."""
    intervals = np.diff(np.asarray(times))
    return float(np.min(intervals / np.maximum(np.ceil(intervals / asked * (1 - SLIVER)), 1)))


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
    return dataclasses.replace(run, history=kept, noted=None)
