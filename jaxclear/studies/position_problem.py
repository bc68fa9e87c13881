"""A question about positions: a mechanism at rest at positions of its drives, without time.

Most tolerance questions are of this kind: where does a part stand, how far does play let it off,
how much motion is lost when the load turns round. A sample is an assembly at each position, so it
costs microseconds where a run costs milliseconds.
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.ground.arguments import check_flags
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import with_quantities
from jaxclear.ground.wording import listed
from jaxclear.integrators import Outcome
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.statics.least_energy import ByEnergy, Rest
from jaxclear.statics.position_path import both, checked_positions, sought
from jaxclear.statics.positions import Positions
from jaxclear.statics.quasi_static import Posed, Spot, Way
from jaxclear.studies.base import SampleResult, how_it_ended
from jaxclear.studies.mechanism_problem import (
    AbstractMechanismProblem,
    check_answers,
    in_range,
    responses_of,
    wanted_of,
)
from jaxclear.studies.store.batch import sample_of_chunk
from jaxclear.studies.variable import AbstractMechanismVariable

# Samples a chunk: beyond it the rows of the kernel leave the cache
# (benchmarks/claims/positions.py).
LARGEST_CHUNK = 256
# Numbers of a sample at a position: those of the mechanism and of its standing, roughly.
NUMBERS = 400


class PositionProblem(AbstractMechanismProblem):
    """A mechanism over positions of its drives, the numbers in it that vary, and the responses
    wanted.

    `response`: a function of `jaxclear.positions`' result, or several by name; those of
    `jaxclear.response` that read places serve, and `FromFunction` gives a function its unit.
    `positions`: coordinates [rad, m] by joint, as in `jaxclear.positions`, `both_ways` too;
    `correlation` as in `Problem`. Each position of each sample is sought from where the nominal
    mechanism stands there; a sample of which one is not found has failed. Derivatives are exact,
    seats of the journals included. Raises `ValueError` with a sentence for what cannot be asked.
    """

    mechanism: Mechanism
    response: dict[str, Callable]
    variables: dict[str, AbstractMechanismVariable]
    position: Float[Array, "positions drives"]
    scene: Posed
    starts: Spot | Rest
    way: Way | ByEnergy
    correlation: Float[Array, "variables variables"] | None
    held: tuple[str, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    response_names: tuple[str, ...] = eqx.field(static=True)
    variable_units: tuple[str, ...] = eqx.field(static=True)
    both_ways: bool = eqx.field(static=True)

    def __init__(
        self,
        mechanism: Mechanism,
        response: Callable | Mapping[str, Callable],
        variables: Mapping[str, AbstractMechanismVariable],
        *,
        positions: Mapping[str, Any],
        both_ways: bool = False,
        correlation: Any = None,
    ):
        check_double_precision()
        mechanism = with_quantities(mechanism)
        of = "a mechanism over positions"
        wanted = wanted_of(mechanism, response, variables, correlation, "PositionProblem", of)
        check_flags("PositionProblem", both_ways=both_ways)
        self.mechanism, self.both_ways = mechanism, both_ways
        self.response, self.variables, self.variable_units, self.correlation = wanted
        self.names, self.response_names = tuple(self.variables), tuple(self.response)
        self.held, places = checked_positions(positions)
        self.position = jnp.asarray(places)
        self.scene, self.way, self.starts = sought(mechanism, self.held, places)
        nominal = self.nominal()
        check_answers(self.response, lambda: self.positions(nominal))

    def positions(self, values: Float[Array, " variables"]) -> Positions:
        """The mechanism of one set of values at all positions; pure."""
        scene = self.scene.of(self._varied(values))
        return both(scene, self.position, self.starts, self.way, self.both_ways)

    def evaluate(self, values, *, discrete_derivatives=False):
        check_double_precision()
        self.check_values(values)
        found = self.positions(values)
        ok = jnp.all(found.found)
        if found.other is not None:
            ok &= jnp.all(found.other.found)
        outcome = jnp.where(ok, Outcome.REACHED, Outcome.UNASSEMBLED)
        possible = in_range(found.scene.mechanism, found.scene.gaps)
        outcome = jnp.where(possible, outcome, Outcome.OUT_OF_RANGE)
        return SampleResult(responses_of(self, found), outcome, jnp.zeros(()))

    def sample_memory(self):
        return 8 * NUMBERS * len(self.position)

    def most_together(self):
        return LARGEST_CHUNK

    def at_once(self):
        return True

    def rerun(self, values, index, chunk) -> Positions:
        """The mechanism of one sample at all positions."""
        return sample_of_chunk(self.positions, values, index, chunk)

    def ending(self, outcome, ended):
        if outcome == Outcome.REACHED:
            return "the mechanism stands at every position."
        if outcome == Outcome.UNASSEMBLED:
            return (
                "the mechanism cannot be assembled at every position, or only on another way than "
                "the nominal one."
            )
        return how_it_ended(outcome)

    def asked_how(self):
        many = len(self.position)
        return f"at {many} position{'s' if many > 1 else ''} of {listed(self.held)}"

    def parts(self):
        return self._told("mechanism", "response", "position", "held", "both_ways")
