"""Subset simulation: a rare failing as a chain of frequent ones, whatever its shape.

Samples that are worst so far are seeds of chains that stay at least as bad; each level takes a
tenth. Where samples tie, a level takes the nearest share that parts them, and its seeds are drawn
from all that it takes; where nothing parts them, those that fail are counted. Independent
repetitions side by side tell the error, which single ones underestimate. A small one tells
beforehand, by some two thousand runs, whether anything that fails is within reach, and where the
limit of runs is tight how many levels there are, hence how large they may be.

Source: Au & Beck 2001, Probab. Eng. Mech. 16, 263, doi:10.1016/S0266-8920(01)00019-4;
Papaioannou, Betz, Zwirglmaier & Straub 2015, Probab. Eng. Mech. 41, 89,
doi:10.1016/j.probengmech.2015.06.006 (adaptive conditional sampling).
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxclear.ground.printing import in_digits
from jaxclear.studies.limit_state import system_margin
from jaxclear.studies.reliability.models import Probability, RunModel, SurfaceModel, refused

# Share of the samples that a level keeps, samples of a level at first and at the most, repetitions
# at first and added.
SHARE, LEVEL, LARGEST, FIRST, MORE = 0.1, 1000, 8000, 8, 4
# Samples of a chain.
STEPS = round(1 / SHARE)
# Share of steps that are to be taken, and the correlation of a chain's first steps.
ACCEPTED, FIRST_SPREAD = 0.44, 0.6
# Levels of a tenth at the most: rarer than one in 1e12 is not looked for.
MOST_LEVELS = 12
# Seeds of a level at the least, as a share of its samples [1].
FEWEST_SEEDS = 0.01
# Margin of what is infinitely beyond a limit; that of a lost run alone is infinite.
BROKEN = -1e300
# Samples of a level: of 31 limits (probabilities from 1e-3 to 1e-7, planes in up to 60 variables,
# bent, rough and of several modes) none was missed in 100 searches each; by half as many one in six
# of the rough ones was.
PILOT = 200
# Of a search that did not come as far nobody knows: responses that are alike do not tell it where
# the limit lies.
FAR = 1e-8


def subset(
    model: RunModel, variation: float, most_runs: int, seed: int, reach: "Reach"
) -> Probability:
    """Probability of failing by subset simulation.

    It is too high by up to half the square of a single repetition's coefficient of variation,
    because its levels are its own samples'. That is part of the error, and where it dominates the
    levels are doubled and the repetitions begin anew.

    Args:
        model: margins by runs.
        variation: required coefficient of variation [1].
        most_runs: largest number of runs, of all repetitions together. Where it does not suffice
            for the usual size of all possible levels, `reach` counts them first, and they are as
            large as it allows.
        seed: of the samples.
        reach: the small repetition.
    """
    level, new = LEVEL, FIRST
    if most_runs < FIRST * LEVEL * (1 + (1 - SHARE) * MOST_LEVELS):
        share, rare, looked = reach.search()
        new = min(FIRST, most_runs // looked)
        if new < MORE:
            seen = f"{looked} runs say " + (f"about {share:.0e}" if share else f"below {rare:.0e}")
            takes = f"an answer with its error takes at least {MORE * looked}"
            return refused(f"most_runs={most_runs} is too small: {seen}, {takes}.", looked)
        level = min(LEVEL, PILOT * most_runs // (new * looked) // STEPS * STEPS)
    before, failed = model.runs, model.failed
    values, unknown, reached, cost = np.zeros(0), np.zeros(0), np.zeros(0), 0
    while True:
        start, rng = model.runs, np.random.default_rng([seed, 5, level, len(values)])
        repeated = repetitions(model, new, level, rng, most_runs=most_runs - (start - before))
        pairs_of_columns = zip((values, unknown, reached), repeated, strict=True)
        values, unknown, reached = (np.concatenate(pair) for pair in pairs_of_columns)
        cost += model.runs - start
        mean = values.mean()
        single = _variation_of_one(values, reached, level)
        # Without levels the samples are independent, and there is no bias.
        bias = 0.5 * single**2 if reached.mean() < 1.0 else 0.0
        error = np.hypot(single / np.sqrt(len(values)), bias)
        remaining = most_runs - (model.runs - before)
        if error <= variation or remaining < cost * MORE / len(values):
            break
        new = MORE
        if single**2 > variation and level < LARGEST and remaining > 2 * cost / len(values) * FIRST:
            values, unknown, reached, cost = np.zeros(0), np.zeros(0), np.zeros(0), 0
            level, new = 2 * level, FIRST
    runs, failed = model.runs - before, model.failed - failed
    if mean == 0.0:
        nothing = f"nothing that fails is found in {runs} runs"
        described = model.problem.description.responses
        endless = [described[part.response].infinite for part in model.limit.limits()]
        if any(endless):
            why = f"infinite responses say nothing of how near they are ({' '.join(endless)})"
            return refused(f"{nothing}; {why}.", runs, failed)
        rarest = float(reached.mean())
        if reach.result and reach.result[0] > 0.0:
            seen = f"a first search says about {reach.result[0]:.0e}"
            nothing = f"{seen}, which takes more runs (most_runs); {nothing}"
        elif rarest > FAR:
            # None of independent samples of the last level: less than this with 95 %.
            rarest *= 1 - 0.05 ** (1 / (level * len(values)))
            nothing = f"samples that are alike do not tell where the limit lies; {nothing}"
        return refused(f"{nothing}, down to {rarest:.0e}.", runs, failed)
    share = float(unknown.mean() / mean)
    return Probability(float(mean), float(error), runs, failed, share, len(values))


def _variation_of_one(values: np.ndarray, reached: np.ndarray, level: int) -> float:
    """Coefficient of variation of one repetition: by the spread of `values` (repetitions,), but no
    less than that of independent samples at each level, which a few may be by chance; `reached`
    (repetitions,) are the parts that the levels took."""
    mean = values.mean()
    if not mean > 0:
        return np.inf
    levels, inside = np.log(reached.mean()) / np.log(SHARE), mean / reached.mean()
    least = levels * (1 - SHARE) / (SHARE * level) + (1 - inside) / (inside * level)
    return float(max(values.std(ddof=1) / mean, np.sqrt(max(least, 0.0))))


def repetitions(
    model: RunModel | SurfaceModel,
    number: int,
    count: int,
    rng,
    see: Callable[[np.ndarray, np.ndarray], None] = lambda normal, margins: None,
    most_runs: float = np.inf,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Independent subset simulations; arrays (repetitions,) [1].

    Args:
        model: margins by runs or by a surface.
        number: of repetitions.
        count: samples of a level.
        rng: random generator.
        see: function called with all samples (samples, variables) and margins (samples, limits).
        most_runs: number of samples in all beyond which no level begins; what fails of the last
            one is counted. Infinite by default.

    Returns:
        Shares that fail; shares of runs that did not reach their end; the rarest parts reached.
    """
    variables, cuts = len(model.problem.names), model.limit.cut_sets()
    normal = rng.normal(size=(number, count, variables))
    scales = np.ones(len(model.limit.limits()))

    def evaluate(at):
        flat = at.reshape(-1, variables)
        margins = model.margins(flat)
        see(flat, margins)
        return margins

    def worst(at):
        return _system_margins(evaluate(at) / scales, cuts).reshape(at.shape[:-1])

    margins = evaluate(normal)
    # Limits in one scale, so that a system's worst samples are not those of the largest unit.
    scales = np.array([_scale_of_margins(column[np.isfinite(column)]) for column in margins.T])
    margins = _system_margins(margins / scales, cuts).reshape(number, count)
    result, unknown, seed_count = np.zeros(number), np.zeros(number), int(SHARE * count)
    share, open_, runs = np.ones(number), np.ones(number, bool), number * count
    while open_.any():
        level = np.array([_next_level(column, seed_count) for column in margins])
        # -inf where so many runs are lost that they are the level; nan where nothing parts the
        # samples, and those that fail are counted as they are.
        runs += int((open_ & (level > 0)).sum()) * (count - seed_count)
        done = open_ & (~(level > 0) | (runs > most_runs))
        inside = (margins < 0).mean(axis=1)
        result[done] = share[done] * inside[done]
        unknown[done] = share[done] * np.isneginf(margins[done]).mean(axis=1)
        open_ &= ~done
        share[open_] *= (margins[open_] <= level[open_, None]).mean(axis=1)
        # Half a level: shares of a tenth are off by rounding.
        open_ &= share > SHARE ** (MOST_LEVELS - 0.5)
        if not open_.any():
            break
        pairs = zip(margins[open_], level[open_], strict=True)
        seeds = np.stack([_choose_seeds(*pair, seed_count, rng) for pair in pairs])
        chains = (
            np.take_along_axis(normal[open_], seeds[..., None], axis=1),
            np.take_along_axis(margins[open_], seeds, axis=1),
        )
        normal[open_], margins[open_] = _run_chains(worst, *chains, level[open_], rng)
    return result, unknown, share


