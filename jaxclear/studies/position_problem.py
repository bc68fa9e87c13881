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

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_flags
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import with_quantities
from jaxclear.ground.wording import listed
from jaxclear.integrators import Outcome
from jaxclear.multibody.mechanism import Mechanism
from jaxclear.results.response import unit_of
from jaxclear.statics.least_energy import ByEnergy, Rest
from jaxclear.statics.position_path import both, checked_positions, sought
from jaxclear.statics.positions import Positions
from jaxclear.statics.quasi_static import ByLoops, Posed, Spot
from jaxclear.studies.experiment import (
    AbstractExperiment,
    Cost,
    Description,
    ResponseInfo,
    SampleResult,
    Setting,
    derived,
    sample_of_chunk,
)
from jaxclear.studies.inputs import correlation_matrix
from jaxclear.studies.problem import Problem
from jaxclear.studies.responses import answers, check_answers, checked_question, in_range
from jaxclear.studies.variable import AbstractMechanismVariable

# Samples a chunk: beyond it the rows of the kernel leave the cache
# (benchmarks/claims/positions.py).
LARGEST_CHUNK = 256
# Numbers of a sample at a position: those of the mechanism and of its standing, roughly.
NUMBERS = 400


class PositionExperiment(AbstractExperiment):
    """A mechanism over positions of its drives, and the responses wanted (`PositionProblem`)."""

    mechanism: Mechanism
    response: dict[str, Callable]
    position: Float[Array, "positions drives"]
    drives: tuple[str, ...] = eqx.field(static=True)
    reverse_loads: bool = eqx.field(static=True)
    scene: Posed = derived()
    starts: Spot | Rest = derived()
    # The same under reversed loads, where energy says where it rests.
    others: Rest | None = derived()
    method: ByLoops | ByEnergy = derived()
    response_names: tuple[str, ...] = derived(static=True)

    def __init__(
        self,
        mechanism: Mechanism,
        response: dict[str, Callable],
        positions: Mapping[str, Any],
        reverse_loads: bool,
    ):
        self.mechanism, self.response, self.reverse_loads = mechanism, response, reverse_loads
        self.response_names = tuple(response)
        self.drives, places = checked_positions(positions)
        self.position = jnp.asarray(places)
        self.scene, self.method, self.starts = sought(mechanism, self.drives, places)
        self.others = None
        if reverse_loads and isinstance(self.method, ByEnergy):
            starts: Any = self.starts
            others = self.method.reversed.each(self.scene, self.position, starts)
            self.others = others if bool(jnp.all(jnp.isfinite(others.change))) else None
        check_answers(response, lambda: self._positions_of(mechanism))

    @property
    def subject(self):
        return self.mechanism

    def _positions_of(self, mechanism: Mechanism) -> Positions:
        scene = self.scene.of(mechanism)
        return both(scene, self.position, self.starts, self.method, self.reverse_loads, self.others)

    def _positions_of_setting(self, setting: Setting) -> Positions:
        """The mechanism of one setting at all positions; pure."""
        return self._positions_of(setting(self.mechanism))

    def evaluate(self, setting, *, discrete_derivatives=False):
        positions = self._positions_of_setting(setting)
        ok = jnp.all(positions.is_solved)
        if positions.other is not None:
            ok &= jnp.all(positions.other.is_solved)
        outcome = jnp.where(ok, Outcome.REACHED, Outcome.UNASSEMBLED)
        possible = in_range(positions.scene.mechanism, positions.scene.gaps)
        outcome = jnp.where(possible, outcome, Outcome.OUT_OF_RANGE)
        return SampleResult(answers(self.response, positions), outcome, jnp.zeros(()))

    def cost(self):
        return Cost(8 * NUMBERS * len(self.position), LARGEST_CHUNK, cheap=True)

    def detail(self, setting, index, chunk) -> Positions:
        """The mechanism of one sample at all positions.

        Args:
            setting: values of the sample.
            index: of the sample in its study.
            chunk: samples of a chunk of the study.
        """
        return sample_of_chunk(self._positions_of_setting, setting, index, chunk)

    def describe(self):
        many = len(self.position)
        responses = {
            name: ResponseInfo(unit_of(f, self.mechanism)) for name, f in self.response.items()
        }
        endings = {
            Outcome.REACHED: "the mechanism stands at every position.",
            Outcome.UNASSEMBLED: (
                "the mechanism cannot be assembled at every position, or only on another way than "
                "the nominal one."
            ),
        }
        places = f"{many} position{'s' if many > 1 else ''} of {listed(self.drives)}"
        return Description(f"PositionProblem at {places}".rstrip(), responses, endings)


@answering
def PositionProblem(
    mechanism: Mechanism,
    response: Callable | Mapping[str, Callable],
    variables: Mapping[str, AbstractMechanismVariable],
    *,
    positions: Mapping[str, Any],
    reverse_loads: bool = False,
    correlation: Any = None,
) -> Problem:
    """A problem of a mechanism over positions of its drives. Each position of each sample is sought
    from where the nominal mechanism stands there; a sample of which one is not found has failed.
    Derivatives are exact, seats of the journals included.

    Args:
        mechanism: the mechanism that is positioned.
        response: a function of `jaxclear.positions`' result, or several by name; those of
            `jaxclear.response` that read places serve; `FromFunction` gives a function its unit.
        variables: the numbers that vary, `Variable` or `Condition` by name.
        positions: coordinates [rad, m] by joint, as in `jaxclear.positions`.
        reverse_loads: an option, whether loads are reversed as well, as in `jaxclear.positions`.
        correlation: of the variables' normal scores [1], as in `Problem`.

    Raises:
        ValueError: with a sentence for what cannot be asked.
    """
    check_double_precision()
    mechanism = with_quantities(mechanism)
    of = "a mechanism over positions"
    responses, varied = checked_question(mechanism, response, variables, "PositionProblem", of)
    correlation = correlation_matrix(correlation, tuple(varied))
    check_flags("PositionProblem", reverse_loads=reverse_loads)
    experiment = PositionExperiment(mechanism, responses, positions, reverse_loads)
    return Problem.of(experiment, varied, correlation)
