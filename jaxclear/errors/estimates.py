"""What replicas tell of a run: the errors of its standard answers as a table, of any other response
as an estimate, and the sentences where an error is beyond what the integrator promises.
"""

import functools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxclear.components.surface import AbstractSurface
from jaxclear.errors.observables import label_of, safety_of
from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import is_traced
from jaxclear.ground.table import as_table
from jaxclear.integrators.base import PART_OF, Promise
from jaxclear.integrators.checks import Check
from jaxclear.multibody.system import wearing_in
from jaxclear.native.compiled import compiled_quickly
from jaxclear.results.response import needs_of
from jaxclear.results.trajectory import Trajectory
from jaxclear.results.verification import TABLE_COLUMNS, AbstractVerification, Estimate, Unverified

HALF, QUARTER = 0.5, 0.25
# Roache's factor of an error of an order that is known (`factor_of_cells`).
SAFETY = 1.25
WORDS = {
    "places": "of the longest way",
    "gaps": "of the clearance",
    "mean_force": "of the largest",
    "peak_force": "of the largest",
    "losses": "of the largest",
    "drawn": "of itself",
}


class StandardAnswer(NamedTuple):
    """A standard `answer` of a `part` of the promise at a `place`, its `value` and told `error` in
    its `unit`, the error as the `share` by which it is judged, its `tolerance` share (None:
    any error is right), and whether it is `lost`: no run tells it."""

    answer: str
    part: str
    place: str
    unit: str
    value: float
    error: float
    share: float
    tolerance: float | None
    chaotic: bool

    @property
    def name(self) -> str:
        """The answer with its place."""
        return label_of(self.answer, self.place)

    @property
    def beyond(self) -> bool:
        """Whether the error is beyond what is promised."""
        return self.tolerance is not None and not self.share <= self.tolerance


