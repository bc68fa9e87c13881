"""How a run can end, or fail to begin, and what it finds out about itself that no finer run of the
same model would tell: loops that are open, energy that nothing gave, contacts beyond their law, and
what the model leaves out. How far its numbers are off is told by replicas (`jaxclear.errors`).

A figure is a number for each place (a joint, or the mechanism), the worst that was met, beside the
limit up to which numbers can be trusted. A run that lacks the thing has none and pays nothing.
Beyond `Check.ends_at` a run ends.
"""

import enum
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxclear.ground.module import AbstractModule
from jaxclear.ground.outcome import AbstractOutcome
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.quantity import constant, is_traced, on_numbers
from jaxclear.ground.table import as_table


class Outcome(AbstractOutcome):
    """How a run ended. `Outcome(code).sentence` says it; only `REACHED` (0) is a success.

    `UNASSEMBLED`, `OUT_OF_RANGE` and `OTHER_MODE` are those of samples of a study, whose numbers do
    not make a mechanism, or not the nominal one.
    """

    REACHED = 0, "The run reached its end."
    STEP_TOO_SMALL = (
        1,
        "The step size fell below the smallest allowed: the equations are too stiff or not finite "
        "here.",
    )
    TOO_MANY_STEPS = 2, "The allowed number of steps between two saved times was used up."
    NOT_FINITE = 3, "The state grew without bound, or became no number."
    ENERGY_GAINED = (
        4,
        "The mechanism gained energy that nothing gave it: the steps are too long for its contacts "
        "or loads. Take shorter ones.",
    )
    LAWS_NOT_SATISFIED = (
        5,
        "The laws of contact or friction were not met: the sweeps over the joints were used up far "
        "from their solution. Allow more of them (max_sweeps); joints that lock themselves "
        "may have no solution there.",
    )
    UNASSEMBLED = (
        6,
        "The mechanism cannot be assembled: no start was found that closes its loops and is what "
        "start= and speeds= give.",
    )
    OUT_OF_RANGE = (
        7,
        "A number of the mechanism lies outside its range (a negative clearance, say).",
    )
    LOOP_OPEN = (
        8,
        "A loop came open by more than a run can mend: the steps are too long for this motion. "
        "Take shorter ones, or stabilisation=jaxclear.Projection().",
    )
    DEAD_POINT = (
        9,
        "A drive leads a closed loop beyond a dead point: from here no position closes the loop. "
        "Drive another joint, or keep the drive within reach.",
    )

    PENETRATION_EXCEEDED = (
        10,
        "A journal, ball or slider sank into the wall that holds it by more than its own radius: "
        "for these loads and speeds the contact is too soft, or the steps are too long. Look at "
        "stiffness, loads and start, or take shorter steps.",
    )

    SINGULAR_POSITION = (
        11,
        "The mechanism is at a singular position, a linkage stretched flat, say: its loops leave "
        "more than one way to go on there, and their reactions are not determined. Change a "
        "length a little, keep the motion away from it, or take integrator.Adaptive() or shorter "
        "steps, which pass such places more often.",
    )

    GUIDE_RANGE_EXCEEDED = (
        12,
        "A slider left the walls of its guide that wear: its corners went beyond "
        "guide_length about guide_middle. Give the SliderGuide longer walls, or another middle.",
    )

    OTHER_MODE = (
        13,
        "The mechanism was assembled in another mode than the nominal one: a position in which two "
        "of its ways to assemble meet lies between the two. Vary its numbers less, or give start= "
        "or guess= for more joints.",
    )

    @property
    def began(self) -> bool:
        """Whether there was a run at all."""
        return self not in (Outcome.UNASSEMBLED, Outcome.OUT_OF_RANGE, Outcome.OTHER_MODE)


NEVER = (np.inf, Outcome.REACHED)
# What a figure is told for.
LOOPS, CONTACTS, SURFACES, MECHANISM = "loops", "contacts", "surfaces", "mechanism"
LOADS, RUBBING, COLLARS = "loads and drives", "joints that rub", "collars"
TOUCHING = "joints that always touch"
IN_GAPS = "joints that always touch in a gap"
UNHELD = "joints that always touch and that nothing holds along their axis"
SLIDING = "journals that nothing holds along their axis"


class AbstractCheck(enum.IntEnum):
    """A figure by which a run is judged: its `label` in tables, `unit`, `limit`, what the limit
    `concerns` (motion, places, forces, peak forces, wear, worn depth, places in gaps), whose it is
    (`of`), and the `sentence` said beyond the limit. Beyond `ends_at` the run ends, by `outcome`.
    """

    label: str
    unit: str
    limit: float
    concerns: str
    of: str
    sentence: str
    ends_at: float
    outcome: Outcome

    def __new__(cls, code, label, limit, concerns, of, sentence, ends=NEVER, unit="1"):
        member = int.__new__(cls, code)
        member._value_ = code
        member.label, member.unit, member.limit = label, unit, limit
        member.concerns, member.of, member.sentence = concerns, of, sentence
        member.ends_at, member.outcome = ends
        return member


