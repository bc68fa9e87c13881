"""Whether anything that fails is within reach, asked before tens of thousands of runs look for it.

One small subset simulation goes as far as the large ones do, to parts as rare as one in 1e12. What
it finds is no probability, but whether a limit is met on the way. A limit that lies beyond the
bounds of all variables is told after some two thousand runs, with the sample that comes nearest.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxclear.ground.shown import in_digits
from jaxclear.studies.limit_state import system_margin
from jaxclear.studies.reliability.models import RunModel
from jaxclear.studies.reliability.subset import repetitions

# Samples of a level: of 31 limits (probabilities from 1e-3 to 1e-7, planes in up to 60 variables,
# bent, rough and of several modes) none was missed in 100 searches each; by half as many one in six
# of the rough ones was.
PILOT = 200
# Of a search that did not come as far nobody knows: responses that are alike do not tell it where
# the limit lies.
FAR = 1e-8


@dataclass
class Reach:
    """What a search of a few runs says of whether anything fails: asked once, when it is wanted."""

    model: RunModel
    seed: int
    sentence: str | None = None

    def beyond(self) -> str:
        """A sentence where the limit lies beyond everything seen; "" where something fails, and
        where it is not known."""
        if self.sentence is None:
            self.sentence = self._searched()
        return self.sentence

    def _searched(self) -> str:
        nearest = _Nearest(self.model)
        rng, before = np.random.default_rng([self.seed, 7]), self.model.runs
        found = repetitions(self.model, 1, PILOT, rng, nearest.see)
        if found.shares[0] > 0.0 or found.reached[0] > FAR or nearest.normal is None:
            return ""
        runs, rare = self.model.runs - before, found.reached[0]
        return self._told(nearest.normal, f"{runs} runs down to parts as rare as {rare:.0e}")

    def _told(self, normal: np.ndarray, far: str) -> str:
        problem, limit = self.model.problem, self.model.limit
        values = np.asarray(problem.inputs.values(jnp.asarray(normal)))
        units, responses = problem.units(), problem.evaluate(jnp.asarray(values)).responses
        self.model.runs += 1
        nominal = np.asarray(problem.nominal())
        where = ", ".join(
            f"{name} = {in_digits(value, 0.1 * (value - middle))}{_unit(unit)}"
            for name, value, middle, unit in zip(
                problem.names, values, nominal, problem.variable_units, strict=True
            )
        )
        reached = ", ".join(
            f"{own} = {float(responses[own]):.5g}{_unit(units[own])}"
            for own in dict.fromkeys(part.response for part in limit.limits())
        )
        return (
            f"nothing fails in {far}: the limit ({limit.words()}) lies beyond everything seen. "
            f"Nearest to it is {reached}, at {where}."
        )


@dataclass
class _Nearest:
    """The sample that came nearest to the limit."""

    model: RunModel
    normal: np.ndarray | None = None
    margin: float = np.inf

    def see(self, normal: np.ndarray, margins: np.ndarray) -> None:
        """Of samples (samples, variables) with margins (samples, limits), known if not nan."""
        known = np.where(np.isnan(margins), np.inf, margins)
        told = system_margin(known, self.model.limit.cut_sets())
        least = int(np.argmin(told))
        if told[least] < self.margin:
            self.normal, self.margin = normal[least], float(told[least])


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"
