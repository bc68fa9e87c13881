"""What `jaxclear.design` answers: numbers for a drawing, whether they were seen to keep the limits,
and what each limit costs."""

from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.ground.printing import as_written, in_few, with_error
from jaxclear.ground.table import as_table
from jaxclear.studies.answer import VARIABLE, AbstractAnswer, Column, Stated, columns_of
from jaxclear.studies.design.cost import Processes
from jaxclear.studies.design.limit import AbstractLimit
from jaxclear.studies.design.question import NOMINAL, Question
from jaxclear.studies.design.search import Round
from jaxclear.studies.problem import Problem
from jaxclear.studies.run_warnings import FEW_WARNED, sentences, warned_share
from jaxclear.studies.surface.response_surface import TRUSTED

# Limits of lengths and angles below this are priced by the thousandth of a millionth, others by the
# millionth [m, rad].
SMALL = 1e-6
ENDINGS = {
    "rounds": "The rounds were used up before the search settled: more of them "
    "(DesignSettings(rounds=...)) may find a better design.",
    "interrupted": "Interrupted: this is the best so far.",
    "infeasible": "",
    "holds": "",
}


class Design(AbstractAnswer):
    """A design: `nominal` values and `tolerances` of all variables by name, its `cost`; of each
    limit the number found by new runs with its 95 % error and its price.

    `numbers`, `errors`, `excess` (limits,) are those of its verification (`nan` without one);
    `excess` [1] and `prices` [cost for a unit of the bound] belong to the limits in their order;
    no limit has a price (`nan`) where the search ended before it knew.
    `rounds` are the history, `best` the number of the one that is the answer: the cheapest of those
    that hold. `runs` is how many samples were used, `computed` how many of them this time.
    """

    problem: Problem
    question: Question
    nominal: dict[str, float]
    tolerances: dict[str, float]
    cost: float
    numbers: np.ndarray
    errors: np.ndarray
    excess: np.ndarray
    prices: np.ndarray
    rounds: tuple[Round, ...]
    best: int = eqx.field(static=True)
    ended: str = eqx.field(static=True)
    allowed_excess: float = eqx.field(static=True)
    runs: int = eqx.field(static=True)
    computed: int = eqx.field(static=True)
    failed: int = eqx.field(static=True)
    # Responses that are infinite in some runs, and what that says.
    endless: tuple[str, ...] = eqx.field(static=True, default=())
    # How many of all runs warn of what concerns the limited responses.
    warnings: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def limits(self) -> tuple[AbstractLimit, ...]:
        """The limits, in the order in which they were given."""
        return self.question.limits

    @property
    def round(self) -> Round:
        """The round that is the answer."""
        return self.rounds[self.best]

    @property
    def verified(self) -> bool:
        """Whether new runs have looked at this very design."""
        return self.round.check is not None

    @property
    def seen_by(self) -> int:
        """New runs that looked at this very design."""
        check = self.round.check
        return 0 if check is None else check.runs

    @property
    def holds(self) -> bool:
        """Whether new runs found every limit kept, to within what it may be missed by (where their
        error is larger than that, it does not cross the bound), no more of
        them failed than 1 %, or than the share that the rarest limit speaks of, and no more than
        5 % of them warn of what concerns a limited response."""
        is_met = self.verified and bool(np.all(self._satisfied))
        return is_met and not self._too_many_failed and not self._in_doubt

    @property
    def _satisfied(self):
        check = self.round.check
        return (
            np.zeros(len(self.limits), bool) if check is None else check.holds(self.allowed_excess)
        )

    @property
    def infeasible(self) -> bool:
        """Whether no choice within the bounds keeps all limits, as far as the search has seen; then
        the limits have no price."""
        return self.ended == "infeasible"

    @property
    def _beyond(self):
        """The limits that new runs found broken, by number."""
        return np.flatnonzero(~(self.excess <= self.allowed_excess))

    @property
    def _in_doubt(self):
        """What is said of the new runs where too many of them warn of what a limit is about."""
        check = self.round.check
        if check is None:
            return ()
        many = lambda name: warned_share(self.problem, name, check.codes) > FEW_WARNED
        return sentences(self.problem, check.codes, [name for name in self._limited if many(name)])

    @property
    def _limited(self):
        """Responses that limits are about."""
        limited = dict.fromkeys(limit.response for limit in self.limits)
        return [name for name in limited if name in self.problem.response_names]

    @property
    def _too_many_failed(self):
        check = self.round.check
        return check is not None and check.too_many_failed(self.question)

    @property
    def distrusted(self) -> tuple[str, ...]:
        """Limited responses whose surface does not stand for runs (leave-one-out R2 below 0.9)."""
        quality = self.round.quality
        return tuple(name for name in self._limited if quality.get(name, 1.0) < TRUSTED)

    @property
    def processes(self) -> dict[str, str]:
        """The process of each variable whose cost offers several, by name."""
        cost = self.question.cost
        offered = cost.items() if isinstance(cost, dict) else ()
        return {
            name: process_cost.process(self.tolerances[name])
            for name, process_cost in offered
            if isinstance(process_cost, Processes)
        }

    def label(self, i: int) -> str:
        """What a free number is in the catalogue that it comes from; "" without one."""
        choice = self.question.freedom.choices[i]
        values = self.nominal if choice.kind == NOMINAL else self.tolerances
        if not choice.offered:
            return ""
        number = values[self.question.freedom.names[choice.variable]]
        return choice.labels[int(np.argmin(np.abs(np.subtract(choice.offered, number))))]

    def sentence(self) -> str:
        """That no choice keeps the limits, and by how much; or the cost, whether the limits hold,
        which of them decide and what they cost."""
        parts = [f"Cost {self.cost:.6g}."]
        if self.infeasible:
            parts = [
                "Infeasible: no choice within the bounds keeps all limits. Of the one that breaks "
                f"them least, at a cost of {self.cost:.6g}, {self._broken_text()}. Widen what may "
                "be chosen, or the limits."
            ]
        if self.processes:
            made = (f"{name} {process}" for name, process in self.processes.items())
            parts.append(f"Processes: {', '.join(made)}.")
        if self.infeasible:
            pass
        elif not self.verified:
            parts.append("Not verified by runs of its own.")
        elif self.holds:
            within = f"to within {100 * self.allowed_excess:g} %"
            parts.append(f"All limits hold, by {self.seen_by} new runs, {within}.")
        else:
            broken = self._broken_text()
            parts += [f"It does not hold: {broken}."] if broken else []
            parts += [
                self._crossing(i) for i in np.flatnonzero(~self._satisfied) if i not in self._beyond
            ]
            parts += [f"It is not known to hold, by runs in doubt. {d}" for d in self._in_doubt]
        parts += [self._price_sentence(i) for i in np.flatnonzero(self.prices > 0)]
        if self.failed:
            parts.append(f"{self.failed} of {self.runs} runs failed and are left out.")
        parts += self.endless
        parts += [f"Of all runs: {d}" for d in self.warnings]
        parts += [
            f'The surface of "{name}" does not stand for its runs: the design was led by runs '
            "alone and may not be the cheapest."
            for name in self.distrusted
        ]
        parts += () if self.round.check is None else self.round.check.remarks
        return " ".join([*parts, ENDINGS[self.ended]]).rstrip()

    def unit(self, i: int) -> str:
        """Unit of a limited number."""
        units = self.problem.units() | dict(
            zip(self.problem.names, self.problem.variable_units, strict=True)
        )
        return self.limits[i].unit(units[self.limits[i].response])

    def _broken_text(self):
        broken = [self._broken_sentence(i) for i in self._beyond]
        return "; ".join([*broken, self._failure_text()] if self._too_many_failed else broken)

    def _crossing(self, i):
        number = with_error(float(self.numbers[i]), float(self.errors[i]))
        return (
            f"It is not known to hold: the {self.limits[i].words()} is {number}, whose error "
            f"crosses {as_written(self.limits[i].bound())}; verify by more runs "
            "(DesignSettings(check=...))."
        )

    def _broken_sentence(self, i):
        limit, number = self.limits[i], with_error(float(self.numbers[i]), float(self.errors[i]))
        side, unit = "above" if limit.upper() else "below", self.unit(i).removeprefix("1")
        excess = f"{in_few(abs(float(self.numbers[i] - limit.bound())), 3)} {unit}".rstrip()
        return f"the {limit.words()} is {number}, {excess} {side} {as_written(limit.bound())}"

    def _failure_text(self):
        check = self.round.check
        values = zip(self.question.freedom.names, check.failed_at, strict=True)
        such = ", ".join(f"{name} = {value:.6g}" for name, value in values)
        return (
            f"{check.failed} of {check.runs} new runs failed, such as that of {such}: narrow what "
            "may be chosen, or keep numbers within their range by a limit on them "
            "(limit.WorstCase of a variable)"
        )

    def _price_sentence(self, i):
        limit, price = self.limits[i], self.prices[i]
        small = self.question.sizes[i] < SMALL
        step, named = (1e-9, f"1 n{self.unit(i)}") if small else (1e-6, f"1 µ{self.unit(i)}")
        if self.unit(i) not in ("m", "rad"):
            step = 0.01 * abs(float(limit.bound())) or 1.0
            named = f"{step:.3g} {self.unit(i)}".removesuffix(" 1")
        direction = "more" if limit.upper() else "less"
        saved = in_few(price * step, 3)
        text = f"The limit on the {limit.words()} decides: {named} {direction} saves {saved}."
        check = self.round.check
        if check is None or check.excess_errors[i] <= self.allowed_excess:
            return text
        more = "more runs (DesignSettings(check=...)) may find a cheaper design."
        return f"{text} It is kept by its error as well: {more}"

    def _stated(self):
        freedom, over = self.question.freedom, (VARIABLE,)
        free: dict[str, dict[str, int]] = {name: {} for name in freedom.names}
        for i, choice in enumerate(freedom.choices):
            for variable in (choice.variable, *choice.others):
                free[freedom.names[variable]][choice.kind] = i
        named = lambda chosen: " ".join(filter(None, map(self.label, chosen.values())))
        units = zip(freedom.names, self.problem.variable_units, strict=True)
        columns = {
            "unit": Column(over, dict(units)),
            "nominal": Column(over, self.nominal),
            "tolerance": Column(over, self.tolerances),
            "chosen": Column(over, {name: " and ".join(chosen) for name, chosen in free.items()}),
            "catalogue": Column(over, {name: named(chosen) for name, chosen in free.items()}),
        }
        if self.processes:
            columns["process"] = Column(over, dict.fromkeys(freedom.names, "") | self.processes)
        limits = columns_of(self.limit_table().set_index("limit"), "limit", "limit ")
        columns |= limits | columns_of(self.history(), "round", "round ")
        numbers = {"cost": self.cost, "runs": self.runs}
        return Stated("design", columns, self.problem, (), numbers, labelled=False)

    def limit_table(self) -> Any:
        """A pandas table of the limits: number, 95 % error, bound, whether it holds, price of a
        unit of the bound."""
        rows = [
            {
                "limit": limit.words(),
                "unit": self.unit(i),
                "number": self.numbers[i],
                "error": self.errors[i],
                "bound": float(limit.bound()),
                "side": "at most" if limit.upper() else "at least",
                "holds": bool(self._satisfied[i]),
                "price": self.prices[i],
            }
            for i, limit in enumerate(self.limits)
        ]
        return as_table(rows, units={"price": "cost a unit"}, errors={"number": "error"})

    def history(self) -> Any:
        """A pandas table, a row a round: cost, largest excess by new runs, runs so far, what the
        surface covered of the bounds, the least leave-one-out R2 of a limited response."""
        limited = {limit.response for limit in self.limits}
        rows = []
        for one in self.rounds:
            quality = [q for name, q in one.quality.items() if name in limited]
            excess = np.nan if one.check is None else float(one.check.excess.max())
            rows.append(
                {
                    "cost": one.candidate.cost,
                    "largest excess": excess,
                    "runs": one.runs,
                    "region": one.region,
                    "least R2": min(quality, default=1.0),
                }
            )
        units = dict.fromkeys(("largest excess", "region", "least R2"), "1")
        return as_table(rows, units=units)


def prices_of(question: Question, multipliers: np.ndarray, samples: list) -> np.ndarray:
    """Cost that a unit of each bound would save, shape (limits,).

    Args:
        question: with the limits and their sizes.
        multipliers: cost saved by an excess of 1 of each limit, shape (limits,).
        samples: of each limited response.
    """
    rows = zip(question.limits, multipliers, samples, question.sizes, strict=True)
    return np.array([float(limit.give(x)) * factor / size for limit, factor, x, size in rows])
