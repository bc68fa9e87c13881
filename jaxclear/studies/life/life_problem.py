"""A question about lives: a machine whose numbers vary, and what is asked of the life of each copy
by one number: after how many cycles a limit is reached, infinite where it never is, or what a
quantity has come to at its end.

So a life is a response as any other: of statistics, derivatives, reliability, and of a design that
is to last. A life chooses its own steps, so it is no compiled program; its cycles are. It knows its
own error: with `sure` the answer is the end of its 95 % interval that is on the safe side; left out
are the rest beyond it, and what hangs on the saving times of a cycle (`WearLife.by_saves`).
"""

from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxclear.ground.argument_errors import answering
from jaxclear.ground.arguments import check_count, check_flags, check_name, check_number, expect
from jaxclear.ground.quantity import AbstractQuantified, Scalar, quantity
from jaxclear.integrators import Outcome
from jaxclear.integrators.checks import Checks
from jaxclear.multibody.system import wearing_in
from jaxclear.multibody.validation import check_values
from jaxclear.results.response import REACHES
from jaxclear.simulation.simulate import SimulationError
from jaxclear.studies.experiment import (
    PARTS,
    AbstractExperiment,
    Cost,
    Description,
    ResponseInfo,
    SampleResult,
    derived,
)
from jaxclear.studies.life.cycle import (
    check_cycle,
    check_cycles,
    cycle_request,
    first_state,
    kind_of_cycle,
)
from jaxclear.studies.life.rates import Rates
from jaxclear.studies.life.result import CONFIDENCE, DEPTH, VOLUME, WearLife
from jaxclear.studies.life.settling import Patience
from jaxclear.studies.life.wear_life import SETTLED, check_wear_problem, lived
from jaxclear.studies.problem import Problem
from jaxclear.studies.responses import answer, by_name, check_responses

# From which part of a cycle what every life tells of is drawn.
DRAWN_FROM = {DEPTH: "worn depth", VOLUME: "wear"}
# A life that is to reach a limit is lived so much longer than its last rate says it takes, and so
# often anew: rates fall as contacts widen. One that takes more than so many times what its first
# rate says is taken to end nowhere: wear that dies away would be followed for ever.
BEYOND, TRIES, LONGEST = 1.25, 8, 100.0


class LifeUntil(AbstractQuantified):
    """Cycles until a quantity first reaches a limit, as `WearLife.until`; infinite where it does
    not in as long a life as is followed (`LifeProblem`).

    Args:
        name: name of the quantity: "depth", "volume", those of one surface, or a response.
        limit: number that it reaches (in the quantity's unit).
        sure: whether the error of the life is subtracted: the lower end of its 95 % interval;
            False by default.
    """

    name: str = eqx.field(static=True)
    limit: Scalar = quantity(unit="(in the quantity's unit)")
    sure: bool = eqx.field(static=True, default=False, kw_only=True)

    def __check_init__(self):
        expect(self.name, str, "quantity of LifeUntil", 'a text, such as "depth"')
        check_flags("LifeUntil", sure=self.sure)

    def __call__(self, life: WearLife) -> float:
        """The cycles; `nan` where the life does not tell them."""
        length = life.until(self.name, float(self.limit))
        if not np.isfinite(length.cycles):
            # Of a life that ended by a failed cycle nobody knows.
            return np.nan if life.ended else self._value_if_outlived(life)
        if not self.sure:
            return length.cycles
        return max(length.cycles - length.error, 0.0)

    def _value_if_outlived(self, life: WearLife) -> float:
        """Of a life in which the limit is not reached: infinite, unless it is to be sure and the
        error at the end may hide that it is."""
        now = life.at_end(self.name)
        off, limit = _error_at_end(life, self.name, now), float(self.limit)
        if not self.sure or abs(limit - now) > off:
            return np.inf
        nearer = life.until(self.name, limit - np.copysign(off, limit - now)).cycles
        return nearer if np.isfinite(nearer) else 0.0

    def ahead(self, life: WearLife) -> float:
        """How many cycles more it takes, as the life goes on at its end.

        Args:
            life: the result as far as it has been simulated, a `WearLife`.

        Returns:
            0 where the life contains the number already, infinite where it never will.
        """
        if np.isfinite(life.until(self.name, float(self.limit)).cycles):
            return 0.0
        return life.cycles_ahead(self.name, float(self.limit))

    def depends_on(self, problem: Problem) -> frozenset[str]:
        """Parts of a cycle of the problem whose warnings concern it. A response of cycles hangs on
        how deep these wear, too.

        Args:
            problem: the problem whose duration is one cycle.
        """
        of_cycle = problem.description.responses.get(self.name)
        part = DRAWN_FROM[DEPTH if of_cycle else self.name.partition(" ")[0]]
        reached = {source for source in PARTS if part in REACHES.get(source, (source,))}
        return frozenset(reached) | (of_cycle.depends_on if of_cycle else frozenset())


