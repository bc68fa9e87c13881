"""What replicas tell of a run: the errors of its standard answers as a table, of any other response
as an estimate, and the sentences where an error is beyond what the integrator promises.
"""

import dataclasses
import functools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.errors.observables import Apart
from jaxclear.ground.quantity import is_traced
from jaxclear.integrators.promise import PART_OF, Promise
from jaxclear.results.abstract_response import AbstractResponse
from jaxclear.results.trajectory import Trajectory
from jaxclear.results.verification import AbstractVerification, Estimate, Unverified, with_error

HALF, QUARTER = 0.5, 0.25
WORDS = {
    "places": "of the longest way",
    "gaps": "of the clearance",
    "mean_force": "of the largest",
    "peak_force": "of the largest",
    "losses": "of the largest",
}
HEAD = ("answer", "value ± error", "share", "promised")
# Depths hang on the saving times, at which surfaces are worn.
DEPTH = "worn depth"


class Told(NamedTuple):
    """A standard answer `name`, by its `part` of the promise: its `value` and told `error` in its
    `unit`, the error as a `share`, and what is `promised` of that (None: nothing)."""

    name: str
    part: str
    unit: str
    value: Any
    error: Any
    share: Any
    promised: float | None

    @property
    def beyond(self) -> bool:
        """Whether the error is beyond what is promised."""
        return self.promised is not None and not self.share <= self.promised


class Answer(NamedTuple):
    """Of a standard answer what is no number of the run."""

    name: str
    part: str
    unit: str
    promised: float | None


class Lost(NamedTuple):
    """Paths that hang on the tenth digit of the start: from when [s], and within which time errors
    grow e-fold [s]."""

    since: Any
    growth: Any


