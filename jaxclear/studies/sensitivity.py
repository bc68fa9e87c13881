"""Derivatives of responses as answers: each with an error, the method that gave it, and a verdict.

Three methods, none of which is right everywhere. `regression` reads the slope off a Monte Carlo
sample (free, averages over the tolerances). `differences` runs the same samples with one variable
moved up and down (common random numbers), at two widths, so that curvature shows as an error.
`pathwise` carries the tangent through every step: exact for the discrete run and cheap, but behind
many impacts it grows without bound, and then it is refused. At least two methods answer together or
the verdict says that they do not.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxclear.integrators import Outcome
from jaxclear.studies.batch import evaluate_all
from jaxclear.studies.monte_carlo import MonteCarlo, draw, monte_carlo
from jaxclear.studies.problem import Problem, SampleResult

# An answer this many times less certain than another is large agrees with anything, and confirms
# nothing.
VAGUE = 3.0
METHODS = ("regression", "differences", "pathwise")
# A standard normal variable stays within this many deviations in 95 % of cases.
CONFIDENCE = 1.96
# From this many times the typical size of single derivatives on, the error of their mean shows that
# a mean does not exist.
REFUSAL_SPREAD = 30.0


class Estimate(NamedTuple):
    """A derivative by one method. `error` is half the width of its 95 % interval, bias included;
    `refusal` says why a method has no answer (then value and error are nan)."""

    value: float
    error: float
    refusal: str = ""


class Derivative(eqx.Module):
    """Derivative of the mean of a response over the tolerances with respect to one variable, with
    its 95 % error.

    `estimates` are the methods' own answers, `verdict` a sentence that says whether they agree.
    """

    response: str = eqx.field(static=True)
    variable: str = eqx.field(static=True)
    value: float
    error: float
    method: str = eqx.field(static=True)
    verdict: str = eqx.field(static=True)
    estimates: dict[str, Estimate]

    @property
    def trustworthy(self) -> bool:
        """True where at least two methods agree."""
        return self.verdict.startswith("Agreed")


class Sensitivity(eqx.Module):
    """Derivatives of every response with respect to every variable asked for, and the sample behind
    them.
    """

    derivatives: dict[tuple[str, str], Derivative]
    sample: MonteCarlo

    def unit(self, response: str, variable: str) -> str:
        """Unit of a derivative, "response/variable"."""
        problem = self.sample.problem
        return f"({problem.units()[response]})/({problem.variable_units[problem.names.index(variable)]})"

    def table(self) -> Any:
        """A pandas table: one row a derivative, with each method's answer and the verdict."""
        import pandas

        rows = []
        for (response, variable), d in self.derivatives.items():
            row = {
                "response": response,
                "variable": variable,
                "unit": self.unit(response, variable),
            }
            row |= {
                "derivative": d.value,
                "error (95 %)": d.error,
                "method": d.method,
                "verdict": d.verdict,
            }
            for name, estimate in d.estimates.items():
                row |= {
                    name: estimate.value,
                    f"{name} error": estimate.error,
                    f"{name} refusal": estimate.refusal,
                }
            rows.append(row)
        return pandas.DataFrame(rows)


def regression(sample: MonteCarlo, response: str, variable: int) -> Estimate:
    """Slope at nominal of a quadratic least-squares fit over the sample, with
    heteroscedasticity-robust (HC3) errors.

    The fit is linear in all variables and quadratic in the one asked for, so curvature does not
    leak into the slope.
    """
    good = np.setdiff1d(np.arange(len(sample.values)), sample.failed)
    values = sample.values[good] - np.asarray(sample.problem.nominal())
    scale = values.std(axis=0)
    if len(good) < 4 * values.shape[1] + 8:
        return Estimate(
            np.nan,
            np.nan,
            f"{len(good)} good samples are too few for a fit in {values.shape[1]} variables.",
        )
    if scale[variable] == 0:
        return Estimate(np.nan, np.nan, "the variable does not vary in the sample.")
    x = values / np.where(scale > 0, scale, 1.0)
    design = np.column_stack([np.ones(len(x)), x, x[:, variable] ** 2])
    target = sample.responses[response][good]
    inverse = np.linalg.pinv(design.T @ design)
    coefficients = inverse @ design.T @ target
    leverage = np.einsum("ij,jk,ik->i", design, inverse, design)
    residual = (target - design @ coefficients) / np.clip(1.0 - leverage, 1e-3, None)
    covariance = inverse @ (design.T * residual**2) @ design @ inverse
    slope = coefficients[1 + variable] / scale[variable]
    return Estimate(
        float(slope),
        float(CONFIDENCE * np.sqrt(covariance[1 + variable, 1 + variable]) / scale[variable]),
    )


