"""What a Monte Carlo study tells: of one response in a row, of all samples in a table."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy

from jaxclear.ground.printing import with_error
from jaxclear.ground.table import as_table
from jaxclear.ground.wording import listed
from jaxclear.integrators import Outcome
from jaxclear.studies.statistics.accuracy import NumericalError
from jaxclear.studies.statistics.limits import Limits
from jaxclear.studies.statistics.scrambled import (
    CONFIDENCE,
    ROUNDING,
    UNKNOWN,
    deviation,
    standard_error,
    student,
)

# An interval of 95 % that holds less often than this [1] is not called one without a word.
PROMISED = 0.92
PERCENTILES = {"5 %": 0.05, "median": 0.5, "95 %": 0.95}


def summary_row(study: Any, name: str, limits: Mapping[str, Limits]) -> dict[str, Any]:
    """The row of a response in the summary of a study.

    Args:
        study: a `MonteCarlo`.
        name: of the response.
        limits: by response; those of this one give its yield.
    """
    values, group = study.good(name)
    warned = study.affected_samples(name)
    clean = np.setdiff1d(np.setdiff1d(np.arange(study.count), study.failed), warned)
    clean, clean_group = study.responses[name][clean], study.scrambling[clean]
    # Of infinite answers, as lives may be, there is no mean, nor a deviation.
    bounded = bool(np.all(np.isfinite(values)))
    statistics = {"mean": study.mean(name) if bounded else UNKNOWN}
    error = standard_error(np.mean, values, group)[0] if bounded and len(values) else np.nan
    row = {
        "response": name,
        "unit": study.problem.units()[name],
        "samples": len(values),
        "failed": len(study.failed),
        "warned": len(warned),
        "mean": statistics["mean"].value,
        "standard error": error,
    }
    statistics["standard deviation"] = study.standard_deviation(name) if bounded else UNKNOWN
    statistics |= {label: study.quantile(name, share) for label, share in PERCENTILES.items()}
    if name in limits:
        statistics["yield"] = study.share_within({name: limits[name]})
        statistics["Cpk"] = study.process_capability(name, limits[name]) if bounded else UNKNOWN
    for label, statistic in statistics.items():
        row[label] = statistic.value
        row[f"{label} error"] = statistic.error
    if study.replicas is not None:
        row |= _by_steps(study, name)
    if len(study.warned):
        good = bounded and len(clean)
        row["mean, samples without warnings"] = clean.mean() if good else np.nan
        spread = deviation(clean, clean_group) if bounded else np.nan
        row["standard deviation, samples without warnings"] = spread
    if study.problem.description.responses[name].infinite:
        row["infinite"] = int(np.isinf(values).sum())
    return row


def _by_steps(study: Any, name: str) -> dict[str, float]:
    """What replicas tell of a mean: by how much it is too large, with half of the 95 % interval of
    that; and the largest that it may be."""
    bias, uncertainty = study.replicas.bias(name)
    columns = {"numerical error": abs(bias) + uncertainty, "bias": bias, "bias error": uncertainty}
    return columns | {"replicas": len(study.replicas.pairs(name)[0])}


def failure(study: Any, i: int) -> str:
    """Why a sample of a study failed."""
    problem = study.problem
    numbers = zip(problem.names, study.values[i], strict=True)
    named = ", ".join(f"{name} = {value:.6g}" for name, value in numbers)
    ending = problem.description.ending(study.outcome[i], study.ended[i])
    if study.outcome[i] == Outcome.REACHED:
        ending = f"{ending.rstrip('.')}, but a response is not finite."
    return f"With {named} {ending}"


def ends_of(study: Any) -> list[str]:
    """How each sample of a study ended."""
    sentences = study.failures()
    good = study.problem.description.ending(Outcome.REACHED, 0.0)
    good = f"{good[0].upper()}{good[1:]}"
    return [sentences.get(i, good) for i in range(study.count)]


def warnings_of(study: Any) -> list[str]:
    """What each sample warns of."""
    warnings = study.warnings()
    return [" ".join(warnings.get(i, ())) for i in range(study.count)]


def doubtful_of(study: Any) -> list[str]:
    """The responses of each sample that its warnings concern."""
    affected = {name: set(study.affected_samples(name)) for name in study.responses}
    names = lambda i: ", ".join(name for name, samples in affected.items() if i in samples)
    return [names(i) for i in range(study.count)]


def summary_of(rows: list[dict[str, Any]]) -> Any:
    """The table of such rows."""
    return as_table(rows, units={"yield": "1", "Cpk": "1"})


def coverage_of_deviation(values: np.ndarray) -> float:
    """How often, about, Student's 95 % interval of a standard deviation holds it, by the skewness
    and kurtosis of the squares that it is the mean of: the second term of Edgeworth's expansion. Of
    what few samples decide, that is far less; an interval that counts skewness holds it more often.

    Source: Hall 1988, Ann. Stat. 16, 927, doi:10.1214/aos/1176350933, section 2 (two-sided).
    """
    squares = (values - values.mean()) ** 2
    away = squares - squares.mean()
    spread = float(np.sqrt(np.mean(away**2)))
    # What differs by rounding only has no shape.
    if len(values) < 2 or spread <= ROUNDING * float(squares.mean()):
        return CONFIDENCE
    skewness, kurtosis = (float(np.mean((away / spread) ** power)) for power in (3, 4))
    z = float(scipy.special.ndtri(0.5 + 0.5 * CONFIDENCE))
    density = math.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)
    shape = skewness**2 * (z**4 + 2 * z**2 - 3) / 18 - (kurtosis - 3) * (z**2 - 3) / 12
    return min(CONFIDENCE - 2 * z * density * shape / len(values), CONFIDENCE)


def samples_that_bound(share: float, groups: int) -> float:
    """So many independent samples, of so many scramblings, bound the quantile of a share [1] on
    both sides: their interval leaves a sample beyond it. Of one scrambling none do."""
    if groups < 2:
        return math.inf
    tail = min(share, 1 - share)
    width = student(groups) * math.sqrt(1 - tail)
    return math.ceil((0.5 * (width + math.sqrt(width**2 + 4))) ** 2 / tail)


def remarks_of(study: Any, summary: Any) -> tuple[str, ...]:
    """What is to be known of the intervals in a summary: quantiles that the samples do not bound,
    deviations that few samples decide."""
    names, groups = list(summary["response"]), len(np.unique(study.scrambling))
    open_: dict[tuple[str, ...], list[str]] = {}
    for label in PERCENTILES:
        pairs = zip(names, summary[label], summary[f"{label} error"], strict=True)
        infinite = tuple(n for n, value, error in pairs if np.isfinite(value) and np.isinf(error))
        open_.setdefault(infinite, []).append(label)
    sentences = []
    for infinite, labels in open_.items():
        enough = max(samples_that_bound(PERCENTILES[label], groups) for label in labels)
        more = f"; about {enough:.0f} are needed" if study.count < enough < np.inf else ""
        which = f"the {' and '.join(labels)} quantile{'s' if len(labels) > 1 else ''}"
        sentences += [
            f"{study.count} samples are too few for an interval of {which} of {listed(infinite)}"
            f"{more}."
        ] * bool(infinite)
    sentences += [remark_on_tails(name, study.good(name)[0]) for name in names]
    return tuple(filter(None, sentences))


def remark_on_tails(name: str, values: np.ndarray) -> str:
    """A sentence where a response has heavier tails than normal ones show by chance, and so the
    interval of its deviation holds it less often than is said; "" where not.

    Args:
        name: of the response.
        values: of its samples, shape (samples,).
    """
    count = len(values)
    if count < 2 or not np.all(np.isfinite(values)):
        return ""
    spread = float(values.std())
    away = (values - values.mean()) / spread if spread > 0 else np.zeros(count)
    kurtosis, coverage = float(np.mean(away**4)), coverage_of_deviation(values)
    # The standard error of a normal sample's kurtosis is sqrt(24 / n).
    chance = float(scipy.special.ndtri(0.5 + 0.5 * CONFIDENCE)) * math.sqrt(24 / count)
    if kurtosis - 3 <= chance or coverage >= PROMISED:
        return ""
    # What an interval misses is in inverse proportion to the samples.
    enough = count * (CONFIDENCE - coverage) / (CONFIDENCE - PROMISED)
    return (
        f'"{name}" has heavy tails (kurtosis {kurtosis:.2g}): the 95 % interval of its standard '
        f"deviation contains it in about {100 * max(coverage, 0.0):.0f} % of cases; for "
        f"{100 * PROMISED:.0f} % about {enough:.2g} samples are needed, or more if the tails are "
        "heavier than these."
    )


def spread_of(summary: Any) -> tuple[Any, ...]:
    """Of a summary what `print` shows: means with all that they may be off, deviations, how the
    responses spread; and a sentence for each bias that replicas do not resolve."""
    labels = ["mean", "mean error", "standard deviation", "standard deviation error", "5 %", "95 %"]
    if "bias" not in summary:
        return (summary[["response", "unit", *labels]],)
    table = summary[["response", "unit", *labels[:2], "numerical error", *labels[2:]]].copy()
    names = ("bias", "bias error", "mean error", "replicas")
    errors = [NumericalError(*row) for row in zip(*(summary[n] for n in names), strict=True)]
    table["mean error"] = [e.whole if e.is_resolved else e.sampling for e in errors]
    # Of the mean all that it may be off by; the summary tells by how much samples are short.
    every = {"mean": "mean, all errors", "mean error": "mean, all errors error"}
    pairs = zip(summary["response"], errors, strict=True)
    unresolved = [(n, e) for n, e in pairs if e.replicas and not e.is_resolved]
    units = dict(table.attrs.get("units", {}))
    renamed = as_table(table.rename(columns=every), units=units)
    return renamed, *(f'"{n}": {e.unresolved}' for n, e in unresolved)


def spread_in_words(summary: Any) -> list[str]:
    """Mean and deviation of each response with their 95 % errors and unit, as `print` shows them;
    none of a response without a finite mean."""
    table = spread_of(summary)[0]
    mean, error = [name for name in table if name.startswith("mean")][:2]
    deviation = "standard deviation"
    sentences = []
    for row in table.to_dict("records"):
        unit = "" if row["unit"] == "1" else f" {row['unit']}"
        middle = with_error(row[mean], row[error])
        spread = with_error(row[deviation], row[f"{deviation} error"])
        text = f'"{row["response"]}": mean {middle}{unit}, {deviation} {spread}{unit} (95 %).'
        sentences += [text] * bool(np.isfinite(row[mean]))
    return sentences
