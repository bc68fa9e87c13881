"""What a Monte Carlo study tells of one response, in a row."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxclear.ground.shown import in_digits
from jaxclear.studies.statistics.limits import Limits
from jaxclear.studies.statistics.scrambled import UNKNOWN, deviation, standard_error

PERCENTILES = {"5 %": 0.05, "median": 0.5, "95 %": 0.95}


def summary_row(study: Any, name: str, limits: Mapping[str, Limits]) -> dict[str, Any]:
    """The row of a response in the summary of a study (`MonteCarlo`)."""
    values, group = study.good(name)
    warned = study.concerned(name)
    clean = np.setdiff1d(np.setdiff1d(np.arange(study.count), study.failed), warned)
    clean = study.responses[name][clean]
    # Of infinite answers, as lives may be, there is no mean, nor a deviation.
    bounded = bool(np.all(np.isfinite(values)))
    known = {"mean": study.mean(name) if bounded else UNKNOWN}
    error = standard_error(np.mean, values, group)[0] if bounded and len(values) else np.nan
    row = {
        "response": name,
        "unit": study.problem.units()[name],
        "samples": len(values),
        "failed": len(study.failed),
        "warned": len(warned),
        "mean": known["mean"].value,
        "standard error": error,
    }
    known["standard deviation"] = study.standard_deviation(name) if bounded else UNKNOWN
    known |= {label: study.quantile(name, share) for label, share in PERCENTILES.items()}
    if name in limits:
        known["yield"] = study.share_within({name: limits[name]})
        known["Cpk"] = study.process_capability(name, limits[name]) if bounded else UNKNOWN
    for label, told in known.items():
        row[label] = told.value
        row[f"{label} error"] = told.error
    row["mean without warned"] = clean.mean() if bounded and len(clean) else np.nan
    row["standard deviation without warned"] = deviation(clean) if bounded else np.nan
    if study.problem.endless(name):
        row["infinite"] = int(np.isinf(values).sum())
    return row


def in_sentences(summary: Any) -> list[str]:
    """The rows of a summary, errors at 95 %."""
    return [_in_a_sentence(row) for row in summary.to_dict("records")]


def _in_a_sentence(row: Mapping[str, Any]) -> str:
    spread = row["standard deviation"]
    low, high = (in_digits(row[share], 0.1 * spread) for share in ("5 %", "95 %"))
    return (
        f'"{row["response"]}" [{row["unit"]}]: mean {in_digits(row["mean"], row["mean error"])} ± '
        f"{row['mean error']:.2g}, standard deviation {spread:.4g} ± "
        f"{row['standard deviation error']:.2g}; 5 % below {low}, 5 % above {high}."
    )
