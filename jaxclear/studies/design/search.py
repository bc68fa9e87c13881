"""From a question to a design that keeps its limits: fit, optimise, verify, tighten.

Each round takes the cheapest candidate on a surface over a region, and verifies it by new runs,
which join the surface of the next round. That is moved over the candidate, and shifted to what the
runs said there. A region covers half as much where the surface was wrong of a limit that decides. A
round is the last where the surface was right, every limit is kept, and no end of the region holds
the candidate. The design is the cheapest of all that runs saw to keep the limits.

Source: Conn, Gould & Toint 2000, Trust-Region Methods, chapter 6, doi:10.1137/1.9780898719857;
surfaces that agree with runs at the candidate: Alexandrov, Dennis, Lewis & Torczon 1998, Struct.
Optim. 15, 16, doi:10.1007/BF01197433.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy

from jaxclear.ground.arguments import check_count
from jaxclear.ground.quantity import AbstractQuantified, Scalar, count, quantity
from jaxclear.studies.design.discrete import chosen
from jaxclear.studies.design.lagrangian import cheapest_by_steps
from jaxclear.studies.design.optimise import ACTIVE, Candidate, Search, cheapest
from jaxclear.studies.design.population import (
    AbstractModel,
    Direct,
    Points,
    points,
    surface_through,
)
from jaxclear.studies.design.question import Question, sizes_of
from jaxclear.studies.design.runs import Runs
from jaxclear.studies.design.verification import Check, Verifier
from jaxclear.studies.scrambling import scrambled_shares

# Starts of the first search, and least runs for each term of a quadratic surface.
STARTS, RUNS_PER_TERM = 3, 2
# A problem that answers at once is asked at so many times the points. Verifications are repeated
# with so many times the runs, up to so often, while they are less sure than is asked.
MORE, TIMES, MOST_TIMES = 4, 1, 2
# Shares above this are seen often enough without.
OFTEN = 0.02
FIXED_POINTS = 12
# Points closer than this share of their distance are one.
ONE = 0.3
# More free numbers than this go by steps of optax (augmented Lagrangian) and not by SLSQP.
TENS = 40


class DesignSettings(AbstractQuantified):
    """Settings of the search for a design.

    Args:
        allowed_excess: excess over a limit that is accepted, as a share of its size [1], > 0 and <
            1; 0.005 by default.
        samples: number of points at which a surface, or a problem whose own slopes are
            searched, is evaluated, >= 64; 2048 by default.
        check: number of runs of a verification, >= 16; 128 by default.
        runs: number of runs of a surface; None (default) for two for each term of a quadratic, at
            least 64.
        rounds: largest number of verifications; 6 by default.
        seed: seed of the random numbers; 0 by default.
        surface: whether a response surface stands in for the problem; None (default): unless it is
            a `FunctionProblem`, whose own slopes are searched where it has them.

    Raises:
        ValueError: if a number is out of range.
    """

    allowed_excess: Scalar = quantity(5e-3, "1", above=0, below=1)
    samples: int = count(2048, at_least=64)
    check: int = count(128, at_least=16)
    runs: int | None = eqx.field(static=True, default=None)
    rounds: int = count(6)
    seed: int = count(0, at_least=0)
    surface: bool | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        if self.runs is not None:
            check_count("runs of DesignSettings", self.runs)


class Round(NamedTuple):
    """What a round found: the candidate, its check, R2 of the surface by response (none where the
    problem answers itself), runs so far, the size of the region that the surface covers [1], and
    whether an end of it, not of what may be chosen, holds the candidate."""

    candidate: Candidate
    check: Check | None
    quality: dict[str, float]
    runs: int
    region: float
    confined: bool


class Sought(NamedTuple):
    """All rounds, which of them is the answer, the question with the sizes of its limits, why the
    search ended, what answered in that round and at which points."""

    rounds: list[Round]
    best: int
    question: Question
    ended: str
    model: AbstractModel
    points: Points


def sought(question: Question, runs: Runs, settings: DesignSettings, direct: bool) -> Sought:
    """The rounds of a design; an interrupt ends it with the rounds so far.

    Args:
        question: cost and limits.
        runs: counts and stores the problem's runs.
        settings: of the search.
        direct: whether the problem itself is optimised, without a surface.
    """
    seeking = _Seeking(question, runs, settings, direct)
    try:
        seeking.go()
    except KeyboardInterrupt:
        if not seeking.rounds:
            raise
        seeking.ended = "interrupted"
    best = seeking.find_best()
    return Sought(seeking.rounds, best, seeking.question, seeking.ended, *seeking.models[best])


class _Seeking:
    """The state of a search: the place reached and what runs said there, the surface's region."""

    def __init__(self, question: Question, runs: Runs, settings: DesignSettings, direct: bool):
        self.question, self.runs, self.settings, self.direct = question, runs, settings, direct
        freedom = question.freedom
        self.place = freedom.encoded(freedom.start, freedom.usual)
        # Excesses (limits,) that runs found at this place; none yet.
        self.verified: np.ndarray | None = None
        self.region, self.ended = 1.0, "rounds"
        self.rounds: list[Round] = []
        # What answered in each round, and at which points.
        self.models: list[tuple[AbstractModel, Points]] = []
        # Until there is a surface, and points for it.
        self.model: AbstractModel = Direct(runs.problem)
        self.points = points(len(freedom.names), 1, settings.seed)
        self.quality: dict[str, float] = {}
        self.drawn_about: tuple[np.ndarray, ...] = ()

    def go(self) -> None:
        """Round after round."""
        allowed = self.settings.allowed_excess
        for number in range(self.settings.rounds):
            if not self.direct:
                self._fit_surface(number)
            candidate, confined = self._find_candidate(number)
            self.models.append((self.model, self.points))
            # Kept before it is verified: an interrupt may come in between.
            self.rounds.append(self._make_round(candidate, None, confined))
            check = self._check_candidate(number, candidate)
            self.rounds[-1] = self._make_round(candidate, check, confined)
            # What is not known as well as is asked is to keep its limit by its error, too.
            unsure = np.where(check.excess_errors > allowed, check.excess_errors, 0.0)
            self.place, self.verified = candidate.place, check.excess + unsure
            wrong = self._is_wrong(candidate, check)
            if self._is_kept(check) and not wrong and not confined:
                self.ended = "holds"
                return
            broken = candidate.broken > allowed and not confined
            infeasible = broken and bool(np.any(~(check.excess <= allowed)))
            self.ended = "infeasible" if infeasible else "rounds"
            if infeasible and self.direct:
                return
            if wrong and not self.direct:
                self.region *= 0.5

    def find_best(self) -> int:
        """The number of the cheapest round that keeps the limits; where none does, of the one that
        breaks them least, or of the first if no run has looked at it."""
        checks = [one.check for one in self.rounds]
        kept = [k for k, check in enumerate(checks) if check is not None and self._is_kept(check)]
        if kept:
            self.ended = "rounds" if self.ended == "infeasible" else self.ended
            return min(kept, key=lambda k: self.rounds[k].candidate.cost)
        excess = [np.inf if check is None else check.excess.max() for check in checks]
        return int(np.argmin(np.nan_to_num(excess, nan=np.inf)))

    def _make_round(self, candidate: Candidate, check: Check | None, confined: bool) -> Round:
        return Round(candidate, check, self.quality, self.runs.count, self.region, confined)

    def _is_kept(self, check: Check) -> bool:
        """Whether runs keep every limit, and so few fail that those that do not stand for the
        parts."""
        kept = check.holds(self.settings.allowed_excess)
        return bool(np.all(kept)) and not check.too_many_failed(self.question)

    def _is_wrong(self, candidate: Candidate, check: Check) -> bool:
        """Whether what the candidate was chosen by misses a limit that decides by more than what is
        accepted and the error; of choices from a catalogue any may decide."""
        sure = self.settings.allowed_excess + check.excess_errors
        assert self.verified is not None
        miss = np.abs(self.verified - candidate.excess)
        decides = ~(np.maximum(self.verified, candidate.excess) < -sure)
        decides |= any(choice.offered for choice in self.question.freedom.choices)
        return bool(np.any(~(miss <= sure) & decides))

    def _ends_of_region(self) -> tuple[np.ndarray, np.ndarray]:
        """The places that the region holds: a box about the last candidate."""
        low = np.clip(self.place - 0.5 * self.region, 0.0, 1.0 - self.region)
        return low, np.clip(low + self.region, 0.0, 1.0)

    def _fit_surface(self, number: int) -> None:
        """A surface over the region, from the runs that lie in it and as many new ones as it
        wants."""
        low, high = self._ends_of_region()
        box = self._values_of_region(low, high)
        inside = lambda values: np.all((values >= box[0]) & (values <= box[1]), axis=1)
        variables = len(self.question.freedom.names)
        terms = (variables + 1) * (variables + 2) // 2
        run_count = self.settings.runs or max(RUNS_PER_TERM * terms, 64)
        missing = run_count - int(self.runs.good(inside).sum())
        if missing > 0 or number == 0:
            self.runs.ask(self._draw_parts(low, high, max(missing, 1), number), "surface")
        inner_runs = self.runs.within(inside, self.question.levels)
        self.model, self.quality = surface_through(self.runs.problem, *inner_runs)

    def _draw_parts(self, low: np.ndarray, high: np.ndarray, count: int, number: int) -> np.ndarray:
        """Parts of designs that fill the region, (count, variables)."""
        size, variables = len(low), len(self.question.freedom.names)
        rng = np.random.default_rng([self.settings.seed, number])
        share = scrambled_shares(count, size + variables, rng)
        places = low + share[:, :size] * (high - low)
        # Evenly between three standard deviations: a surface wants its edges.
        normal = 3.0 * (2.0 * share[:, size:] - 1.0)
        return np.asarray(self.question.one_each(jnp.asarray(places), jnp.asarray(normal)))

    def _values_of_region(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest values (variables,) of parts of designs in the region."""
        size = len(self.question.freedom.names)
        far = np.concatenate([-3.5 * np.ones((1, size)), 3.5 * np.ones((1, size))])
        ends = [np.asarray(self.question.values(jnp.asarray(place), far)) for place in (low, high)]
        return np.minimum(*(e.min(axis=0) for e in ends)), np.maximum(
            *(e.max(axis=0) for e in ends)
        )

    def _find_candidate(self, number: int) -> tuple[Candidate, bool]:
        """The cheapest of the region, on the catalogues where there are some; and whether to go on
        beyond an end of the region may save more than is accepted, as a share of the cost."""
        low, high = self._ends_of_region()
        starts = [self.place]
        if number == 0:
            rng = np.random.default_rng(self.settings.seed)
            starts += list(rng.random((STARTS - 1, len(low))))
            self._draw_population(self.place)
            sizes = sizes_of(self.question, self.place, self.model, self.points)
            self.question = self.question.measured_by(sizes)
        best = self._best(starts, self._draw_population(self.place), low, high)
        if self.drawn_about:
            # Where rare parts lie depends on the design: once more, about those of this one.
            best = self._best([best.place], self._draw_population(best.place), low, high)
        ends = (best.place < low + ACTIVE) & (low > 0.0) | (best.place > high - ACTIVE) & (high < 1)
        saved = 0.5 * self.region * np.abs(best.slope[ends]).sum()
        return best, bool(saved > self.settings.allowed_excess * abs(best.cost))

    def _draw_population(self, place: np.ndarray) -> Points:
        """The points of the population, about the rare parts that decide at a place."""
        settings, count = self.settings, len(self.question.freedom.names)
        self.drawn_about = rare_regions(self.question, place, self.model)
        samples = settings.samples * (MORE if self.direct else 1)
        self.points = points(count, samples, settings.seed, self.drawn_about, matched=True)
        return self.points

    def _best(self, starts: list, drawn: Points, low: np.ndarray, high: np.ndarray) -> Candidate:
        search = Search(
            self.question, self.model, drawn, np.zeros(len(self.question.limits)), low, high
        )
        if self.verified is not None:
            # The surface says at the last candidate what runs say.
            shift = self.verified - search.evaluate(self.place)[0][1:]
            search = search._replace(shift=np.where(np.isfinite(shift), shift, 0.0))
        if len(low) > TENS:
            return chosen(search, cheapest_by_steps(search, starts[0]))
        return chosen(search, cheapest(search, starts))

    def _check_candidate(self, number: int, candidate: Candidate) -> Check:
        """The candidate by new runs; by more where they are less sure than is asked."""
        shifts = rare_regions(self.question, candidate.place, self.model)
        wide = MORE * self.settings.samples
        verifier = Verifier(self.question, self.runs, 0 if self.direct else wide)
        samples = wide if self.direct else self.settings.check
        times = MOST_TIMES if self.direct else TIMES
        for again in range(times + 1):
            # Seeds apart from those of surfaces and of the search.
            seed = 1000 * (self.settings.seed + 1) + (times + 1) * number + again
            check = verifier.check(candidate.place, self.model, samples, seed, shifts)
            if not check.excess_errors.max() > self.settings.allowed_excess:
                return check
            samples *= MORE
        return check


def rare_regions(
    question: Question, place: np.ndarray, model: AbstractModel
) -> tuple[np.ndarray, ...]:
    """Centres (variables,) of the rare regions that decide limits; none where nothing rare does.

    Args:
        question: with the limits.
        place: the candidate, shape (free,).
        model: responses of its parts.
    """
    regions: list[np.ndarray] = []
    for number, limit in enumerate(question.limits):
        share = limit.rarest()
        if share >= OFTEN:
            continue
        distance = float(-scipy.special.ndtri(share))
        for side in range(len(limit.sides(jnp.zeros(())))):
            centre = np.asarray(
                _worst(question, (number, side), model, jnp.asarray(place), jnp.asarray(distance))
            )
            new = all(np.linalg.norm(centre - c) > ONE * distance for c in regions)
            if new and np.all(np.isfinite(centre)):
                regions.append(centre)
    return tuple(regions)


@eqx.filter_jit
def _worst(
    question: Question,
    which: tuple[int, int],
    model: AbstractModel,
    place: Any,
    distance: float | Any,
) -> Any:
    """The point at this distance where a limit (its number and side) is nearest to breaking."""
    limit = question.limits[which[0]]

    def bad(normal):
        return limit.sides(question.one(limit, question.values(place, normal), model))[which[1]]

    def outward(slope):
        length = jnp.linalg.norm(slope)
        return distance * slope / jnp.where(length > 0, length, 1.0)

    slope = jax.jacfwd(bad)
    start = outward(slope(jnp.zeros(len(question.freedom.names))))
    return jax.lax.fori_loop(0, FIXED_POINTS, lambda i, point: outward(slope(point)), start)
