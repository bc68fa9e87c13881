"""What a record is compared with: the signals that a problem gives for values of its unknowns, all
in one row, and the numbers it answers besides.
"""

import itertools
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.wording import listed
from jaxclear.studies.problem import Problem
from jaxclear.studies.store.batch import evaluate_all


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


class ModelOutput(NamedTuple):
    """What one set of values gives: signals (n,) and responses, by name."""

    signals: Mapping[str, Array]
    responses: Mapping[str, Array]


class Forward(eqx.Module):
    """A problem as a function from its unknowns to the signals of a record: `shown(problem,
    values)`; `names` of the signals, in the order of the record. Pure."""

    problem: Problem
    simulate: Callable[[Any, Array], ModelOutput]
    names: tuple[str, ...] = eqx.field(static=True)

    def row(self, values: Float[Array, " variables"]) -> Float[Array, " n"]:
        """The signals in one row."""
        return self.in_row(self.simulate(self.problem, values))

    def in_row(self, output: ModelOutput) -> Float[Array, " n"]:
        """The signals of what was shown in one row."""
        return jnp.concatenate([output.signals[name] for name in self.names])


class _Rows(eqx.Module):
    """What a chunk of samples gives, as a function of a problem."""

    forward: Forward

    def __call__(self, problem: Problem, values: Array) -> tuple[Array, dict[str, Array]]:
        """Signals (samples, n) and responses (samples,) by name."""

        def one(row: Array) -> tuple[Array, dict[str, Array]]:
            output = self.forward.simulate(problem, row)
            return self.forward.in_row(output), dict(output.responses)

        return jax.vmap(one)(values)


def answered(forward: Forward, values: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """What a problem gives for many sets of values (samples, variables), in chunks that fit memory,
    on all cores: the signals (samples, n), and the responses (samples,) by name."""
    results: Any = evaluate_all(forward.problem, values, function=_Rows(forward))
    rows, responses = results
    return np.asarray(rows), {name: np.asarray(values) for name, values in responses.items()}


def check_signals(forward: Forward, record: Record) -> None:
    """Raises `ValueError` with a sentence where a signal is not as long as its measurement."""
    nominal = forward.problem.nominal()
    shapes = eqx.filter_eval_shape(forward.simulate, forward.problem, nominal).signals
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
