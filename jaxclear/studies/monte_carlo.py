"""Monte Carlo over the toleranced numbers of a problem: how responses spread, and which sample
failed and why.
"""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import ndtri
from scipy.stats import qmc

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_count, check_flags, check_known, expect
from jaxclear.ground.precision import check_double_precision
from jaxclear.integrators import Checks, Outcome
from jaxclear.studies.base import AbstractProblem
from jaxclear.studies.batch import chunk_size, evaluate_all
from jaxclear.studies.warned import any_warning, counted, in_words, warned_of

SAMPLINGS = ("sobol", "random")


class MonteCarlo(eqx.Module):
    """Samples and their responses. Failed samples keep their row, with `nan` responses and a
    sentence; those that reached their end with warnings are counted beside them.

    `values` (samples, variables) are the varied numbers, `responses` (samples,) by name, `checks`
    what each run found out about itself.
    """

    problem: AbstractProblem
    values: np.ndarray
    responses: dict[str, np.ndarray]
    outcome: np.ndarray
    ended: np.ndarray
    seed: int = eqx.field(static=True)
    chunk: int = eqx.field(static=True)
    checks: Checks = eqx.field(default_factory=Checks)

    @property
    def failed(self) -> np.ndarray:
        """Indices of the samples that failed."""
        finite = np.all([np.isfinite(r) for r in self.responses.values()], axis=0)
        return np.flatnonzero((self.outcome != Outcome.REACHED) | ~finite)

    def failures(self) -> dict[int, str]:
        """Why each failed sample failed, by its index."""
        return {int(i): self._sentence(i) for i in self.failed}

    @property
    def warned(self) -> np.ndarray:
        """Indices of the samples that did not fail and carry a warning."""
        return np.setdiff1d(np.flatnonzero(any_warning(self.checks, self.count)), self.failed)

    def warnings(self) -> dict[int, tuple[str, ...]]:
        """What each of those warns of, by its index."""
        return {int(i): self.checks.of_sample(int(i)).warnings for i in self.warned}

    def concerned(self, response: str) -> np.ndarray:
        """Indices of the samples that carry a warning which concerns this response (peak forces
        that the steps do not resolve concern no position)."""
        check_known("response", response, self.responses, " in this study")
        found = warned_of(self.problem, response, self.checks, self.count)
        return np.setdiff1d(np.flatnonzero(found), self.failed)

    @property
    def count(self) -> int:
        """Number of samples."""
        return len(self.values)

    def rerun(self, index: int) -> Any:
        """One sample alone, to look at one that failed or warned: a mechanism's run, bit for bit
        that of the study; of a function what it gives, by name.
        """
        return self.problem.rerun(jnp.asarray(self.values[index]), index, self.chunk)

    def sentence(self) -> str:
        """How many samples there are, failed and warned, and of what; and why the integrator is
        what it is, where it is not the usual one."""
        text = f"{self.count} samples, {len(self.failed)} failed, {len(self.warned)} with warnings"
        counts = counted(self.checks, np.isin(np.arange(self.count), self.warned))
        text = f"{text} ({in_words(counts)})." if counts else f"{text}."
        return f"{text} {self.problem.remark()}".rstrip()

    def _sentence(self, i):
        named = ", ".join(
            f"{n} = {v:.6g}" for n, v in zip(self.problem.names, self.values[i], strict=True)
        )
        ending = self.problem.ending(int(self.outcome[i]), float(self.ended[i]))
        if self.outcome[i] == Outcome.REACHED:
            ending = f"{ending.rstrip('.')}, but a response is not finite."
        return f"With {named} {ending}"

    def table(self) -> Any:
        """All samples as a pandas table: variables, responses, result, warnings and the responses
        that these concern."""
        import pandas

        columns: dict[str, Any] = {
            name: self.values[:, i] for i, name in enumerate(self.problem.names)
        }
        columns |= self.responses
        sentences = self.failures()
        good = self.problem.ending(Outcome.REACHED, 0.0)
        good = f"{good[0].upper()}{good[1:]}"
        columns["result"] = [sentences.get(i, good) for i in range(self.count)]
        warnings = self.warnings()
        columns["warnings"] = [" ".join(warnings.get(i, ())) for i in range(self.count)]
        concerned = {name: set(self.concerned(name)) for name in self.responses}
        columns["in doubt"] = [
            ", ".join(name for name, samples in concerned.items() if i in samples)
            for i in range(self.count)
        ]
        return pandas.DataFrame(columns)

    def summary(self) -> Any:
        """Mean with its standard error, standard deviation and percentiles of each response, as a
        pandas table. "warned" counts the samples with a warning that concerns the response; the
        last two columns leave them out, all others take them in.

        The standard error is that of independent samples; for quasi-random ones it is an upper
        estimate.
        """
        import pandas

        good = np.setdiff1d(np.arange(self.count), self.failed)
        rows = []
        for name, response in self.responses.items():
            r = response[good]
            low, median, high = np.percentile(r, [5, 50, 95]) if len(r) else (np.nan,) * 3
            warned = self.concerned(name)
            spread, clean = _spread(r), response[np.setdiff1d(good, warned)]
            rows.append(
                {
                    "response": name,
                    "unit": self.problem.units()[name],
                    "samples": len(r),
                    "failed": len(self.failed),
                    "warned": len(warned),
                    "mean": r.mean() if len(r) else np.nan,
                    "standard error": spread / np.sqrt(max(len(r), 1)),
                    "standard deviation": spread,
                    "5 %": low,
                    "median": median,
                    "95 %": high,
                    "mean without warned": clean.mean() if len(clean) else np.nan,
                    "standard deviation without warned": _spread(clean),
                }
            )
        return pandas.DataFrame(rows)


