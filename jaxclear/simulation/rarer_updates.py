"""The same run with worn surfaces updated half as often, to tell what their updates at saving times
put elsewhere.

Every second saving time is moved to just before the next one. There are as many as before, which
compiles nothing anew; where the others are, both runs are compared.
"""

import dataclasses

import jax
import numpy as np
from jaxtyping import Array

from jaxclear.results.trajectory import Trajectory

# What is left of the interval that a moved time ends with, as a share: short beside the others, and
# not so short that steps and mean forces in it are rounding.
LEFT = 0.1
# What the motion is off by is in proportion to the mean time by which updates are late: beside that
# of the run, these are later by (1.9^2 + 0.1^2)/2 - 1 = 0.81 of it.


def moved(times: Array) -> np.ndarray:
    """The times [s] with every second one moved to just before the next."""
    rarer = np.array(times)
    second, after = rarer[1:-1:2], rarer[2::2]
    rarer[1:-1:2] = after - LEFT * (after - second)
    return rarer


def where_kept(run: Trajectory) -> Trajectory:
    """A run with what it saved at times that are moved replaced by what it saved at the next."""
    rows = np.arange(len(run.time))
    second = rows[1:-1:2]
    rows[second] = second + 1
    history = run.history
    kept = dataclasses.replace(
        history,
        time=history.time[rows],
        states=history.states[rows],
        read=jax.tree.map(lambda depths: depths[rows], history.read),
    )
    return dataclasses.replace(run, history=kept)