def _next_level(margins: np.ndarray, seed_count: int) -> float:
    """The margin that about `seed_count` of the samples (samples,) do not exceed; where samples tie
    there, with all of the tie or with none of it, whichever takes nearer as many; nan where that
    parts no samples."""
    ordered, count = np.sort(margins), len(margins)
    low, high = ordered[seed_count - 1 : seed_count + 1]
    if low < high:
        return float(low if np.isinf(high) else 0.5 * (low + high))
    below, within = (int(np.searchsorted(ordered, low, side)) for side in ("left", "right"))
    if below >= FEWEST_SEEDS * count and (within == count or below * within > seed_count**2):
        return float(ordered[below - 1])
    return np.nan if within == count and low > 0 else float(low)


def _choose_seeds(margins: np.ndarray, level: float, seed_count: int, rng) -> np.ndarray:
    """So many of the samples (samples,) at or below a level, the worst ones where these are just
    so many; of ties any."""
    inside = np.flatnonzero(margins <= level)
    if len(inside) == seed_count:
        return inside[np.argsort(margins[inside], kind="stable")]
    return np.resize(rng.permutation(inside), seed_count)


def _scale_of_margins(finite: np.ndarray) -> float:
    """Deviation of the finite margins of a limit; where it has none, as of a single one, what they
    are; 1 where there are none, or nothing."""
    if not len(finite):
        return 1.0
    largest, spread = float(np.abs(finite).max()), float(finite.std())
    return spread if spread > np.finfo(float).eps * largest else largest or 1.0