def _spread(values: np.ndarray) -> float:
    return float(values.std(ddof=1)) if len(values) > 1 else np.nan


def draw(problem: AbstractProblem, samples: int, seed: int, sampling: str = "sobol") -> np.ndarray:
    """Values (samples, variables) drawn from the variables' distributions."""
    check_double_precision()
    expect(problem, AbstractProblem, "what is sampled", "a jaxclear.Problem or FunctionProblem")
    check_known("sampling", sampling, SAMPLINGS)
    check_count("the number of samples", samples)
    check_count("seed", seed, at_least=0)
    count = len(problem.variables)
    if count == 0:
        raise ValueError("the problem has no variables; nothing would vary: give it some.")
    if sampling == "sobol":
        # A power of two keeps the sequence balanced; what is more than asked for is left out.
        power = int(np.ceil(np.log2(samples)))
        shares = qmc.Sobol(count, scramble=True, rng=np.random.default_rng(seed)).random_base2(
            power
        )[:samples]
    else:
        shares = np.random.default_rng(seed).random((samples, count))
    shares = np.clip(shares, 1e-12, 1 - 1e-12)
    return np.asarray(problem.inputs.values(ndtri(jnp.asarray(shares))))


@answering
def monte_carlo(
    problem: AbstractProblem,
    samples: int = 1024,
    *,
    seed: int = 0,
    sampling: str = "sobol",
    chunk: int | None = None,
    progress_bar: bool = False,
) -> MonteCarlo:
    """Responses over a random sample of the variables.

    `sampling`: "sobol" (scrambled, quasi-random) or "random". `chunk`: samples run together, by
    default what fits memory; all chunks share one compiled program. A sample that fails is counted,
    named and kept; so is one whose run warns of its own numbers.
    """
    values = draw(problem, samples, seed, sampling)
    if chunk is not None:
        check_count("chunk of monte_carlo", chunk)
    check_flags("monte_carlo", progress_bar=progress_bar)
    chunk = chunk_size(problem, samples, chunk)
    outcome = evaluate_all(
        problem, jnp.asarray(values), chunk=chunk, progress_bar=progress_bar, label="Monte Carlo"
    )
    good = outcome.outcome == Outcome.REACHED
    responses = {
        name: np.where(good, outcome.responses[name], np.nan) for name in problem.response_names
    }
    ends = (np.asarray(outcome.outcome), np.asarray(outcome.ended))
    return MonteCarlo(problem, values, responses, *ends, seed, chunk, outcome.checks)