def differences(
    problem: Problem, values: np.ndarray, variable: int, width: float, *, progress_bar: bool = False
) -> dict[str, Estimate]:
    """Central differences over common random numbers at `width` and half of it; their disagreement
    is the bias.
    """
    shifts = np.array([-1.0, -0.5, 0.5, 1.0]) * width
    moved = np.concatenate([values + shift * np.eye(values.shape[1])[variable] for shift in shifts])
    outcome = evaluate_all(
        problem, jnp.asarray(moved), progress_bar=progress_bar, label="differences"
    )
    good = np.all((outcome.outcome == Outcome.REACHED).reshape(4, -1), axis=0)
    estimates = {}
    for name, flat in outcome.responses.items():
        far_down, down, up, far_up = flat.reshape(4, -1)[:, good]
        wide, narrow = (far_up - far_down) / (2 * width), (up - down) / width
        if len(wide) < 8:
            estimates[name] = Estimate(
                np.nan, np.nan, f"only {len(wide)} of {len(good)} samples ran at all four widths."
            )
            continue
        count = np.sqrt(len(wide))
        noise = CONFIDENCE * wide.std(ddof=1) / count
        gap = abs(wide.mean() - narrow.mean())
        gap_noise = CONFIDENCE * (wide - narrow).std(ddof=1) / count
        # A gap within its own noise is no sign of curvature.
        bias = max(gap - gap_noise, 0.0)
        estimates[name] = Estimate(float(wide.mean()), float(np.hypot(noise, bias)))
    return estimates


@eqx.filter_jit
def _pathwise_chunk(problem: Problem, packed) -> SampleResult:
    """Tangents of the responses along a direction: `packed` (samples, 2 variables) are values and
    directions.
    """
    count = packed.shape[1] // 2

    def one(row):
        def responses(values):
            result = problem.evaluate(values)
            return result.responses, (result.outcome, result.ended)

        _, tangents, rest = jax.jvp(responses, (row[:count],), (row[count:],), has_aux=True)
        return SampleResult(tangents, *rest)

    return jax.vmap(one)(packed)


def pathwise(
    problem: Problem, values: np.ndarray, variable: int, *, progress_bar: bool = False
) -> dict[str, Estimate]:
    """Mean over the sample of the derivative of each run, with its standard error; refused where it
    has no mean.
    """
    if not problem.integrator.pathwise:
        why = (
            "derivatives of a finished adaptive run are wrong near contact; use a fixed-step "
            "integrator."
        )
        return {name: Estimate(np.nan, np.nan, why) for name in problem.response}
    direction = np.zeros_like(values)
    direction[:, variable] = 1.0
    packed = jnp.asarray(np.concatenate([values, direction], axis=1))
    outcome = evaluate_all(
        problem, packed, progress_bar=progress_bar, label="tangents", function=_pathwise_chunk
    )
    good = outcome.outcome == Outcome.REACHED
    estimates = {}
    for name, tangents in outcome.responses.items():
        finite = tangents[good & np.isfinite(tangents)]
        lost = int(good.sum() - len(finite))
        mean = finite.mean() if len(finite) else np.nan
        error = (
            CONFIDENCE * finite.std(ddof=1) / np.sqrt(len(finite)) if len(finite) > 1 else np.nan
        )
        if lost or not np.isfinite(error):
            why = (
                f"the tangent overflowed in {lost} of {int(good.sum())} runs: it grows without "
                "bound through impacts."
            )
            estimates[name] = Estimate(np.nan, np.nan, why)
        elif error > REFUSAL_SPREAD * np.median(abs(finite)):
            why = (
                f"single runs differ by up to {np.abs(finite).max():.1e}: the tangent grows "
                "without bound through impacts."
            )
            estimates[name] = Estimate(np.nan, np.nan, why)
        else:
            estimates[name] = Estimate(float(mean), float(error))
    return estimates