def _system_margins(margins: np.ndarray, cuts) -> np.ndarray:
    """Margins (samples,) of a system from those of its limits (samples, limits), `BROKEN` at the
    least; -inf for lost runs alone."""
    is_missing = np.isnan(margins).any(axis=1)
    system = system_margin(np.where(is_missing[:, None], 0.0, margins), cuts)
    return np.where(is_missing, -np.inf, np.maximum(system, BROKEN))


def _run_chains(worst, seeds, margins, levels, rng) -> tuple[np.ndarray, np.ndarray]:
    """Chains from `seeds` (repetitions, chains, variables) with their `margins` that stay at or
    below the levels (repetitions,): (repetitions, samples, variables) and their margins."""
    spread = np.full(len(seeds), FIRST_SPREAD)
    places, values = [seeds], [margins]
    for step in range(1, STEPS):
        width = np.minimum(spread, 1.0)[:, None, None]
        moved = np.sqrt(1 - width**2) * places[-1] + width * rng.normal(size=seeds.shape)
        tried = worst(moved)
        taken = tried <= levels[:, None]
        places.append(np.where(taken[..., None], moved, places[-1]))
        values.append(np.where(taken, tried, values[-1]))
        spread *= np.exp((taken.mean(axis=1) - ACCEPTED) / np.sqrt(step))
    return np.concatenate(places, axis=1), np.concatenate(values, axis=1)


@dataclass
class Reach:
    """What a search of a few runs says of whether anything fails, asked once, when it is wanted;
    and the sample that came nearest to the limit, with its margin."""

    model: RunModel
    seed: int
    sentence: str = ""
    normal: np.ndarray | None = None
    margin: float = np.inf
    result: tuple[float, float, int] | None = None

    def search(self) -> tuple[float, float, int]:
        """The share that fails, the rarest part reached [1], and the number of runs."""
        if self.result is None:
            rng, before = np.random.default_rng([self.seed, 7]), self.model.runs
            (share,), _, (rare,) = repetitions(self.model, 1, PILOT, rng, self._note_samples)
            self.result = float(share), float(rare), self.model.runs - before
        return self.result

    def beyond(self) -> str:
        """A sentence where the limit lies beyond everything seen; "" where something fails, and
        where it is not known."""
        share, rare, runs = self.search()
        if not (self.sentence or share > 0.0 or rare > FAR or self.normal is None):
            far = f"{runs} runs down to parts as rare as {rare:.0e}"
            self.sentence = self._nearest_text(self.normal, far)
        return self.sentence

    def _note_samples(self, normal: np.ndarray, margins: np.ndarray) -> None:
        """Of samples (samples, variables) with margins (samples, limits), known if not nan."""
        finite = np.where(np.isnan(margins), np.inf, margins)
        system = system_margin(finite, self.model.limit.cut_sets())
        least = int(np.argmin(system))
        if system[least] < self.margin:
            self.normal, self.margin = normal[least], float(system[least])

    def _nearest_text(self, normal: np.ndarray, far: str) -> str:
        problem, limit = self.model.problem, self.model.limit
        values = np.asarray(problem.inputs.values(normal))
        units, responses = problem.units(), problem.evaluate(jnp.asarray(values)).responses
        self.model.runs += 1
        nominal = np.asarray(problem.nominal())
        where = ", ".join(
            f"{name} = {in_digits(value, 0.1 * (value - middle))}{_unit(unit)}"
            for name, value, middle, unit in zip(
                problem.names, values, nominal, problem.variable_units, strict=True
            )
        )
        reached = ", ".join(
            f"{response} = {float(responses[response]):.5g}{_unit(units[response])}"
            for response in dict.fromkeys(part.response for part in limit.limits())
        )
        return (
            f"nothing fails in {far}: the limit ({limit.words()}) lies beyond everything seen. "
            f"Nearest to it is {reached}, at {where}."
        )


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"