@enum.unique
class Check(AbstractCheck):
    """The figures of all runs, each beside its limit. The codes 1 to 6, 9 to 20 and 22 to 24 were
    those of earlier versions, and are not used again."""

    # Residual of a loop's closure beside its own shortest part, at the saving times.
    LOOP_DRIFT = (
        0,
        "loop drift",
        1e-3,
        "motion",
        LOOPS,
        'the loop closed by joint "{place}" is open by {figure:.2g} of its shortest part (limit '
        "{limit:g}): take shorter steps or stabilisation=jaxclear.Projection()",
        (3e-2, Outcome.LOOP_OPEN),
    )
    # The same beside the smallest clearance: where journals are is off by as much.
    LOOP_DRIFT_IN_GAPS = (
        32,
        "loop drift beside clearances",
        0.03,
        "places in gaps",
        LOOPS,
        'the loop closed by joint "{place}" is open by {figure:.2g} of the smallest clearance '
        "(limit {limit:g}): take shorter steps or stabilisation=jaxclear.Projection()",
    )
    # Of what nothing drives or pushes: energy above that of the start, beside all it had to change.
    ENERGY_GAIN = (
        8,
        "energy gained",
        0.05,
        "motion",
        MECHANISM,
        "the mechanism gained {figure:.2g} of its energy (limit {limit:g}) though nothing gave it "
        "any: take shorter steps",
        (0.9, Outcome.ENERGY_GAINED),
    )
    INDENTATION = (
        7,
        "indentation",
        0.05,
        "forces",
        CONTACTS,
        'the indentation in joint "{place}" reaches {figure:.2g} of its radius (limit {limit:g}), '
        "for which no contact law was made: look at stiffness, loads and start",
        (1.0, Outcome.PENETRATION_EXCEEDED),
    )
    # Of steps that solve for percussions or friction: the largest of all steps, relative to the
    # largest velocity of the contacts, or to the bound of the friction. A millionth is far above
    # what solvers end at, and below the error of any step.
    LAW_RESIDUAL = (
        33,
        "residual of contact laws",
        1e-6,
        "motion",
        MECHANISM,
        "steps missed the laws of contact and friction by up to {figure:.2g} (limit {limit:g}): "
        "their search ended before its tolerance; take shorter steps, or more max_sweeps",
    )
    LOAD_STEP = (
        21,
        "load step",
        0.005,
        "motion",
        LOADS,
        'steps pass over {figure:.2g} of the impulse of "{place}" (limit {limit:g}), which changes '
        "within less than a step: take shorter steps",
    )
    WEAR_BY_CELLS = (
        31,
        "cells: worn depth",
        0.15,
        "worn depth",
        SURFACES,
        'the deepest scar of joint "{place}" is hardly wider than a cell, its depth underestimated '
        "({figure:.2g}, limit {limit:g}): give its Wearing more cells, or take shorter steps where "
        "one moves a contact by more than a cell",
    )
    WEAR_AT_SAVES = (
        34,
        "path between updates of wear",
        1.0,
        "worn depth",
        SURFACES,
        'contacts of joint "{place}" move by {figure:.2g} cells in the mean (limit {limit:g}) from '
        "one saving time to the next, and a run whose steps are counted wears at these alone: save "
        "more often",
    )
    # What the model leaves out.
    BOTH_WORN = (
        35,
        "wear of both parts",
        0.05,
        "worn depth",
        SURFACES,
        'both parts of joint "{place}" wear at one place, and each faces the other worn evenly: '
        "its scar is too narrow, and up to {figure:.2g} of its depth too deep (limit {limit:g}); "
        "let one part wear by the coefficients of both",
    )
    COULOMB_FRICTION = (
        25,
        "friction as Coulomb's",
        0.025,
        "wear",
        RUBBING,
        'friction in joint "{place}" is taken as Coulomb\'s; by its own law {figure:.2g} of its '
        "loss is another (limit {limit:g}): take integrator.ImplicitStep",
    )
    COLLAR_FORCE = (
        26,
        "force on collars",
        0.05,
        "forces",
        COLLARS,
        'collars of joint "{place}" carry {figure:.2g} of its forces (limit {limit:g}), which here '
        "rub and wear nothing: take integrator.ImplicitStep",
    )
    UNHELD_FORCE = (
        29,
        "force along an unheld axis",
        0.05,
        "motion",
        UNHELD,
        'along the axis of joint "{place}", where nothing but this model holds its journal, acts '
        "{figure:.2g} of its forces (limit {limit:g}): give it a flange",
    )
    JOURNAL_REACH = (
        30,
        "journal beyond its bearing",
        0.05,
        "motion",
        SLIDING,
        'the journal of joint "{place}" slides out of {figure:.2g} of its bearing\'s length (limit '
        "{limit:g}): give it a flange, or its journal_length",
    )
    INDETERMINATE_FORCE = (
        27,
        "statically indeterminate force",
        0.05,
        "forces",
        TOUCHING,
        'statics leaves {figure:.2g} of the force in joint "{place}" open (limit {limit:g}): give '
        "a joint of its loop more freedom, or clearance on integrator.ImplicitStep",
    )
    GAP_MOTION = (
        28,
        "motion in the gap",
        0.1,
        "forces",
        IN_GAPS,
        'to follow its force through the gap of joint "{place}" would take {figure:.2g} of it '
        "(limit {limit:g}): take integrator.ImplicitStep",
    )