class Verified(AbstractVerification):
    """A run with `replicas`, as responses see them, the coarser one first; of its `answers` the
    `numbers`: value, told error and the error's share; `promise`: of its integrator; `lost`: where
    its path is no answer (None: it is one); `since` [s]: where the run began, from where on errors
    count; `remedy`: what makes them smaller."""

    replicas: tuple[Trajectory, ...]
    answers: tuple[Answer, ...] = eqx.field(static=True)
    numbers: Float[Array, "answers 3"]
    lost: Lost | None
    since: Any
    promise: Promise = eqx.field(static=True)
    remedy: str = eqx.field(static=True)

    def __init__(self, replicas, told, lost, since, promise, remedy):
        of_one = Unverified("a replica of another run")
        self.replicas = tuple(dataclasses.replace(run, verification=of_one) for run in replicas)
        self.answers = tuple(Answer(t.name, t.part, t.unit, t.promised) for t in told)
        self.numbers = np.array([(t.value, t.error, t.share) for t in told], float).reshape(-1, 3)
        self.lost, self.since, self.promise, self.remedy = lost, since, promise, remedy

    @property
    def told(self) -> tuple[Told, ...]:
        """The standard answers."""
        rows = zip(self.answers, self.numbers, strict=True)
        return tuple(Told(a.name, a.part, a.unit, *row, a.promised) for a, row in rows)

    @property
    def beyond(self):
        return frozenset(told.part for told in self.told if told.beyond)

    @property
    def warnings(self):
        beyond = sorted((t for t in self.told if t.beyond), key=lambda t: -t.share / t.promised)
        said = []
        if self.lost is not None:
            since, growth = self.lost
            said.append(
                f"From {since:.3g} s on places in gaps hang on the start's tenth digit (e-fold in "
                f"{growth:.2g} s): no run tells them; ask means over samples."
            )
            beyond = [told for told in beyond if told.part != "gaps"]
        if beyond:
            said.append(self._sentence(beyond))
        return tuple(said)

    def _sentence(self, beyond: list[Told]) -> str:
        """What is off, by how much, and what to do, of the answers that are furthest beyond."""
        worst, name = beyond[0], beyond[0].name
        others = {1: "", 2: " (and one more answer)"}
        remedy = "save more often" if name.startswith(DEPTH) else self.remedy
        more = others.get(len(beyond), f" (and {len(beyond) - 1} more answers)")
        by = f"{worst.share:.2g} {WORDS[worst.part]} ({worst.promised:g} promised)"
        return f"{name[0].upper()}{name[1:]}: error about {by}{more}; {remedy}."

    def estimate(self, run, response):
        value = response(run)
        try:
            values = [response(each) for each in self.replicas]
        except Exception as error:
            # What is found in a run need not be in its replica: a tenth impact, a row of a table.
            return Estimate(value, math.nan, f"in finer steps the same fails: {error}")
        try:
            error = jax.tree.map(_told_error, value, *values)
        except (TypeError, ValueError):
            return Estimate(value, math.nan, "the answer is no number, or of another form there")
        if not jax.tree.leaves(error):
            return Estimate(value, math.nan, "the answer is no number")
        if not all(is_traced(e) or np.all(np.isfinite(e)) for e in jax.tree.leaves(error)):
            return Estimate(value, error, "the answer is not finite, there or in finer steps")
        return Estimate(value, error, self._how())

    def _how(self) -> str:
        steps = "half" if len(self.replicas) == 1 else "half and quarter"
        since = "" if is_traced(self.since) or not self.since else f", since {self.since:.6g} s"
        return f"twice what {steps} steps change{since}"

    def promised(self, response: Any) -> float | None:
        """The share that is promised of a response; None for nothing."""
        needs = response.drawn_from() if isinstance(response, AbstractResponse) else "anything"
        return getattr(self.promise, PART_OF.get(needs, ""), None)

    def table(self):
        import pandas

        columns = ["answer", "value", "error", "unit", "share", "promised"]
        rows = [(t.name, t.value, t.error, t.unit, t.share, t.promised) for t in self.told]
        return pandas.DataFrame(rows, columns=columns)

    def attributes(self):
        rows = [f"{told.name}: {told.error:.2g} {told.unit}" for told in self.told]
        return {"numerical errors": "; ".join(rows)}

    def __str__(self) -> str:
        share = lambda each: "–" if each is None else f"{100 * each:.2g} %"
        rows = [HEAD] + [
            (t.name, f"{with_error(t.value, t.error)} {t.unit}", share(t.share), share(t.promised))
            for t in self.told
        ]
        name, number = (max(len(row[k]) for row in rows) for k in (0, 1))
        marks = ("", *(" <" if told.beyond else "" for told in self.told))
        lines = [
            f"{row[0]:{name}}  {row[1]:{number}}  {row[2]:>9}  {row[3]:>8}{mark}"
            for row, mark in zip(rows, marks, strict=True)
        ]
        return "\n".join([*lines, f"Numerical errors are {self._how()}."])


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


def richardson(differences: list[Any]) -> Any:
    """The error that differences from the half, and the quarter, tell of steps of order 1."""
    errors = [d / (1 - share) for d, share in zip(differences, (HALF, QUARTER), strict=False)]
    return functools.reduce(jnp.maximum if is_traced(errors) else np.maximum, errors)


def _told_error(value: Any, *values: Any) -> Any:
    """Of a number, or an array of them. Raises `TypeError` or `ValueError` for what is none, and
    for arrays of another shape."""
    number, *others = (
        each if is_traced(each) else np.asarray(each, float) for each in (value, *values)
    )
    if any(other.shape != number.shape for other in others):
        raise ValueError("arrays of another shape")
    with np.errstate(invalid="ignore"):
        found = richardson([abs(number - other) for other in others])
    return found if is_traced(found) else np.asarray(found)[()]


def told(seen: list[list[Apart]], promise: Promise) -> list[Told]:
    """The standard answers, from how far each is apart from that of every replica."""
    found = []
    for row in zip(*seen, strict=True):
        one = row[0]
        name = f'{one.answer}, "{one.place}"' if one.place else one.answer
        error, share = (
            float(richardson([getattr(each, what) for each in row])) for what in ("off", "share")
        )
        of_promise = getattr(promise, one.part)
        found.append(Told(name, one.part, one.unit, one.value, error, share, of_promise))
    return found