def _error_at_end(life: WearLife, name: str, value: float) -> float:
    """Half of the 95 % interval of a quantity at the end of a life, in its unit."""
    if name in life.problem.response_names:
        return CONFIDENCE * float(life.stages[-1].settled.responses()[name][1])
    errors = life.errors_of_volume if name.startswith(VOLUME) else life.errors
    return abs(value) * float(errors[-1])


class LifeExperiment(AbstractExperiment):
    """Lives of the machine of a problem, and what is asked of them (`LifeProblem`)."""

    problem: Problem
    response: dict[str, Callable]
    cycles: float | None = eqx.field(static=True)
    accuracy: float = eqx.field(static=True)
    max_cycles: int = eqx.field(static=True)
    response_names: tuple[str, ...] = derived(static=True)

    def __init__(
        self,
        problem: Problem,
        response: dict[str, Callable],
        cycles: float | None,
        accuracy: float,
        max_cycles: int,
    ):
        self.problem, self.response = problem, response
        self.cycles = None if cycles is None else float(cycles)
        self.accuracy, self.max_cycles = float(accuracy), max_cycles
        self.response_names = tuple(response)
        quantities = self._quantities()
        for function in self._limits().values():
            check_name("quantity", function.name, quantities, " in this life")
        others = [name for name in self.response_names if name not in self._limits()]
        if self.cycles is None and others:
            raise ValueError(
                f'response "{others[0]}" of a LifeProblem does not decide how long a life is; it '
                "needs cycles=, how long a life is."
            )

    @property
    def subject(self):
        return self.problem.experiment.subject

    def life(self, values: Any) -> WearLife:
        """The life of one set of values. Raises `SimulationError` where it has no first cycle, and
        `ValueError` for values that make no machine."""
        deciding = list(self._limits().values())
        if self.cycles is not None and len(deciding) < len(self.response):
            return self._simulate_life(values, self.cycles)
        longest = np.inf if self.cycles is None else self.cycles
        # What a cycle wears says how long to live.
        cycles, most = min(1.0, longest), np.inf
        life = self._simulate_life(values, cycles)
        for tried in range(TRIES):
            aheads = lengths = [f.ahead(life) for f in deciding]
            if self.cycles is None:
                # A limit that is never reached keeps no other from being reached.
                aheads = [length for length in aheads if cycles + length < most]
            ahead = max(aheads, default=0.0)
            if self.cycles is None and not tried and not np.all(np.isfinite(lengths)):
                # A first cycle alone does not say that a limit is never reached.
                ahead = max(ahead, LONGEST)
            elif ahead > 0:
                most = min(most, LONGEST * (cycles + ahead))
            if life.ended or ahead == 0 or cycles >= longest:
                break
            # Rates that put the limit further at every look end at the most.
            far = most if self.cycles is None else longest
            last = tried == TRIES - 1 and np.isfinite(far)
            cycles = far if last else min(cycles + max(BEYOND * ahead, 1.0), longest)
            life = self._simulate_life(values, cycles)
        return life

    def evaluate(self, setting, *, discrete_derivatives=False):
        values = setting.values
        if isinstance(values, jax.core.Tracer):
            raise ValueError(
                "a life chooses its own steps and is no compiled program: ask for it by surfaces, "
                "samples or differences, and for slopes jaxclear.wear_life_derivatives."
            )
        try:
            life = self.life(values)
        except SimulationError:
            return self._failed_sample(Outcome.NOT_FINITE)
        except ValueError:
            return self._failed_sample(self._why_impossible(values))
        answers = {name: np.asarray(answer(name, f, life)) for name, f in self.response.items()}
        # One with a length asked for is of no use before its end to what is asked of that.
        limits = self._limits()
        is_complete = not life.ended or len(limits) == len(self.response)
        finite = [
            not np.isnan(value) if name in limits else np.isfinite(value)
            for name, value in answers.items()
        ]
        outcome = Outcome.REACHED if is_complete and all(finite) else Outcome.NOT_FINITE
        ended = np.asarray(life.cycles[-1])
        return SampleResult(answers, np.asarray(int(outcome)), ended, life.checks)

    def cost(self):
        return Cost(self.problem.cost().memory, 1, compiled=False)

    def detail(self, setting, index, chunk) -> WearLife:
        """The life of one sample.

        Args:
            setting: values of the sample.
            index, chunk: of the sample in its study, not needed here.
        """
        return self.life(setting.values)

    def describe(self):
        early = (
            "the life ended after {ended:.4g} cycles without telling what is asked. Rerun it and "
            "print the life to see what ended it."
        )
        endings = {outcome: early for outcome in Outcome if outcome.began} | {
            Outcome.REACHED: "the life tells what is asked of it.",
            Outcome.OUT_OF_RANGE: "these numbers make no machine that wears.",
        }
        return Description(
            "LifeProblem",
            {name: self._response_info(name) for name in self.response_names},
            endings,
            remark=self.problem.description.remark,
            derivative=(
                "a life chooses its own steps; ask jaxclear.wear_life_derivatives for one.",
                "",
            ),
        )

    def _response_info(self, name: str) -> ResponseInfo:
        response = self._limits().get(name)
        if response is None:
            return ResponseInfo()
        unit, parts = "cycles", response.depends_on(self.problem)
        if self.cycles is None:
            far = f"its limit is forecast beyond {LONGEST:g} times what the first cycles say"
            return ResponseInfo(unit, parts, infinite=far)
        far = f"its limit is not reached within {self.cycles:.6g} cycles"
        return ResponseInfo(unit, parts, infinite=far, horizon=self.cycles)

    def parts(self):
        # By the names with which folders were written.
        keys = {
            "response": "response",
            "cycles": "cycles",
            "tolerance": "accuracy",
            "most": "max_cycles",
        }
        settings = {f"{name} of lives": getattr(self, what) for name, what in keys.items()}
        return self.problem.experiment.parts() | settings

    def _limits(self) -> dict[str, LifeUntil]:
        """Responses that say by themselves how long a life is."""
        return {name: f for name, f in self.response.items() if isinstance(f, LifeUntil)}

    def _quantities(self) -> list[str]:
        """All that a life tells of."""
        quantities = [DEPTH, VOLUME, *self.problem.response_names]
        for joint, surfaces in wearing_in(self.problem.mechanism).items():
            for surface in surfaces.maps():
                quantities += [f"{DEPTH} {joint} {surface}", f"{VOLUME} {joint} {surface}"]
        return quantities

    def _why_impossible(self, values: Any) -> Outcome:
        """Why a set of values makes no machine that lives."""
        try:
            check_values("this mechanism", self.problem.with_values(values))
        except ValueError:
            return Outcome.OUT_OF_RANGE
        try:
            first_state(self.problem, values)
        except ValueError:
            return Outcome.UNASSEMBLED
        return Outcome.OUT_OF_RANGE

    def _simulate_life(self, values: Any, cycles: float) -> WearLife:
        patience = Patience(SETTLED, float(self.accuracy), self.max_cycles)
        rates = Rates(self.problem, values, patience)
        return lived(rates, float(cycles), float(self.accuracy), None)

    def _failed_sample(self, outcome: Outcome) -> SampleResult:
        """A sample without a life, of the same shape as others."""
        nothing: dict[str, Any] = dict.fromkeys(self.response_names, np.asarray(np.nan))
        nominal = self.problem.nominal()
        request, start = cycle_request(self.problem, nominal), first_state(self.problem, nominal)
        checks: Checks = kind_of_cycle(request, *start).checks
        none = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), checks)
        how: Any = np.asarray(int(outcome))
        ended: Any = np.zeros(())
        return SampleResult(nothing, how, ended, none)


