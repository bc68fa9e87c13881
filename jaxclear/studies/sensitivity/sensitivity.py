"""Derivatives of responses with respect to what varies: `jaxclear.sensitivity`.

Each variable is differentiated by several methods (`methods`) on shared samples; their answers meet
in one (`derivative`).
"""

from collections.abc import Sequence
from typing import Any

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_count, check_known, check_number, expect
from jaxclear.ground.wording import listed
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.identity import first_difference
from jaxclear.studies.monte_carlo import MonteCarlo, monte_carlo
from jaxclear.studies.sampling import draw
from jaxclear.studies.sensitivity.derivative import Sensitivity, confirmed
from jaxclear.studies.sensitivity.methods import differences, pathwise, regression

METHODS = ("regression", "differences", "pathwise")


@answering
def sensitivity(
    problem: AbstractProblem,
    variables: str | Sequence[str] | None = None,
    *,
    sample: MonteCarlo | int = 256,
    difference_samples: int = 128,
    width: float | None = None,
    methods: Sequence[str] = ("regression", "differences"),
    seed: int = 0,
    progress_bar: bool = False,
) -> Sensitivity:
    """Derivatives of the mean of every response with respect to `variables` (names; all by
    default).

    `sample`: a Monte Carlo sample to read slopes from, or how many samples to draw for it. `width`:
    how far `differences` moves a variable [its unit], by default one standard deviation of its
    distribution: a response with kinks has another slope at every scale, and the one wanted is that
    over the tolerance. `methods`: any of "regression", "differences", "pathwise" (fixed-step
    integrators only; the cheapest where nothing opens and closes; through contacts it is shown only
    where another method agrees with it, and is never the answer).
    Raises `ValueError` with a sentence for a name that there is not, and for a sample of another
    problem.
    """
    expect(problem, AbstractProblem, "what is differentiated", "a problem, as jaxclear.Problem")
    _check(sample, difference_samples, width, methods, seed)
    wanted = _wanted(problem, variables)
    if isinstance(sample, MonteCarlo):
        drawn = sample
        _check_sample(problem, drawn)
    else:
        drawn = monte_carlo(problem, sample, seed=seed, progress_bar=progress_bar)
    shared = draw(problem, difference_samples, seed + 1)
    derivatives = {}
    for name in wanted:
        place = problem.names.index(name)
        answers = {}
        if "regression" in methods:
            answers["regression"] = {r: regression(drawn, r, place) for r in problem.response_names}
        if "differences" in methods:
            deviation = problem.variables[name].distribution.deviation()
            step = float(deviation) if width is None else width
            answers["differences"] = differences(
                problem, shared, place, step, progress_bar=progress_bar
            )
        if "pathwise" in methods:
            answers["pathwise"] = pathwise(problem, shared, place, progress_bar=progress_bar)
        for response in problem.response_names:
            estimates = {method: found[response] for method, found in answers.items()}
            derivatives[response, name] = confirmed(response, name, estimates)
    return Sensitivity(derivatives, drawn)


def _check_sample(problem: AbstractProblem, sample: MonteCarlo) -> None:
    """Raises `ValueError` for a sample of another problem: its slopes would be another's too."""
    difference = first_difference(sample.problem, problem)
    if difference:
        raise ValueError(
            f"the sample is of another problem ({difference}); give a sample of this one, "
            "jaxclear.monte_carlo(problem), or how many samples to draw."
        )


def _check(sample: Any, difference_samples: Any, width: Any, methods: Any, seed: Any) -> None:
    """What a study of derivatives may be asked for."""
    expect(methods, (tuple, list), "methods of sensitivity", f"some of {listed(METHODS)}")
    if not methods:
        raise ValueError(
            f"methods of sensitivity is empty; it must hold some of {listed(METHODS)}."
        )
    for method in methods:
        check_known("method of sensitivity", method, METHODS)
    if not isinstance(sample, MonteCarlo):
        check_count("sample of sensitivity (a Monte Carlo study, or how many samples)", sample)
    check_count("difference_samples of sensitivity", difference_samples)
    check_count("seed of sensitivity", seed, at_least=0)
    if width is not None:
        check_number("width of sensitivity", width, above=0)


def _wanted(problem: AbstractProblem, variables: str | Sequence[str] | None) -> list[str]:
    """The names asked for. Raises `ValueError` for one that the problem does not have."""
    if variables is None:
        return list(problem.names)
    wanted = [variables] if isinstance(variables, str) else variables
    expect(wanted, (list, tuple), "variables of sensitivity", "names of the problem's variables")
    for name in wanted:
        check_known("variable", name, problem.names, " in this problem")
    return list(wanted)