class Verified(AbstractVerification):
    """A run with `replicas`, as responses see them, the coarser one first; `numbers`: value, error,
    share and what is promised (nan: nothing) of each of the standard `answers` (answer, part,
    place, unit); `promise`: of its integrator, or what was asked; `lost`: which of them hang on the
    tenth digit of the start, and `path`: from when on [s], and within which time errors grow e-fold
    [s] (None: its path is an answer); `since` [s]: where the run began, from where on errors count;
    `remedy`: what makes them smaller; `why`: what the integrator was chosen for ("": it was
    given); `coarser`: the run on worn surfaces with cells twice as wide; `step_ratios`: steps of
    the replicas over the run's."""

    replicas: tuple[Trajectory, ...]
    numbers: Float[np.ndarray, "answers 4"]
    chaotic: Bool[np.ndarray, " answers"]
    path: Float[np.ndarray, "2"] | None
    since: Float[np.ndarray, ""]
    promise: Promise
    answers: tuple[tuple[str, str, str, str], ...] = eqx.field(static=True)
    remedy: str = eqx.field(static=True)
    why: str = eqx.field(static=True, default="")
    coarser: Trajectory | None = None
    step_ratios: tuple[float, ...] = eqx.field(static=True, default=(HALF, QUARTER))

    @property
    def entries(self) -> tuple[StandardAnswer, ...]:
        """The standard answers."""
        rows = zip(self.answers, self.numbers.tolist(), self.chaotic.tolist(), strict=True)
        return tuple(
            StandardAnswer(*names, value, error, share, None if math.isnan(most) else most, chaotic)
            for names, (value, error, share, most), chaotic in rows
        )

    @property
    def beyond(self):
        return frozenset(t.part for t in self.entries if t.beyond)

    @property
    def warnings(self):
        beyond = sorted((t for t in self.entries if t.beyond), key=lambda t: -t.share / t.tolerance)
        answers = [row for row in beyond if not row.chaotic]
        return (self._sentence(answers),) if answers else ()

    @property
    def notes(self):
        if self.path is None:
            return ()
        since, growth = map(float, self.path)
        return (
            f"From {since:.3g} s on the path in the gaps is chaotic (differences grow e-fold in "
            f"{growth:.2g} s): take means over samples.",
        )

    def _sentence(self, beyond: list[StandardAnswer]) -> str:
        """What is off, by how much, and what to do, of the answers that are furthest beyond."""
        worst, others = beyond[0], len(beyond) - 1
        more = f", and {others} more answer{'s' * (others > 1)}" if others else ""
        error = f"{worst.share:.2g} {WORDS[worst.part]} (tolerance {worst.tolerance:g})"
        cells = "; " if self.coarser is None or worst.part != "losses" else "; more cells, or "
        name = f"{worst.name[0].upper()}{worst.name[1:]}"
        # Of a chaotic path smaller steps give another one, whose error is no less.
        chaotic = "the path is chaotic, so take means over samples"
        remedy = self.remedy if self.path is None else chaotic
        return f"{name}: error about {error}{more}{cells}{remedy}."

    def estimate(self, run, response):
        value = response(run)
        try:
            values = [response(each) for each in self.replicas]
            coarse = value if self.coarser is None else response(self.coarser)
        except Exception as failure:
            # What is found in a run need not be in its replica: a tenth impact, a row of a table.
            return Estimate(value, math.nan, f"in finer steps the same fails: {failure}")
        try:
            share = max(factors_of_cells(run).values(), default=1.0)
            factors = self.step_ratios, share, safety_of(run, response)
            estimate = lambda *each: _estimate_error(*each, *factors)
            error = jax.tree.map(estimate, value, coarse, *values)
        except (TypeError, ValueError):
            return Estimate(value, math.nan, "the answer is no number, or of another form there")
        if not jax.tree.leaves(error):
            return Estimate(value, math.nan, "the answer is no number")
        if not all(is_traced(e) or np.all(np.isfinite(e)) for e in jax.tree.leaves(error)):
            return Estimate(value, error, "the answer is not finite, there or in finer steps")
        safe = safety_of(run, response) > 1
        return Estimate(value, error, self._how_estimated("three times" if safe else "twice"))

    def _how_estimated(self, times: str = "twice") -> str:
        more = {QUARTER: "half and quarter steps", HALF: "half the step, from two starts"}
        steps = "half the step" if len(self.replicas) == 1 else more[self.step_ratios[-1]]
        began = not is_traced(self.since) and self.since != 0
        since = f", since {float(self.since):.6g} s" if began else ""
        if self.coarser is not None:
            return f"the change with {steps} and with wider cells{since}"
        return f"{times} the change with {steps}{since}"

    def tolerance(self, response: Any) -> float | None:
        """The share that is promised of a response; None for nothing."""
        return getattr(self.promise, PART_OF.get(needs_of(response), ""), None)

    def table(self):
        fields = ("name", "value", "error", "unit", "share", "tolerance")
        rows = [[getattr(t, field) for field in fields] for t in self.entries]
        return as_table(rows, columns=TABLE_COLUMNS, errors={"value": "error"})

    def attributes(self):
        rows = [f"{t.name}: {t.error:.2g} {t.unit}" for t in self.entries]
        return {"numerical errors": "; ".join(rows)}

    def _summary(self):
        exceeded = lambda t: "exceeded" if t.beyond else ""
        # An error as large as the gap leaves open where in it a part is.
        unknown = lambda t: "anywhere in the gap" if t.part == "gaps" and t.share >= 1 else ""
        of = lambda t: "chaotic" if t.chaotic else unknown(t) or exceeded(t)
        table = self.table().drop(columns=["relative error", "tolerance"])
        for head in ("relative error", "tolerance"):
            parts = [100 * part for part in self.table()[head]]
            table[f"{head} [%]"] = [float(f"{part:.2g}") for part in parts]
        marks = [of(t) for t in self.entries]
        table = table.assign(remark=marks) if any(marks) else table
        how = f"Error estimate: {self._how_estimated()}. {self.why}".rstrip()
        if self.coarser is None and any(t.answer == "worn depth" for t in self.entries):
            how += "\nThat of worn depths is three times the change."
        if any(t.part == "gaps" for t in self.entries):
            how += "\nValues of places: of bodies the largest displacement, in a gap the clearance."
        peaks = {t.place: t.value for t in self.entries if t.part == "peak_force"}
        means = [t for t in self.entries if t.part == "mean_force"]
        if any(t.value > peaks.get(t.place, np.inf) for t in means):
            how += "\nMean contact forces are sums over a joint's contacts, peaks are of one."
        return table, how


class Failed(AbstractVerification):
    """Of a run whose replica ended early; `result` says why."""

    result: str = eqx.field(static=True)

    def _summary(self):
        return self.warnings[0]

    @property
    def warnings(self):
        return (f"With shorter steps the same run fails, so its numbers may be off: {self.result}",)

    @property
    def notes(self):
        return ()

    @property
    def beyond(self):
        return frozenset(Promise._fields)

    def estimate(self, run, response):
        return Estimate(response(run), math.nan, self.warnings[0])

    def table(self):
        return Unverified().table()

    def attributes(self):
        return {"verification": str(self)}


