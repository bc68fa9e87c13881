"""How many independent samples a residual is worth: what a model leaves of a record is alike from
sample to sample, and fits and intervals that count each sample by itself are too sure.

Source: the time scale of correlated samples, Thiébaux & Zwiers 1984, J. Clim. Appl. Meteorol. 23,
800; where to end its sum, Geyer 1992, Stat. Sci. 7, 473, doi:10.1214/ss/1177011137.
"""

import numpy as np


def correlation_time(residual: np.ndarray) -> float:
    """Samples (at least 1) that one independent sample of a residual (n,) is worth:
    1 + 2 (sum of its autocorrelations until the first that is not positive)."""
    centred = np.asarray(residual, float) - np.mean(residual)
    count, power = len(centred), centred @ centred
    if count < 2 or power <= 0.0:
        return 1.0
    # Twice as long with zeros, so that the transform's circle does not close.
    spectrum = np.abs(np.fft.rfft(centred, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum, 2 * count)[:count] / power
    ends = np.flatnonzero(correlation <= 0.0)
    last = ends[0] if len(ends) else count
    return float(1.0 + 2.0 * correlation[1:last].sum())
