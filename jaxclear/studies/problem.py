"""A question about a mechanism: which numbers vary and how, how it is run, and which responses are
wanted.

Studies see a `Problem`, never a joint. The whole path from varied numbers to responses is one pure
function, `evaluate`, that maps over samples and differentiates.
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.arguments import check_number, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import AbstractQuantified, inside, numbers
from jaxclear.ground.wording import described, meant
from jaxclear.integrators import AbstractIntegrator, Checks, Outcome
from jaxclear.multibody.assembly import (
    Start,
    assemble_arrays,
    carried_on,
    determined,
    is_sound,
)
from jaxclear.multibody.mechanism import Mechanism, loosened, with_redundancy
from jaxclear.multibody.topology import Redundancy
from jaxclear.results.response import unit_of
from jaxclear.results.saved_state import State
from jaxclear.results.trajectory import Trajectory
from jaxclear.simulation.beginning import Past, past_of
from jaxclear.simulation.dead_point import diagnosed_outcome
from jaxclear.simulation.derivatives import guarded
from jaxclear.simulation.simulate import check_duration, check_run, run, saving_times
from jaxclear.simulation.step_lengths import check_steps
from jaxclear.studies.distribution import AbstractDistribution, TruncatedNormal
from jaxclear.studies.usual_integrator import usual_integrator


class Variable(AbstractQuantified):
    """A number of the mechanism that varies: `where(mechanism)` returns its leaf, or several leaves
    that vary together.

    `distribution` is centred on the leaf's own value; `tolerance=t` stands for a normal
    distribution with three standard deviations in t, cut off at +-t.
    """

    where: Callable[[Mechanism], Any] = eqx.field(static=True)
    distribution: AbstractDistribution

    def __init__(
        self,
        where: Callable,
        distribution: AbstractDistribution | None = None,
        *,
        tolerance: float | None = None,
    ):
        self.where = where
        if distribution is not None and tolerance is None:
            self.distribution = distribution
        elif tolerance is not None and distribution is None:
            check_number("tolerance of a Variable", tolerance, above=0)
            self.distribution = TruncatedNormal(tolerance / 3, bound=tolerance)
        else:
            raise ValueError(
                "a Variable takes a distribution or a tolerance; give one of the two, not "
                "both or neither."
            )


class SampleResult(eqx.Module):
    """Responses of one sample by name, how its run ended (`integrator.Outcome`), when [s], and its
    own `checks`, whose figures beyond their limits are warnings."""

    responses: dict[str, Array]
    outcome: Array
    ended: Array
    checks: Checks = eqx.field(default_factory=Checks)


class Problem(AbstractQuantified):
    """A mechanism, the numbers in it that vary, how it is run, and the responses wanted of a run.

    `response`: a function of a trajectory returning a number, or several by name. `duration` [s].
    `integrator`: by default steps of a fixed length, because equal work for every sample is what
    batches and derivatives want: `FixedStep()`, or an `ImplicitStep` where friction would answer
    faster than such steps resolve; `why_integrator` says so. `save`: saving times, as in
    `simulate`; `shares` [1] are they, as shares of the duration. `state`: where its runs begin, as
    in `simulate`. Raises `ValueError` with a
    sentence for what cannot be asked.
    """

    mechanism: Mechanism
    response: dict[str, Callable]
    variables: dict[str, Variable]
    duration: Array
    shares: Float[Array, " saves"]
    integrator: AbstractIntegrator
    state: State
    past: Past
    # JAX sorts the keys of a dictionary; the order in which things were given is kept here.
    names: tuple[str, ...] = eqx.field(static=True)
    response_names: tuple[str, ...] = eqx.field(static=True)
    variable_units: tuple[str, ...] = eqx.field(static=True)
    # Coordinates given for the start that the loops determine: they move with what varies.
    determined: tuple[str, ...] = eqx.field(static=True)
    why_integrator: str = eqx.field(static=True)
    # Redundant rows of loops, which all samples share.
    redundancy: Redundancy | None = eqx.field(static=True)

    def __init__(
        self,
        mechanism: Mechanism,
        response: Callable | Mapping[str, Callable],
        variables: Mapping[str, Variable],
        *,
        duration: float,
        integrator: AbstractIntegrator | None = None,
        save: Any = 201,
        state: State | None = None,
    ):
        check_double_precision()
        self.mechanism = mechanism
        expect(mechanism, Mechanism, "the mechanism of a Problem", "a jaxclear.Mechanism")
        self.response = _by_name("response", response)
        self.variables = _by_name("variables", variables)
        times = saving_times(check_duration(duration), save)
        usual = usual_integrator(mechanism, times[-1]) if integrator is None else (integrator, "")
        self.integrator, self.why_integrator = usual
        self.duration, self.shares = times[-1], times / times[-1]
        self.names, self.response_names = tuple(self.variables), tuple(self.response)
        check_run(mechanism, self.integrator)
        check_steps(integrator, times)
        seen = self.integrator.formulation.seen(mechanism)
        self.state = State() if state is None else state
        self.past = past_of(seen, self.integrator.formulation, self.state)
        self.determined, motion = (), self.state.motion
        if motion is None:
            self.determined, seen = determined(seen, self.state.concentric)
        self.redundancy = seen.topology.redundancy if motion is None else motion.redundancy
        for name, wanted in self.response.items():
            if not callable(wanted) or isinstance(wanted, type):
                hint = f": build one, {wanted.__name__}(...)" if isinstance(wanted, type) else ""
                raise ValueError(
                    f'response "{name}" is {described(wanted)}; it must be a function of a '
                    f"trajectory, such as one of jaxclear.response{hint}."
                )
            if name in self.variables:
                raise ValueError(
                    f'"{name}" names a variable and a response; give them different names.'
                )
        known = [(leaf, metadata.get("unit", "1")) for _, leaf, metadata in numbers(mechanism)]
        for name, variable in self.variables.items():
            _check_variable(name, variable, mechanism)
        _check_apart({name: self._leaves(v) for name, v in self.variables.items()})
        firsts = [self._leaves(variable)[0] for variable in self.variables.values()]
        self.variable_units = tuple(
            next((u for leaf, u in known if leaf is first), "1") for first in firsts
        )

    def _leaves(self, variable):
        return _leaves_of(variable)(self.mechanism)

    def nominal(self) -> Float[Array, " variables"]:
        """Nominal value of each variable."""
        found = [self._leaves(self.variables[name])[0] for name in self.names]
        return jnp.stack(found) if found else jnp.zeros(0)

    def units(self) -> dict[str, str]:
        """Unit of each response."""
        return {name: unit_of(self.response[name]) for name in self.response_names}

    def with_values(self, values: Float[Array, " variables"]) -> Mechanism:
        """The mechanism with its variables set. Leaves that vary together move by the same
        amount. Coordinates of the start that the loops determine become guesses."""
        mechanism = self.mechanism
        for name, value in zip(self.names, values, strict=True):
            variable = self.variables[name]
            old = self._leaves(variable)
            new = [leaf + (value - old[0]) for leaf in old]
            mechanism = eqx.tree_at(_leaves_of(variable), mechanism, new)
        return loosened(mechanism, self.determined)

    def seen(self, values: Float[Array, " variables"]) -> Mechanism:
        """The mechanism of one set of values as it is simulated."""
        seen = self.integrator.formulation.seen(self.with_values(values))
        return with_redundancy(seen, self.redundancy)

    def started(self, values: Float[Array, " variables"]) -> tuple[Mechanism, Start, Trajectory]:
        """The mechanism of one set of values as it is simulated, its start, and its run; pure."""
        mechanism = self.seen(values)
        times, motion = self.shares * self.duration, self.state.motion
        if motion is None:
            start = assemble_arrays(mechanism, self.state.concentric)
        else:
            start = carried_on(mechanism, *motion.moving)
            times = motion.time + times
        found = run(mechanism, *start[:2], times, self.integrator, past=self.past)
        return mechanism, start, found

    def evaluate(
        self, values: Float[Array, " variables"], *, discrete_derivatives: bool = False
    ) -> SampleResult:
        """Assemble, run and take the responses for one set of values; pure.

        JAX may map, compile and differentiate it. A derivative through contacts that open and close
        is not that of the motion, and raises `ValueError`; with `discrete_derivatives` it is passed
        on, as the derivative of the discrete run.
        """
        check_double_precision()
        mechanism, start, trajectory = self.started(values)
        trajectory = guarded(trajectory, self.integrator, discrete_derivatives)
        responses = {
            name: _one_number(name, response(trajectory))
            for name, response in self.response.items()
        }
        possible = jnp.all(
            jnp.stack([inside(leaf, metadata) for _, leaf, metadata in numbers(mechanism)])
        )
        sound = is_sound(mechanism, start)
        outcome = jnp.where(sound, diagnosed_outcome(trajectory), Outcome.UNASSEMBLED)
        outcome = jnp.where(possible, outcome, Outcome.OUT_OF_RANGE)
        return SampleResult(responses, outcome, trajectory.ended, trajectory.checks)


def _by_name(what: str, given: Any) -> dict[str, Any]:
    """What varies or is wanted, by name; a response alone is called "response"."""
    if what == "response" and not isinstance(given, Mapping):
        return {what: given}
    expect(given, Mapping, f"{what} of a Problem", "a dictionary from names")
    if what == "response" and not given:
        raise ValueError("response of a Problem is empty; it must hold at least one.")
    for name in given:
        expect(name, str, f"a name in {what} of a Problem", "a text")
    return dict(given)


def _one_number(name: str, value: Any) -> Array:
    """What a response answers, which studies take for one number."""
    number = isinstance(value, (int, float, np.number, np.ndarray, jax.Array))
    if not number or jnp.shape(value) != ():
        hint = " It returns nothing: is a `return` missing?" if value is None else ""
        raise ValueError(
            f'response "{name}" gives {described(value)} for a run; it must be one number, such as '
            f"a mean or the largest.{hint}"
        )
    return jnp.asarray(value, float)


def _meant(error: Exception, mechanism: Mechanism) -> str:
    """A question for the name that was probably meant where a `where` found none."""
    if isinstance(error, AttributeError) and error.name:
        return meant(error.name, [n for n in dir(error.obj) if not n.startswith("_")])
    key = error.args[0] if isinstance(error, KeyError) and error.args else ""
    return meant(key, [*mechanism.connections, *mechanism.bodies, *mechanism.loads])


def _leaves_of(variable: Variable) -> Callable[[Mechanism], list]:
    return lambda mechanism: jax.tree.leaves(variable.where(mechanism))


def _check_apart(leaves: dict[str, list]) -> None:
    """Each number of the mechanism may vary by one variable only."""
    taken: dict[int, str] = {}
    for name, own in leaves.items():
        for leaf in own:
            other = taken.setdefault(id(leaf), name)
            if other != name:
                raise ValueError(
                    f'variables "{other}" and "{name}" point at the same number of the mechanism; '
                    "only one of them can set it."
                )


def _check_variable(name: str, variable: Any, mechanism: Mechanism) -> None:
    expect(variable, Variable, f'variable "{name}"', "a jaxclear.Variable")
    try:
        target = variable.where(mechanism)
    except (KeyError, AttributeError, TypeError, IndexError) as error:
        raise ValueError(
            f'variable "{name}" points at nothing in this mechanism: its `where` fails with '
            f"{type(error).__name__}: {error}.{_meant(error, mechanism)}"
        ) from error
    leaves = target if isinstance(target, (tuple, list)) else [target]
    if not leaves or not all(eqx.is_array(leaf) and jnp.ndim(leaf) == 0 for leaf in leaves):
        raise ValueError(
            f'variable "{name}" must point at numbers of the mechanism; where(mechanism) gives '
            f"{described(target)}."
        )
