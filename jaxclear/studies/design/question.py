"""A design's question: what may be chosen, what a candidate costs, how far it breaks each limit.

An optimiser sees numbers between 0 and 1: nominal values by proportion, tolerances by the logarithm
(costs are powers of them). A tolerance scales the variable's own distribution.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.ground.quantity import Scalar
from jaxclear.ground.wording import described
from jaxclear.studies.design.catalogue import AbstractCatalogue
from jaxclear.studies.design.cost import AbstractCost
from jaxclear.studies.design.limit import AbstractLimit, Sample, check_levels
from jaxclear.studies.design.population import AbstractModel, Points

NOMINAL, TOLERANCE = "nominal", "tolerance"
# Shares of a normal distribution three standard deviations out, which stand for the tolerance of
# a distribution without ends.
THREE_DEVIATIONS = 0.9986501019683699
# So close to a number of a catalogue is that number.
SAME_NUMBER = 1e-12


class Choice(NamedTuple):
    """A free number: of which variable (index), whether its nominal value or its tolerance, its
    range, and what there is to choose from, rising, with what that is called (none: anything
    within). `others` are further variables that have the same tolerance; `nominals` the nominal
    value that belongs to each offered tolerance (none: it stays), and `usual` the tolerance that
    the problem has then (None: that of the distribution)."""

    kind: str
    variable: int
    low: float
    high: float
    offered: tuple[float, ...] = ()
    labels: tuple[str, ...] = ()
    others: tuple[int, ...] = ()
    nominals: tuple[float, ...] = ()
    usual: float | None = None


class Freedom(eqx.Module):
    """The free numbers of a design; `names` of the variables, `start` and `usual` their nominal
    values and tolerances where nothing is chosen."""

    choices: tuple[Choice, ...] = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    start: np.ndarray
    usual: np.ndarray

    @property
    def size(self) -> int:
        """How many free numbers there are."""
        return len(self.choices)

    def label(self, i: int) -> str:
        """A free number in words."""
        choice = self.choices[i]
        return f"{choice.kind} {self.names[choice.variable]}"

    def decoded(self, place: Float[Array, " size"]) -> tuple[Array, Array]:
        """(nominal values, tolerances) of all variables."""
        numbers = {NOMINAL: jnp.asarray(self.start), TOLERANCE: jnp.asarray(self.usual)}
        for i, choice in enumerate(self.choices):
            value = _number_at(choice, place[i])
            columns = np.array((choice.variable, *choice.others))
            numbers[choice.kind] = numbers[choice.kind].at[columns].set(value)
            if choice.nominals:
                mean = jnp.interp(value, np.array(choice.offered), np.array(choice.nominals))
                numbers[NOMINAL] = numbers[NOMINAL].at[choice.variable].set(mean)
        return numbers[NOMINAL], numbers[TOLERANCE]

    def drawn(self, place: Float[Array, " size"]) -> tuple[np.ndarray, np.ndarray]:
        """(nominal values, tolerances) as they stand in a drawing: those that come from a catalogue
        to the last digit as it has them, which their places between 0 and 1 are not."""
        numbers = dict(zip((NOMINAL, TOLERANCE), map(np.array, self.decoded(place)), strict=True))
        for choice in self.choices:
            values = numbers[choice.kind]
            for number in choice.offered:
                if np.isclose(values[choice.variable], number, rtol=SAME_NUMBER, atol=0.0):
                    values[[choice.variable, *choice.others]] = number
        return numbers[NOMINAL], numbers[TOLERANCE]

    def encoded(self, nominal: np.ndarray, tolerance: np.ndarray) -> np.ndarray:
        """The numbers between 0 and 1 of a design, which is brought within its bounds."""
        values = {NOMINAL: nominal, TOLERANCE: tolerance}
        places = [_place(choice, values[choice.kind][choice.variable]) for choice in self.choices]
        return np.clip(np.array(places), 0.0, 1.0)

    def place(self, i: int, number: float) -> float:
        """The place between 0 and 1 of a value of a free number."""
        return float(_place(self.choices[i], number))

    def places(self, i: int) -> list[float]:
        """Places of everything that the catalogue of a free number has, rising."""
        choice = self.choices[i]
        return [float(_place(choice, number)) for number in choice.offered]


def _number_at(choice, place):
    if choice.kind == NOMINAL:
        return choice.low + place * (choice.high - choice.low)
    return choice.low * jnp.exp(place * np.log(choice.high / choice.low))


def _place(choice, number):
    if choice.kind == NOMINAL:
        return (number - choice.low) / (choice.high - choice.low)
    return np.log(number / choice.low) / np.log(choice.high / choice.low)


def usual_tolerance(distribution: Any) -> float:
    """Half of the range of a distribution; of one without ends, half of what lies between three
    standard deviations of a normal one."""
    ends = [float(distribution.quantile(share)) for share in (0.0, 1.0)]
    if not np.all(np.isfinite(ends)):
        shares = (1.0 - THREE_DEVIATIONS, THREE_DEVIATIONS)
        ends = [float(distribution.quantile(share)) for share in shares]
    return 0.5 * (ends[1] - ends[0])


def freedom_of(problem: Any, nominal: Any, tolerance: Any, lines: Sequence[Choice]) -> Freedom:
    """The free numbers of a design.

    Args:
        problem: with the variables.
        nominal, tolerance: ranges or catalogues by variable; None: fixed.
        lines: choices of lines of a drawing.

    Raises:
        ValueError: a name is unknown or given twice, or nothing is left open.
    """
    names = problem.names
    choices = list(lines)
    chosen = {names[i] for choice in choices for i in (choice.variable, *choice.others)}
    for kind, ranges in ((NOMINAL, nominal), (TOLERANCE, tolerance)):
        expect(ranges or {}, Mapping, f"{kind} of design", "a dictionary from names of variables")
        for name, span in (ranges or {}).items():
            check_name("variable", name, names, " in this problem")
            if name in chosen:
                raise ValueError(
                    f'"{name}" is in `{kind}` and of a line in `choose`; leave out one.'
                )
            choices.append(choice_of(kind, name, names.index(name), span))
    if not choices:
        raise ValueError(
            "nothing is left open: give design a `tolerance` or a `nominal` with bounds, such as "
            f'tolerance={{"{names[0] if names else "name"}": (1e-6, 1e-4)}}.'
        )
    usual = np.array(list(map(usual_tolerance, problem.inputs.distributions)))
    for choice in lines:
        usual[choice.variable] = choice.usual or usual[choice.variable]
    return Freedom(tuple(choices), names, np.asarray(problem.nominal()), usual)


def choice_of(kind: str, name: str, index: int, span: Any) -> Choice:
    """A free number, from its range or catalogue.

    Args:
        kind: nominal value or tolerance.
        name: of the variable.
        index: of the variable in the problem.
        span: (smallest, largest), or one of `jaxclear.catalogue`.

    Raises:
        ValueError: `span` is neither, or holds impossible numbers.
    """
    what = f'{kind} of "{name}"'
    if isinstance(span, AbstractCatalogue):
        numbers = span.numbers()
        if len(numbers) < 2 or (kind == TOLERANCE and numbers[0] <= 0):
            raise ValueError(f"the catalogue for {what} must hold two sizes or more, above 0.")
        labels = tuple(span.label(number) for number in numbers)
        return Choice(kind, index, numbers[0], numbers[-1], tuple(numbers), labels)
    if not isinstance(span, (tuple, list)) or len(span) != 2:
        raise ValueError(
            f"{what} is {described(span)}; it must be (smallest, largest) or a jaxclear.catalogue."
        )
    low, high = span
    bounds: dict[str, Any] = {"above": 0} if kind == TOLERANCE else {}
    check_number(f"smallest {what}", low, **bounds)
    check_number(f"largest {what}", high, above=float(low))
    return Choice(kind, index, float(low), float(high))


Cost = dict[str, AbstractCost] | Callable[[dict, dict], Any]


class Question(eqx.Module):
    """What is asked: `inputs` is the joint distribution of the problem's variables, `sizes`
    (limits,) what an excess is measured by."""

    freedom: Freedom
    cost: Any
    limits: tuple[AbstractLimit, ...]
    inputs: Any
    sizes: np.ndarray

    def price(self, place: Float[Array, " free"]) -> Scalar:
        """Cost of a candidate."""
        nominal, tolerance = self.freedom.decoded(place)
        names = self.freedom.names
        if not isinstance(self.cost, dict):
            numbers = [dict(zip(names, values, strict=True)) for values in (nominal, tolerance)]
            return jnp.asarray(self.cost(*numbers), float)
        parts = [cost(tolerance[names.index(name)]) for name, cost in self.cost.items()]
        return jnp.sum(jnp.stack(parts))

    @eqx.filter_jit
    def values(self, place: Float[Array, " free"], normal: Any) -> Array:
        """Values (samples, variables) of the parts of a candidate."""
        nominal, tolerance = self.freedom.decoded(place)
        widths = tolerance / jnp.asarray(self.freedom.usual)
        moved = lambda inputs: (inputs.nominal, inputs.widths)
        return eqx.tree_at(moved, self.inputs, (nominal, widths)).values(jnp.asarray(normal))

    @eqx.filter_jit
    def samples(self, place: Array, model: AbstractModel, points: Points) -> list[Sample]:
        """Samples of each limited response for a candidate.

        Args:
            place: the candidate, shape (free,).
            model: responses of its parts.
            points: standard normal points of the population.
        """
        values = self.values(place, points.normal)
        responses = model(values)
        weights = jnp.asarray(points.weights)
        return [
            Sample(self.of(limit, values, responses), weights, self._ends(limit, place, model))
            for limit in self.limits
        ]

    def excesses(self, place: Array, model: AbstractModel, points: Points) -> Array:
        """By how much a candidate exceeds each limit, in multiples of `sizes` [1], shape (limits,).

        Args:
            place: the candidate, shape (free,).
            model: responses of its parts.
            points: standard normal points of the population.
        """
        pairs = zip(self.limits, self.samples(place, model, points), strict=True)
        return jnp.stack([limit.excess(sample) for limit, sample in pairs]) / self.sizes

    def of(self, limit: AbstractLimit, values: Any, responses: dict) -> Any:
        """Values of a limited response or variable, shape (samples,).

        Args:
            limit: names the response or variable.
            values: of the variables, shape (samples, variables).
            responses: by name, shape (samples,).
        """
        if limit.response in responses:
            return responses[limit.response]
        return values[:, self.freedom.names.index(limit.response)]

    def levels(self, response: str) -> list[float]:
        """Values of a response that decide, over all its limits."""
        limits = [limit for limit in self.limits if limit.response == response]
        return [float(level) for limit in limits for level in limit.levels()]

    def measured_by(self, sizes: np.ndarray) -> "Question":
        """The same with other sizes."""
        return eqx.tree_at(lambda q: q.sizes, self, sizes)

    @eqx.filter_jit
    def one_each(self, places: Any, normal: Any) -> Array:
        """Values (samples, variables) of one part, at `normal` (samples, variables), of each of the
        candidates `places` (samples, free)."""
        return jax.vmap(lambda place, row: self.values(place, row))(places, normal)

    def with_limits(self, limits: tuple[AbstractLimit, ...]) -> "Question":
        """The same with other limits."""
        return Question(self.freedom, self.cost, limits, self.inputs, self.sizes)

    def _ends(self, limit, place, model):
        """Values of what a limit is about at its two corners, (2,)."""
        if not limit.extreme():
            return jnp.zeros(2)
        corners = [self.corner(limit, place, model, side) for side in (-1.0, 1.0)]
        return jnp.stack([self.one(limit, corner, model) for corner in corners])

    def one(self, limit: AbstractLimit, values: Array, model: AbstractModel) -> Scalar:
        """The limited response or variable for one part.

        Args:
            limit: names the response or variable.
            values: of the variables, shape (variables,).
            model: responses of parts.
        """
        batch = values[None]
        return self.of(limit, batch, model(batch))[0]

    def corner(
        self, limit: AbstractLimit, place: Array, model: AbstractModel, side: float
    ) -> Array:
        """Values (variables,) at which all tolerances raise or lower what a limit is about, by the
        slopes of a model.

        Args:
            limit: names the response or variable.
            place: the candidate, shape (free,).
            model: whose slopes at the nominal values decide the corner.
            side: 1 for the largest value, -1 for the smallest.
        """
        nominal, tolerance = self.freedom.decoded(place)
        slope = jax.jacfwd(lambda x: self.one(limit, x, model))(nominal)
        return nominal + side * jnp.sign(jax.lax.stop_gradient(slope)) * tolerance


def checked_cost(cost: Any, freedom: Freedom) -> Cost:
    """What a user gives as cost. Raises `ValueError` with a sentence for what cannot be."""
    if callable(cost) and not isinstance(cost, (Mapping, AbstractCost)):
        return cost
    expect(
        cost,
        Mapping,
        "cost of design",
        "a dictionary from names of variables to members of jaxclear.cost, or a function of "
        "(nominal, tolerance)",
    )
    free = {c.variable: c for c in freedom.choices if c.kind == TOLERANCE}
    if not cost:
        raise ValueError("cost of design is empty; it must hold a cost for one tolerance at least.")
    for name, term in cost.items():
        check_name("variable", name, freedom.names, " in this problem")
        expect(term, AbstractCost, f'cost of "{name}"', "one of jaxclear.cost, such as Reciprocal")
        choice = free.get(freedom.names.index(name))
        low, high = term.tolerance_range()
        if choice is not None and not low <= choice.low < choice.high <= high:
            raise ValueError(
                f'cost of "{name}" is known for tolerances from {low:g} to {high:g}, and its '
                f"tolerance may be {choice.low:g} to {choice.high:g}; narrow its bounds."
            )
    bare = [freedom.names[i] for i in free if freedom.names[i] not in cost]
    if bare:
        raise ValueError(
            f'the tolerance of "{bare[0]}" is free and costs nothing; give it a cost, or a fixed '
            "tolerance."
        )
    return dict(cost)


def checked_limits(limits: Any, problem: Any) -> tuple[AbstractLimit, ...]:
    """What a user gives as limits. Raises `ValueError` with a sentence for what cannot be."""
    all_limits = [limits] if isinstance(limits, AbstractLimit) else limits
    if not isinstance(all_limits, Sequence) or isinstance(all_limits, str) or not all_limits:
        raise ValueError(
            f"limits of design are {described(limits)}; they must be members of jaxclear.limit, "
            "one at least."
        )
    for limit in all_limits:
        expect(limit, AbstractLimit, "a limit of design", "one of jaxclear.limit")
        names = (*problem.response_names, *problem.names)
        check_name("response", limit.response, names, " in this problem (nor variable)")
        if limit.response in problem.response_names:
            check_levels(problem, limit)
    return tuple(all_limits)


def sizes_of(question: Question, place: np.ndarray, model: AbstractModel, points: Points) -> Any:
    """Sizes by which the limits' excesses are measured, shape (limits,).

    Args:
        question: with the limits.
        place: the candidate, shape (free,).
        model: responses of its parts.
        points: standard normal points of the population.
    """
    samples = question.samples(jnp.asarray(place), model, points)
    pairs = zip(question.limits, samples, strict=True)
    return np.array([float(limit.size(sample)) for limit, sample in pairs])
