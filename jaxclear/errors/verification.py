"""A run and its replicas: the numerical errors of its standard answers, and of any other.

An error that falls in proportion to the step is twice what half of it changes, one that falls
faster is less (Richardson). Where a first replica finds something beyond half of what the
integrator promises, a second one with quarter steps is asked, as two runs may agree by chance; and
where paths in gaps have parted, a replica of the finer run whose start is moved in the tenth digit:
if these two agree, steps were too long; if not, the path is no answer.

Sources: Richardson 1911, Phil. Trans. R. Soc. A 210, 307, doi:10.1098/rsta.1911.0009; Roache 1994,
J. Fluids Eng. 116, 405, doi:10.1115/1.2910291.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from jaxclear.errors.accuracy import DRAWN, Asked, Seen
from jaxclear.errors.observables import parted
from jaxclear.errors.replicas import replica, thinned
from jaxclear.ground.quantity import is_traced
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.promise import PART_OF, Promise
from jaxclear.results.abstract_response import AbstractResponse
from jaxclear.results.trajectory import Trajectory
from jaxclear.results.verification import AbstractVerification, Estimate, Unverified, with_error

HALF, QUARTER = 0.5, 0.25
# Share of the promise from which on a second replica is asked.
DOUBT = 0.5
# Steps of a run up to which its replicas are run unasked: seconds in any mechanism.
MOST_STEPS = 100_000
# By how much of a radian or of a metre the start of a replica is moved.
TENTH_DIGIT = 1e-10
WORDS = {
    "places": "of the longest way",
    "gaps": "of the clearance",
    "mean_force": "of the largest",
    "peak_force": "of the largest",
    "losses": "of the largest",
    DRAWN: "of itself",
}


class Told(NamedTuple):
    """A standard `answer` of a `part` of the promise at a `place`, its `value` and told `error` in
    its `unit`, the error as the `share` by which it is judged, what is `promised` of it (None:
    nothing), and whether it is `lost`: no run tells it."""

    answer: str
    part: str
    place: str
    unit: str
    value: float
    error: float
    share: float
    promised: float | None
    lost: bool

    @property
    def name(self) -> str:
        """The answer with its place."""
        return f'{self.answer}, "{self.place}"' if self.place else self.answer

    @property
    def beyond(self) -> bool:
        """Whether the error is beyond what is promised."""
        return self.promised is not None and not self.share <= self.promised


class Verified(AbstractVerification):
    """A run with `replicas`, as responses see them, the coarser one first; `numbers`: value, error,
    share and what is promised (nan: nothing) of each of the standard `answers` (answer, part,
    place, unit); `promise`: of its integrator, or what was asked; `lost`: which of them hang on the
    tenth digit of the start, and `path`: from when on [s], and within which time errors grow e-fold
    [s] (None: its path is an answer); `since` [s]: where the run began, from where on errors count;
    `why`: what the integrator was chosen for ("": it was given)."""

    replicas: tuple[Trajectory, ...]
    numbers: Float[np.ndarray, "answers 4"]
    lost: Bool[np.ndarray, " answers"]
    path: Float[np.ndarray, "2"] | None
    since: Float[np.ndarray, ""]
    promise: Promise
    answers: tuple[tuple[str, str, str, str], ...] = eqx.field(static=True)
    why: str = eqx.field(static=True, default="")

    @property
    def told(self) -> tuple[Told, ...]:
        """The standard answers."""
        rows = zip(self.answers, self.numbers.tolist(), self.lost.tolist(), strict=True)
        return tuple(
            Told(*names, value, error, share, None if math.isnan(most) else most, lost)
            for names, (value, error, share, most), lost in rows
        )

    @property
    def beyond(self):
        return frozenset(told.part for told in self.told if told.beyond)

    @property
    def warnings(self):
        beyond = sorted((t for t in self.told if t.beyond), key=lambda t: -t.share / t.promised)
        said = []
        if self.path is not None:
            since, growth = map(float, self.path)
            said.append(
                f"From {since:.3g} s on places in gaps hang on the tenth digit of the start "
                f"(e-fold in {growth:.2g} s): no run tells them; ask for means over samples."
            )
        answers = [told for told in beyond if not told.lost]
        return (*said, *([_sentence(answers)] if answers else []))

    def estimate(self, run, response):
        value = response(run)
        values = [response(each) for each in self.replicas]
        error = told_error([abs(np.asarray(value) - np.asarray(each)) for each in values])
        return Estimate(value, error, self._how())

    def _how(self) -> str:
        steps = "half" if len(self.replicas) == 1 else "half and quarter"
        since = f", since {float(self.since):.6g} s" if self.since else ""
        return f"twice what {steps} steps change{since}"

    def promised(self, response: Any) -> float | None:
        """The share that is promised of a response; None for nothing."""
        needs = response.drawn_from() if isinstance(response, AbstractResponse) else "anything"
        return getattr(self.promise, PART_OF.get(needs, ""), None)

    def table(self):
        import pandas

        columns = ("name", "value", "error", "unit", "share", "promised")
        rows = [[getattr(told, column) for column in columns] for told in self.told]
        return pandas.DataFrame(rows, columns=["answer", *columns[1:]])

    def attributes(self):
        rows = [f"{t.name}: {t.error:.2g} {t.unit}" for t in self.told]
        return {"numerical errors": "; ".join(rows)}

    def __str__(self) -> str:
        width = max(len(told.name) for told in self.told)
        lines = [f"{'answer':{width}}  {'value ± numerical error':28}{'share':>9}{'promised':>10}"]
        for told in self.told:
            number = f"{with_error(told.value, told.error)} {told.unit}"
            own = "–" if told.promised is None else f"{100 * told.promised:.2g} %"
            mark = "  lost" if told.lost else "  <- beyond" if told.beyond else ""
            share = f"{100 * told.share:.2g} %"
            lines.append(f"{told.name:{width}}  {number:28}{share:>9}{own:>10}{mark}")
        return "\n".join([*lines, f"Numerical errors are {self._how()}. {self.why}".rstrip()])


def told_error(differences: list[Any]) -> Any:
    """The error that differences from the half, and the quarter, tell of steps of order 1."""
    errors = [d / (1 - share) for d, share in zip(differences, (HALF, QUARTER), strict=False)]
    return np.max(errors, axis=0)


def verified(
    run: Trajectory,
    integrator: AbstractIntegrator,
    again: Callable[..., Trajectory],
    verify: bool | None,
    asked: Asked | None = None,
) -> Trajectory:
    """The run with what its replicas tell; `again(replica, moved)`: the same run as that
    `Replica` is made, its start moved by so much. `verify`: whether replicas are run (None: where
    they take seconds at the most). `asked`: the accuracy (None: what the integrator promises)."""
    asked = Asked(integrator.promise) if asked is None else asked
    why = _why_not(run, verify)
    if why:
        why = f"{why}. {asked.why.removesuffix('.')}" if asked.why else why
        return dataclasses.replace(run, verification=Unverified(why))
    plans = [replica(integrator, run.time, share) for share in (HALF, QUARTER)]
    if plans[0] is None:
        return dataclasses.replace(run, verification=Unverified("its steps cannot be refined"))

    def repeated(plan: Any, moved: float = 0.0) -> Trajectory:
        return thinned(again(plan, moved), plan.every)

    own = asked.seen(run)
    replicas: list[Trajectory] = []
    seen: list[Seen] = []
    for plan in plans:
        replicas.append(repeated(plan))
        if not replicas[-1].succeeded:
            return dataclasses.replace(run, verification=Failed(replicas[-1].result))
        seen.append(asked.seen(replicas[-1]))
        rows = list(zip(*(asked.apart(run, own, other) for other in seen), strict=True))
        promised = np.array([_number(asked.promised(row[0])) for row in rows])
        shares = np.array([float(told_error([each.share for each in row])) for row in rows])
        if not np.any(~np.isnan(promised) & ~(shares <= DOUBT * promised)):
            break
    errors = [float(told_error([each.off for each in row])) for row in rows]
    numbers = np.stack([[row[0].value for row in rows], errors, shares, promised], axis=1)
    path, lost = None, np.zeros(len(rows), bool)
    gaps = np.array([row[0].part == "gaps" for row in rows])
    if np.any(gaps & ~np.isnan(promised) & ~(shares <= promised)):
        limit = float(np.nanmin(promised[gaps]))
        path, lost = _lost(run, asked, seen[0], repeated(plans[0], TENTH_DIGIT), limit)
    known = tuple(dataclasses.replace(each, verification=Unverified()) for each in replicas)
    answers = tuple((row[0].answer, row[0].part, row[0].place, row[0].unit) for row in rows)
    since = np.asarray(run.time[0])
    found = Verified(known, numbers, lost, path, since, asked.promise, answers, asked.why)
    return dataclasses.replace(run, verification=found)


def _number(promised: float | None) -> float:
    return math.nan if promised is None else promised


def _why_not(run: Trajectory, verify: bool | None) -> str:
    """Why a run has no replicas; "" where it is to have some."""
    if verify is False:
        return "verify=False"
    if is_traced((run.outcome, run.states)):
        return "a run that is traced has no replicas"
    if not run.succeeded:
        return "the run ended early"
    if verify is None and int(run.accepted_steps) > MOST_STEPS:
        return f"beyond {MOST_STEPS} steps replicas are run with verify=True"
    return ""


class Failed(AbstractVerification):
    """Of a run whose replica ended early; `result` says why."""

    result: str = eqx.field(static=True)

    def __str__(self) -> str:
        return self.warnings[0]

    @property
    def warnings(self):
        return (f"With shorter steps the same run fails, so its numbers may be off: {self.result}",)

    @property
    def beyond(self):
        return frozenset(Promise._fields)

    def estimate(self, run, response):
        return Estimate(response(run), math.nan, self.warnings[0])

    def table(self):
        return Unverified().table()

    def attributes(self):
        return {"verification": str(self)}


def _lost(
    run: Trajectory, asked: Asked, finer: Seen, moved: Trajectory, limit: float
) -> tuple[np.ndarray | None, np.ndarray]:
    """(from when on [s] a path hangs on the tenth digit of its start, and within which time errors
    grow e-fold [s]; None where it does not; which answers are lost by that), from how far a `finer`
    run and the same with its start `moved` are apart, in gaps by more than the `limit`."""
    other = asked.seen(moved)
    rows = [(row.share, asked.promised(row)) for row in asked.apart(run, finer, other)]
    lost = np.array([most is not None and share > most for share, most in rows])
    off = parted(finer.standard, other.standard)
    beyond = off > limit
    if not moved.succeeded or not beyond.any():
        return None, np.zeros(len(rows), bool)
    first = int(np.argmax(beyond))
    elapsed = float(run.time[first] - run.time[0])
    began = max(float(off[0]), TENTH_DIGIT)
    growth = elapsed / max(math.log(float(off[first]) / began), 1.0)
    return np.array([float(run.time[first]), growth]), lost


def _sentence(beyond: list[Told]) -> str:
    """What is off, by how much, and what to do, of the answers that are furthest beyond."""
    worst = beyond[0]
    more = f" (and {len(beyond) - 1} more answers)" if len(beyond) > 1 else ""
    told = f"{worst.share:.2g} {WORDS[worst.part]} ({worst.promised:g} promised)"
    todo = "take shorter steps"
    if worst.answer == "worn depth":
        todo = "save more often, which is when surfaces wear, or take shorter steps"
    return f"{worst.name[0].upper()}{worst.name[1:]}: error about {told}{more}; {todo}."