def richardson(differences: list[Any], shares: Sequence[float | None] = (HALF, QUARTER)) -> Any:
    """The error that differences from finer steps of these shares (None: the half, and the
    quarter) tell of steps of order 1."""
    rows = zip(differences, shares, (HALF, QUARTER), strict=False)
    errors = [d / (1 - (usual if share is None else share)) for d, share, usual in rows]
    return functools.reduce(jnp.maximum if is_traced(errors) else np.maximum, errors)


def factors_of_cells(run: Trajectory) -> dict[str, Any]:
    """The error that cells leave in the depth of each worn surface ("joint, surface"), relative to
    what cells twice as wide change (`factor_of_cells`)."""
    factors = {f"{joint}, {surface}": 1.0 for joint, ks in run.worn.items() for surface in ks}
    if not factors or is_traced((run.states, run.worn, run.invariants)):
        return factors
    return factors | {place: float(x) for place, x in _cell_factors(run).items()}


@compiled_quickly
def _cell_factors(run: Trajectory) -> dict[str, Any]:
    factors: dict[str, Any] = {}
    wearing, figures = wearing_in(run.mechanism), run.invariants.figures
    narrow = jnp.max(figures[Check.WEAR_BY_CELLS].worst) if Check.WEAR_BY_CELLS in figures else 0.0
    for slot in run.history.layout().wear:
        surface = wearing[slot.bearing].maps()[slot.surface][0]
        volume, features = slot.loss(run.states[0], run.states[-1])
        if isinstance(surface, AbstractSurface):
            place, depth = f"{slot.bearing}, {slot.surface}", run.worn[slot.bearing][slot.surface]
            before, factor = (
                factors.get(place, 1.0),
                factor_of_cells(surface, features, depth, narrow),
            )
            larger = jnp.maximum(before, factor) if slot.contact else factor
            factors[place] = jnp.where(volume > 0, larger, before)
    return factors


def factor_of_cells(surface: AbstractSurface, features: Any, depth: Any, narrow: Any) -> Any:
    """Error that cells leave in a worn depth, over the change when cells are twice as wide.

    It is that of order 2; of a narrow scar that of order 1. A contact narrower than its cells has
    been widened to them, and depths go with one over each of its widths, of which fourth powers add
    up. All with Roache's factor of safety where the order is that of a law, 1.25. Scars of flat
    faces have edges anywhere in a cell, so two resolutions agree by chance: there 3 on order 1.

    Args:
        surface: with its cells.
        features: means of what wore the surface, such as the direction.
        depth: worn depth of each cell [m].
        narrow: how narrow the scar is (`Check.WEAR_BY_CELLS`).

    Source: Roache 1997, Annu. Rev. Fluid Mech. 29, 123, doi:10.1146/annurev.fluid.29.1.123.
    """
    sizes = surface.cells_per_contact(features, surface.deepest(depth))
    by_cells, by_wider = (
        math.prod((1.0 + (factor * x) ** 4) ** -0.25 for x in sizes) for factor in (1, 2)
    )
    change = by_cells - by_wider
    widened = jnp.where(change > 0, safe_divide(1.0 - by_cells, change), 0.0)
    return jnp.maximum(factor_by_order(surface.flat, narrow), SAFETY * widened)


def factor_by_order(flat: bool, narrow: Any) -> Any:
    """That factor of cells that no contact is narrower than (`factor_of_cells`)."""
    resolved = jnp.where(narrow <= Check.WEAR_BY_CELLS.limit, 1 / 3, 1.0)
    return 3.0 if flat else SAFETY * resolved


def _estimate_error(value: Any, coarse: Any, *rest: Any) -> Any:
    """Of a number, or an array of them, from one on `coarse` cells, others in finer steps, the
    ratios of these steps, the share of what cells change and the factor of what steps change.
    Raises `TypeError` or `ValueError` for what is none, and for arrays of another shape."""
    *values, ratios, share, safety = rest
    number, coarse, *others = (
        each if is_traced(each) else np.asarray(each, float) for each in (value, coarse, *values)
    )
    if any(other.shape != number.shape for other in (coarse, *others)):
        raise ValueError("arrays of another shape")
    with np.errstate(invalid="ignore"):
        by_steps = richardson([abs(number - other) for other in others], ratios)
        error = safety * by_steps + share * abs(number - coarse)
    return error if is_traced(error) else np.asarray(error)[()]
