"""Several models of the same machine: which of them the records speak against, and what those that
remain say together.

Of models that explain records equally well each tells an interval under its own assumption; the
interval without that assumption holds all of theirs.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy

from jaxclear.studies.identification.signal_fit import REFUSED, CredibleInterval, SignalFit


class ModelChoice(NamedTuple):
    """`models`: names of those that the records do not speak against, the nearest first;
    `against`: a sentence by name of each other."""

    models: tuple[str, ...]
    against: dict[str, str]


def choose_models(fits: Mapping[str, Sequence[SignalFit]]) -> ModelChoice:
    """Which models stay, by their fits of each record. One is left out where a record refuses it,
    or where the nearest is so much nearer that one right model in a thousand would be."""
    against = {}
    for name, model_fits in fits.items():
        refused = [fit.refusal for fit in model_fits if fit.refusal]
        if refused:
            against[name] = refused[0]
    order = sorted((name for name in fits if name not in against), key=lambda n: _log_size(fits[n]))
    retained = order[:1]
    for name in order[1:]:
        extra_unknowns = len(fits[name][0].best) - len(fits[order[0]][0].best)
        limit = float(scipy.stats.chi2.isf(REFUSED, max(abs(extra_unknowns), 1)))
        ratio = sum(map(_log_ratio, fits[name], fits[order[0]]))
        if ratio <= limit:
            retained.append(name)
        else:
            against[name] = (
                f'"{order[0]}" is nearer to what was measured: twice the logarithm of the ratio of '
                f"their likelihoods is {ratio:.3g}, where {limit:.3g} is the most of equals."
            )
    return ModelChoice(tuple(retained), against)


def _log_size(fits: Sequence[SignalFit]) -> float:
    """What is left of the records, as a logarithm."""
    return float(sum(np.log(misfit.size) for fit in fits for misfit in fit.misfits.values()))


def _log_ratio(fit: SignalFit, nearest: SignalFit) -> float:
    """Twice the logarithm of the likelihood ratio to the nearest model, of noise of any size."""
    return float(
        sum(
            2.0
            * misfit.samples
            / max(misfit.time, nearest.misfits[name].time)
            * np.log(misfit.size / nearest.misfits[name].size)
            for name, misfit in fit.misfits.items()
        )
    )


def hull(estimates: Sequence[CredibleInterval]) -> CredibleInterval:
    """The interval that holds those that each model tells of one unknown, or of a response."""
    values = np.array([estimate.value for estimate in estimates])
    deviation = np.sqrt(np.mean([estimate.deviation**2 for estimate in estimates]) + values.var())
    return CredibleInterval(
        float(values.mean()),
        min(estimate.low for estimate in estimates),
        max(estimate.high for estimate in estimates),
        float(deviation),
        min(estimate.prior_low for estimate in estimates),
        max(estimate.prior_high for estimate in estimates),
    )