@answering
def LifeProblem(
    problem: Problem,
    response: Callable | Mapping[str, Callable],
    *,
    cycles: float | None = None,
    accuracy: float = 1e-2,
    max_cycles: int = 12,
) -> Problem:
    """A problem of lives of the machine of a problem, whose duration is one cycle. Variables are
    that problem's.

    A life whose limit is not reached within `cycles`, or without them by a forecast from its last
    rate not in 100 times what its first cycles say, is infinite: longer than told. That counts as
    such in shares, quantiles and limits; a mean of it is refused. Without `cycles` it counts as
    longer than any limit: give them where one is to be that long. A sample whose life ends by a
    failed cycle before it tells what is asked has failed.

    Args:
        problem: the problem of a mechanism in time whose duration is one cycle.
        response: a `jaxclear.LifeUntil`, any function of what `jaxclear.wear_life` returns (its
            `at_end`, say), or several by name.
        cycles: how long lives are followed [1], for functions; a `LifeUntil` goes without, and a
            life is then as long as it takes to reach the limits.
        accuracy: relative error of the wear [1], > 0, as in `wear_life`.
        max_cycles: the largest number of cycles [1] that may settle, as in `wear_life`.

    Raises:
        ValueError: with a sentence for what cannot be asked.
    """
    check_cycle("the problem of a LifeProblem", problem)
    check_wear_problem(problem)
    if cycles is not None:
        check_cycles("a LifeProblem", cycles)
    check_number("accuracy of a LifeProblem", accuracy, above=0)
    check_count("max_cycles of a LifeProblem", max_cycles)
    responses = by_name("response", response)
    check_responses(responses, problem.variables, "a life")
    lives = LifeExperiment(problem, responses, cycles, accuracy, max_cycles)
    return problem.with_experiment(lives)
