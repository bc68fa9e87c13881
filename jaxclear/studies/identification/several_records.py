"""What several records tell of the next one: an unknown may differ from record to record, and the
differences between records are the interval, not what each tells of itself.

An estimate by record is a draw about a mean; with so many records the next one follows Student's t.
Where each record by itself tells less than the records differ, that is what is believed: errors of
a model that all records share do not show between them.

Source: Gelman and others 2013, Bayesian Data Analysis, 3rd ed., sections 3.2 and 5.4 (a predictive
Student's t of a normal sample; random effects).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from jaxclear.studies.identification.signal_fit import CredibleInterval

# Of two records nothing is known of how records differ but their one difference; an interval of
# Student's t is 6.5 times that of many records then, and 2.2 times with three.
FEWEST = 2


class NextRecord(NamedTuple):
    """An unknown in a record yet to come: `value`, `low` and `high` (95 %) in its unit; `between`,
    the standard deviation between records, and `within`, that which a record tells of itself;
    `freedom` [1] of Student's t."""

    value: float
    low: float
    high: float
    between: float
    within: float
    freedom: int

    @property
    def scale(self) -> float:
        """Of Student's t."""
        return _scale(self.between, self.within, self.freedom + 1)


def _scale(between: float, within: float, records: int) -> float:
    return float(max(between, within) * np.sqrt(1.0 + 1.0 / records))


def next_record(estimates: Sequence[CredibleInterval]) -> NextRecord:
    """An unknown, or a response, in the next record, from what each record (two at least) tells of
    it."""
    values = np.array([estimate.value for estimate in estimates])
    within = float(np.sqrt(np.mean([estimate.deviation**2 for estimate in estimates])))
    between, freedom = float(values.std(ddof=1)), len(values) - 1
    half = scipy.stats.t.ppf(0.975, freedom) * _scale(between, within, len(values))
    middle = float(values.mean())
    return NextRecord(middle, middle - half, middle + half, between, within, freedom)


def interval_of(estimates: Sequence[CredibleInterval]) -> CredibleInterval:
    """What one record tells; what several tell of the next."""
    if len(estimates) < FEWEST:
        return estimates[0]
    interval = next_record(estimates)
    deviation = max(interval.between, interval.within)
    ends = estimates[0].prior_low, estimates[0].prior_high
    return CredibleInterval(interval.value, interval.low, interval.high, deviation, *ends)
