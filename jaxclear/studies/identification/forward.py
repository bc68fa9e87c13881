"""What a record is compared with: the signals that a problem gives for values of its unknowns, all
in one row.
"""

import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.wording import listed
from jaxclear.studies.problem import Problem


class Record(NamedTuple):
    """Measured signals (n,) by name, and the noise of each: its standard deviation in its own unit,
    None where it is not known and what the model leaves stands for it."""

    signals: Mapping[str, np.ndarray]
    noise: Mapping[str, float | None]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the signals."""
        return tuple(self.signals)

    @property
    def row(self) -> np.ndarray:
        """All signals in one row (n,)."""
        return np.concatenate([np.asarray(signal, float) for signal in self.signals.values()])

    @property
    def parts(self) -> tuple[slice, ...]:
        """Where each signal stands in the row."""
        ends = np.cumsum([0, *(len(signal) for signal in self.signals.values())])
        return tuple(slice(a, b) for a, b in itertools.pairwise(ends))


class Forward(eqx.Module):
    """A model as a function from its unknowns to the signals of a record, `simulate(problem,
    values)` by name; `names` of the signals, in the order of the record. Pure. `asked` is the
    problem whose responses follow, `problem` the one that is run to see the signals."""

    problem: Problem
    simulate: Callable[[Any, Array], Mapping[str, Array]]
    names: tuple[str, ...] = eqx.field(static=True)
    asked: Problem

    def row(self, values: Float[Array, " variables"]) -> Float[Array, " n"]:
        """The signals in one row."""
        signals = self.simulate(self.problem, values)
        return jnp.concatenate([signals[name] for name in self.names])


def check_signals(forward: Forward, record: Record) -> None:
    """Raises `ValueError` with a sentence where a signal is not as long as its measurement."""
    nominal = forward.problem.nominal()
    shapes = eqx.filter_eval_shape(forward.simulate, forward.problem, nominal)
    for name, measured in record.signals.items():
        if name not in shapes:
            names = listed(shapes) or "none"
            raise ValueError(
                f'signal "{name}" is measured, and the problem gives {names}; name the series that '
                "it is compared with so."
            )
        if shapes[name].shape != np.shape(measured):
            raise ValueError(
                f'signal "{name}" has {len(measured)} measured samples, and the problem gives '
                f"{shapes[name].shape[0]}; it must give one for each."
            )
