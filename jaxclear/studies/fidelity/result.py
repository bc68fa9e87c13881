"""What a study of several models says: means and deviations of the accurate one, what the cheaper
ones were worth, and in a sentence why they were not used.
"""

import equinox as eqx
import numpy as np

from jaxclear.studies.answer import RESPONSE, AbstractAnswer, Column, Stated, means_and_deviations
from jaxclear.studies.problem import Problem
from jaxclear.studies.statistics.scrambled import Statistic


class MultiFidelity(AbstractAnswer):
    """Statistics of a problem by its own runs and those of cheaper ones.

    `means` and `standard_deviations` are by response, with 95 % intervals. `used` names the models
    of the chain from the problem down, `runs` how many there were of each, `costs` [1] what a run
    of each costs beside one of the problem. `correlations` [1] by (model, response) are those of
    the pilot sample; `gains` [1] by response, how many times the work plain sampling would take to
    the same error; `work` and `pilot` are in runs of the problem. `failed` and `warned` count runs
    of the problem; `pilot_failed` [1] is the share of each cheaper model's runs that failed in the
    pilot sample.
    """

    problem: Problem
    means: dict[str, Statistic]
    standard_deviations: dict[str, Statistic]
    correlations: dict[tuple[str, str], float]
    gains: dict[str, float]
    used: tuple[str, ...] = eqx.field(static=True)
    runs: tuple[int, ...] = eqx.field(static=True)
    costs: dict[str, float]
    work: float
    pilot: float
    pilot_failed: dict[str, float]
    failed: int = eqx.field(static=True)
    warned: int = eqx.field(static=True)
    scramblings: int = eqx.field(static=True)

    def sentence(self) -> str:
        """What ran, what it saved beside plain sampling of the same kind, and where nothing."""
        counted = [f"{self.runs[0]} runs of the problem"]
        counted += [
            f'{n} of "{name}" (each {_work(self.costs[name])})'
            for name, n in zip(self.used[1:], self.runs[1:], strict=True)
        ]
        text = f"{' and '.join(counted)} in {self.scramblings} independent scramblings: the work "
        text += f"of {self.work:.0f} runs of the problem, and {self.pilot:.0f} for the choice."
        parts = [text, self._gained(), self._unused_models(), self._broken()]
        if self.failed:
            parts.append(f"{self.failed} runs of the problem failed: numbers are of the others.")
        if self.warned:
            parts.append(f"{self.warned} runs of the problem carry warnings.")
        return " ".join(filter(None, [*parts, self.problem.description.remark]))

    def _gained(self) -> str:
        if len(self.used) == 1:
            return ""
        gains = [f"{name} {gain:.2g} times" for name, gain in self.gains.items() if gain >= 1]
        without_gain = [f'"{name}"' for name, gain in self.gains.items() if gain < 1]
        text = f"Plain sampling would take about this much more work: {', '.join(gains)}."
        parts = [text] if gains else []
        if without_gain:
            parts.append(f"It would have been cheaper for {', '.join(without_gain)}.")
        return " ".join(parts)

    def _unused_models(self) -> str:
        """Why models were not used."""
        out = [name for name in self.costs if name not in self.used]
        if not out:
            return ""
        sentences = [
            f'"{name}" does not pay: correlation '
            + ", ".join(
                f"{correlation:.3g} with {response}"
                for (model, response), correlation in self.correlations.items()
                if model == name
            )
            + f", at {_work(self.costs[name])}"
            for name in out
        ]
        last = "; the problem was sampled plainly." if len(self.used) == 1 else "."
        return f"{'; '.join(sentences)}{last}"

    def _broken(self) -> str:
        """Which models' runs failed, of which nothing is learned."""
        failures = [
            f'{100 * share:.2g} % of the runs of "{name}"'
            for name, share in self.pilot_failed.items()
            if share > 0
        ]
        if not failures:
            return ""
        return (
            f"{' and '.join(failures)} failed in the pilot sample and tell nothing; "
            "jaxclear.monte_carlo of the cheaper problem says why."
        )

    def _stated(self):
        over, names = (RESPONSE,), list(self.means)
        models = dict.fromkeys(model for model, _ in self.correlations)
        units = self.problem.units()
        columns = {"unit": Column(over, {name: units[name] for name in names})}
        columns |= means_and_deviations(self.means, self.standard_deviations)
        columns["gain"] = Column(over, self.gains, "1")
        for model in models:
            correlations = {r: c for (m, r), c in self.correlations.items() if m == model}
            columns[f"correlation with {model}"] = Column(over, correlations, "1")
        return Stated("multi-fidelity", columns, self.problem)


def _work(cost: float) -> str:
    if cost == 1:
        return "the same work"
    return f"1/{1 / cost:.3g} of the work" if 0 < cost < 1 else f"{cost:.3g} times the work"


def rate(sizes: np.ndarray) -> float:
    """How fast the variance of plain means (sizes, scramblings) falls with the points, each size
    half of the one before: an exponent of 1 (random) to 3 (smooth responses)."""
    spread = sizes.var(axis=1, ddof=1)
    if len(spread) < 2 or np.any(spread <= 0):
        return 1.0
    fall = np.polyfit(-np.arange(len(spread)), np.log2(spread), 1)[0]
    return float(np.clip(-fall, 1.0, 3.0))