def judge(response: str, variable: str, estimates: dict[str, Estimate]) -> Derivative:
    """One answer from the methods' answers: the most certain one that another method confirms."""
    answers = {
        name: e for name, e in estimates.items() if np.isfinite(e.value) and np.isfinite(e.error)
    }
    order = sorted(answers, key=lambda name: answers[name].error)
    if order:
        largest = VAGUE * (abs(answers[order[0]].value) + answers[order[0]].error)
        # An exact zero makes no other answer vague.
        order = [name for name in order if largest == 0 or answers[name].error <= largest]

    def agree(a, b):
        return abs(a.value - b.value) <= np.hypot(a.error, b.error)

    for name in order:
        partners = [
            other for other in order if other != name and agree(answers[name], answers[other])
        ]
        if partners:
            best = answers[name]
            others = [other for other in order if other != name and other not in partners]
            verdict = f"Agreed by {name} and {' and '.join(partners)}"
            verdict += f"; not by {' and '.join(others)}." if others else "."
            if best.error > abs(best.value):
                verdict += " Not distinguishable from zero."
            return Derivative(response, variable, best.value, best.error, name, verdict, estimates)
    if not order:
        return Derivative(
            response, variable, np.nan, np.nan, "none", "No method has an answer.", estimates
        )
    best = answers[order[0]]
    if len(order) == 1:
        verdict = f"Unconfirmed: only {order[0]} has an answer."
        return Derivative(response, variable, best.value, best.error, order[0], verdict, estimates)
    values = [answers[name].value for name in order]
    middle, spread = 0.5 * (max(values) + min(values)), 0.5 * (max(values) - min(values))
    spread += max(answers[name].error for name in order)
    return Derivative(
        response, variable, middle, spread, "spread of methods", "The methods disagree.", estimates
    )


def sensitivity(
    problem: Problem,
    variables: Any = None,
    *,
    sample: MonteCarlo | None = None,
    samples: int = 256,
    difference_samples: int = 128,
    width: float | None = None,
    methods: tuple[str, ...] = ("regression", "differences"),
    seed: int = 0,
    progress_bar: bool = False,
) -> Sensitivity:
    """Derivatives of the mean of every response with respect to `variables` (names; all by
    default).

    `sample`: a Monte Carlo sample to read slopes from, drawn here with `samples` samples if not
    given. `width`: how far `differences` moves a variable, by default one standard deviation of its
    distribution: a response with kinks has another slope at every scale, and the one wanted is that
    over the tolerance. `methods`: any of "regression", "differences", "pathwise" (fixed-step
    integrators only; the cheapest while contact persists, refused where its tangents explode).
    """
    unknown = [m for m in methods if m not in METHODS]
    if unknown:
        raise ValueError(f"no method {unknown[0]!r}; there are {', '.join(METHODS)}.")
    names = list(problem.names)
    wanted = (
        names
        if variables is None
        else [variables]
        if isinstance(variables, str)
        else list(variables)
    )
    for name in wanted:
        if name not in names:
            raise ValueError(
                f'no variable "{name}" in this problem; there are {", ".join(map(repr, names))}.'
            )
    if sample is None:
        sample = monte_carlo(problem, samples, seed=seed, progress_bar=progress_bar)
    shared = draw(problem, difference_samples, seed + 1)
    derivatives = {}
    for name in wanted:
        index = names.index(name)
        by_method: dict[str, dict[str, Estimate]] = {}
        if "regression" in methods:
            by_method["regression"] = {r: regression(sample, r, index) for r in problem.response}
        if "differences" in methods:
            step = (
                float(problem.variables[name].distribution.deviation()) if width is None else width
            )
            by_method["differences"] = differences(
                problem, shared, index, step, progress_bar=progress_bar
            )
        if "pathwise" in methods:
            by_method["pathwise"] = pathwise(problem, shared, index, progress_bar=progress_bar)
        for response in problem.response_names:
            estimates = {method: answers[response] for method, answers in by_method.items()}
            derivatives[response, name] = judge(response, name, estimates)
    return Sensitivity(derivatives, sample)