# So large a figure is that of a run which grew without bound.
RAN_AWAY = 1e6


class Figure(AbstractModule):
    """The worst of a figure at each of its `places`, and at what `time` [s] its saving interval
    ended."""

    worst: Float[Array, "*batch places"]
    time: Float[Array, "*batch places"]
    places: tuple[str, ...] = eqx.field(static=True)


class Checks(AbstractShown):
    """The figures by which a run is judged. `print` shows them as a table; `warnings` are the
    sentences of those beyond their limits. After `jax.vmap` every array has the samples in front:
    `beyond` stays an array, the rest is for one run.

    Of all figures together it holds the `worst` and the `time` [s]: a short run would pay for every
    array that it hands over. `named`: the checks in order, each with the names of its places.
    """

    worst: Float[Array, "*batch all_places"] = eqx.field(default_factory=lambda: np.zeros(0))
    time: Float[Array, "*batch all_places"] = eqx.field(default_factory=lambda: np.zeros(0))
    named: tuple[tuple[Check, tuple[str, ...]], ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        columns = self.worst.shape[-1], self.time.shape[-1]
        named = sum(len(places) for _, places in self.named)
        if columns != (named, named):
            raise ValueError(
                f"Checks has {columns[0]} figures and {columns[1]} times for {named} named places; "
                "it must have one of each for every place, in the same order."
            )

    @classmethod
    def of(cls, figures: Mapping[Check, Figure]) -> "Checks":
        """Of each figure by its check."""
        if not figures:
            return cls()
        together = jnp if is_traced(figures) else np
        rows = zip(*((figure.worst, figure.time) for figure in figures.values()), strict=True)
        worst, time = (together.concatenate(row, axis=-1) for row in rows)
        return cls(worst, time, tuple((check, figure.places) for check, figure in figures.items()))

    @property
    def figures(self) -> dict[Check, Figure]:
        """Each figure by its check."""
        figures, start = {}, 0
        worst: Any = self.worst
        time: Any = self.time
        # JAX takes long to give a part of an array, NumPy does not.
        if not is_traced((worst, time)):
            worst, time = np.asarray(worst), np.asarray(time)
        for check, places in self.named:
            span = slice(start, start + len(places))
            figures[check] = Figure(worst[..., span], time[..., span], places)
            start = span.stop
        return figures

    def beyond(self) -> dict[Check, Bool[Array, "*batch"]]:
        """For each figure whether it is beyond its limit anywhere; samples stay in front."""
        return {
            check: (figure.worst > check.limit).any(axis=-1)
            for check, figure in self.figures.items()
        }

    def of_sample(self, index: int) -> "Checks":
        """The figures of one sample of many."""
        return jax.tree.map(lambda array: array[index], self)

    def attributes(self) -> dict[str, str]:
        """Each figure of one run beside its limit, by name, as text that goes with saved data."""
        return {
            f"check_{check.name.lower()}": f"{worst:.6g} (limit {check.limit:g})"
            + (f", joint {place}" if place else "")
            for check, worst, place, _ in self.rows()
        }

    @on_numbers
    def rows(self) -> list[tuple[Check, float, str, float]]:
        """(check, worst figure, its place, when [s]) of each figure of one run."""
        out = []
        for check, figure in constant(self).figures.items():
            worst = np.asarray(figure.worst)
            at = int(np.argmax(worst))
            out.append((check, float(worst[at]), figure.places[at], float(figure.time[at])))
        return out

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each figure beyond its limit; empty for a clean run."""
        return tuple(_sentence(*row) for row in self._exceeded())

    @property
    def before_the_end(self) -> tuple[str, ...]:
        """The warnings of a run that ended early but for those of figures that grew without bound
        with it: what was beyond its limit before may tell why."""
        return tuple(_sentence(*row) for row in self._exceeded() if row[1] < RAN_AWAY)

    def _exceeded(self) -> list[tuple[Check, float, str]]:
        """(check, worst figure, its place) of those beyond their limits."""
        return [row[:3] for row in self.rows() if row[1] > row[0].limit]

    def table(self) -> Any:
        """A pandas table: figure, unit, limit, where and when [s] the worst was met, what it
        concerns, whether it is within its limit."""
        return as_table(
            [
                {
                    "check": check.label,
                    "figure": worst,
                    "limit": check.limit,
                    "unit": check.unit,
                    "joint": place or "-",
                    "time [s]": time,
                    "concerns": check.concerns,
                    "within": worst <= check.limit,
                }
                for check, worst, place, time in self.rows()
            ]
        )

    def _summary(self):
        if not self.named:
            return "This run had nothing to check."
        if is_traced(constant(self)):
            return "the checks of traced runs"
        return (self.table().drop(columns="time [s]"),)


def _sentence(check: Check, worst: float, place: str) -> str:
    text = check.sentence.format(figure=worst, place=place, limit=check.limit)
    return f"{text[0].upper()}{text[1:]}."
