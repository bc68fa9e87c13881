"""What numbers say of a signal: `jaxclear.signal`, the statistics that diagnostics of machines use.

A `Signal` holds one or many signals of equal sampling and, where an encoder or the period tells it,
the same cut into turns and sampled anew over the angle (order tracking). Every statistic takes a
`Signal` and returns an array (signals, numbers). All but `levels` are taken relative to the mean
cycle's own size, so that a gain changes nothing; what is positive is told by its natural logarithm.

Source: McFadden & Toozhy 2000, Mech. Syst. Signal Process. 14, 981, doi:10.1006/mssp.2000.1309
(synchronous average); Fyfe & Munck 1997, Mech. Syst. Signal Process. 11, 187,
doi:10.1006/mssp.1996.0056 (order tracking); Randall 2011, Vibration-based Condition Monitoring,
doi:10.1002/9780470977668 (the others).
"""

import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxclear.ground.argument_errors import nothing_else

__all__ = [
    "Signal",
    "band_energies",
    "by_turns",
    "impact_rate",
    "jerk_quantiles",
    "levels",
    "order_spectrum",
    "peaks",
    "spread_by_phase",
    "synchronous_average",
    "usual_statistics",
]
__getattr__, __dir__ = nothing_else("jaxclear.signal", __all__)

# Logarithms of what may be nothing begin here, as a share of the size of the mean cycle.
LEAST = 1e-6
# Shares of the jerks, and of the sizes, below which the quantiles lie.
JERKS = (0.25, 0.5, 0.75, 0.9, 0.95, 0.98, 0.99, 0.995, 0.999)
SIZES = (0.9, 0.99, 0.995, 0.999)
# A change between two samples by less than these shares of the mean cycle's size is quiet; by more
# than this many, an impact.
QUIET, IMPACT = (0.02, 0.05, 0.1), 1.0


class Signal(NamedTuple):
    """Signals of one sampling rate.

    Args:
        values: samples in the signal's own unit, shape (signals, samples).
        rate: sampling rate [Hz], > 0.
        turns: the same signals over the angle, shape (signals, turns, samples per turn); None
            (default) where no angle is available.
    """

    values: np.ndarray
    rate: float
    turns: np.ndarray | None = None

    @property
    def size(self) -> np.ndarray:
        """Standard deviation of the mean cycle, shape (signals, 1).

        It is that of all samples without turns, and where the mean cycle has hardly any amplitude
        (below 1e-6 of it); it is 1 for a constant signal.
        """
        overall = self.values.std(axis=1, keepdims=True)
        cycle = overall if self.turns is None else self.turns.mean(1).std(axis=1, keepdims=True)
        # Of a cycle that is all noise, the whole.
        cycle = np.where(cycle > LEAST * overall, cycle, overall)
        return np.where(cycle > 0, cycle, 1.0)


def by_turns(
    values: np.ndarray, rate: float, angle: np.ndarray, turns: int, samples: int
) -> Signal:
    """Signals with their last whole turns, sampled anew over the angle (order tracking).

    Turns begin at whole multiples of 2 pi.

    Args:
        values: samples in the signal's own unit, shape (signals, samples).
        rate: sampling rate [Hz], > 0.
        angle: angle at each sample [rad], shape (samples,) or (signals, samples), increasing or
            decreasing throughout.
        turns: number of turns, >= 1.
        samples: number of samples per turn, >= 1.

    Returns:
        A `Signal` with `turns`.

    Raises:
        ValueError: if the angle passes through fewer whole turns.

    Source: Fyfe & Munck 1997, Mech. Syst. Signal Process. 11, 187, doi:10.1006/mssp.1996.0056.
    """
    resampled = np.empty((len(values), turns, samples))
    for i, (row, at) in enumerate(zip(values, np.broadcast_to(angle, values.shape), strict=True)):
        begin, end = full_turns(at)
        if end - begin < turns:
            raise ValueError(
                f"{turns} turns were asked for; the angle goes through {max(end - begin, 0)} whole "
                "ones."
            )
        forwards = at if at[-1] > at[0] else -at
        grid = 2 * math.pi * (end - turns + np.arange(turns * samples) / samples)
        resampled[i] = np.interp(grid, np.maximum.accumulate(forwards), row).reshape(turns, samples)
    return Signal(values, rate, resampled)


def full_turns(angle: np.ndarray) -> tuple[int, int]:
    """The first and the last boundary between turns that an angle passes.

    Args:
        angle: angle at each sample [rad], shape (samples,).

    Returns:
        Two whole numbers, as multiples of 2 pi; their difference is the number of whole turns.
    """
    ends = sorted((angle[0], angle[-1])) if angle[-1] > angle[0] else sorted(-angle[[0, -1]])
    slack = 1e-9
    return math.ceil(ends[0] / (2 * math.pi) - slack), math.floor(ends[1] / (2 * math.pi) + slack)


def synchronous_average(signal: Signal, bins: int = 32) -> np.ndarray:
    """The mean over the turns, relative to the size of the mean cycle [1].

    Args:
        signal: a `Signal` with turns.
        bins: number of equal parts of a turn, >= 1; 32 by default.

    Returns:
        Means, shape (signals, bins) (fewer where a turn has fewer samples).

    Raises:
        ValueError: if the signal has no turns.

    Source: McFadden & Toozhy 2000, Mech. Syst. Signal Process. 14, 981, doi:10.1006/mssp.2000.1309.
    """
    cycle = _require_turns(signal, "synchronous_average").mean(1)
    return _bin_cycle(cycle, bins) / signal.size


def spread_by_phase(signal: Signal, bins: int = 32) -> np.ndarray:
    """Logarithm of the standard deviation about the mean cycle, relative to the cycle's size [1].

    It shows in which part of a turn the motion does not repeat.

    Args:
        signal: a `Signal` with turns.
        bins: number of equal parts of a turn, >= 1; 32 by default.

    Returns:
        Natural logarithms, shape (signals, bins) (fewer where a turn has fewer samples).

    Raises:
        ValueError: if the signal has no turns.
    """
    turns = _require_turns(signal, "spread_by_phase")
    spread = turns.std(axis=1)
    return np.log(_bin_cycle(spread, bins) / signal.size + LEAST)


def order_spectrum(signal: Signal, bands: int = 24) -> np.ndarray:
    """Logarithm of the mean power in bands of orders, relative to the mean power of all [1].

    Orders are multiples of the speed of turning. All turns together are transformed, under a Hann
    window.

    Args:
        signal: a `Signal` with turns.
        bands: number of bands, equally wide in their logarithm, from order 1.5 to half the samples
            per turn; 24 by default. Bands narrower than a spectral line are merged.

    Returns:
        Natural logarithms, shape (signals, bands).

    Raises:
        ValueError: if the signal has no turns.
    """
    turns = _require_turns(signal, "order_spectrum")
    return _log_band_powers(turns.reshape(len(turns), -1), bands, 1.5 * turns.shape[1])


def band_energies(signal: Signal, bands: int = 24) -> np.ndarray:
    """Logarithm of the mean power in bands of frequency, relative to the mean power of all [1].

    The whole signal is transformed, under a Hann window.

    Args:
        signal: a `Signal`.
        bands: number of bands, equally wide in their logarithm, from four periods in the signal to
            half the sampling rate; 24 by default. Bands narrower than a spectral line are merged.

    Returns:
        Natural logarithms, shape (signals, bands).
    """
    return _log_band_powers(signal.values, bands, 4.0)


def jerk_quantiles(signal: Signal, shares: tuple[float, ...] = JERKS) -> np.ndarray:
    """Logarithms of quantiles of the change from sample to sample [1].

    The magnitude of the change is taken, relative to the size of the mean cycle. For an
    acceleration it is the jerk divided by the sampling rate.

    Args:
        signal: a `Signal`.
        shares: shares of the samples below each quantile [1], each between 0 and 1; nine from 0.25
            to 0.999 by default.

    Returns:
        Natural logarithms, shape (signals, shares).
    """
    quantiles = np.quantile(_jerks_of(signal), shares, axis=1).T
    return np.log(quantiles + LEAST)


def peaks(signal: Signal, shares: tuple[float, ...] = SIZES) -> np.ndarray:
    """Logarithms of large magnitudes of the signal, relative to the size of the mean cycle [1].

    Args:
        signal: a `Signal`.
        shares: shares of the samples below each quantile [1], each between 0 and 1; 0.9, 0.99,
            0.995, 0.999 by default.

    Returns:
        Shape (signals, shares + 2): natural logarithms of the quantiles of the magnitude; mean and
        standard deviation of the logarithm of the largest magnitude of each turn (of each sixteenth
        of the signal without turns).
    """
    sizes = np.abs(signal.values) / signal.size
    parts = signal.turns
    if parts is None:
        length = max(signal.values.shape[1] // 16, 1)
        values = signal.values[:, : signal.values.shape[1] // length * length]
        parts = values.reshape(len(values), -1, length)
    largest = np.log(np.abs(parts).max(2) / signal.size + LEAST)
    quantiles = np.log(np.quantile(sizes, shares, axis=1).T + LEAST)
    return np.column_stack([quantiles, largest.mean(1), largest.std(1)])


def impact_rate(signal: Signal) -> np.ndarray:
    """How many changes from sample to sample are small, and how many large ones begin [1].

    Args:
        signal: a `Signal`.

    Returns:
        Shape (signals, 4): the shares of samples that change by less than 0.02, 0.05 and 0.1 of the
        mean cycle's size, and the number of times that a change larger than that size begins,
        divided by the number of samples.
    """
    jerks = _jerks_of(signal)
    quiet = [(jerks < limit).mean(1) for limit in QUIET]
    hit = jerks > IMPACT
    return np.column_stack([*quiet, (hit[:, 1:] & ~hit[:, :-1]).mean(1)])


def levels(signal: Signal) -> np.ndarray:
    """Mean and logarithm of the standard deviation, in the signal's own unit.

    A gain or an offset changes these, and none of the other statistics.

    Args:
        signal: a `Signal`.

    Returns:
        Shape (signals, 2).
    """
    spread = signal.values.std(axis=1)
    return np.column_stack([signal.values.mean(1), np.log(spread + np.finfo(float).tiny)])


def usual_statistics(turns: bool) -> dict[str, Callable[[Signal], np.ndarray]]:
    """The statistics that `jaxclear.identify` uses by default.

    Args:
        turns: whether the signals have turns; the statistics over the angle then take the place of
            `band_energies`.

    Returns:
        Functions of a `Signal` by name.
    """
    over_angle = (synchronous_average, spread_by_phase, order_spectrum)
    specific = over_angle if turns else (band_energies,)
    every = (*specific, jerk_quantiles, peaks, impact_rate, levels)
    return {one.__name__.replace("_", " "): one for one in every}


def _require_turns(signal: Signal, owner: str) -> np.ndarray:
    if signal.turns is None:
        raise ValueError(
            f"signal.{owner} is of turns, and nothing tells these: give the Measurement its turn, "
            "the name of an encoder's signal or the period [s]."
        )
    return signal.turns


def _bin_cycle(cycle: np.ndarray, bins: int) -> np.ndarray:
    """Means over equal parts of a cycle."""
    parts = np.array_split(np.arange(cycle.shape[1]), bins)
    return np.stack([cycle[:, part].mean(1) for part in parts if len(part)], axis=1)


def _jerks_of(signal: Signal) -> np.ndarray:
    return np.abs(np.diff(signal.values, axis=1)) / signal.size


def _log_band_powers(values: np.ndarray, bands: int, first: float) -> np.ndarray:
    """Logarithms of mean powers in bands from the `first` line of the spectrum on."""
    count = values.shape[1]
    centred = values - values.mean(1, keepdims=True)
    power = np.abs(np.fft.rfft(centred * np.hanning(count), axis=1)) ** 2
    edges = np.unique(np.geomspace(first, power.shape[1] - 1, bands + 1).astype(int))
    mean = power[:, 1:].mean(1)
    mean = np.where(mean > 0, mean, 1.0)
    powers = [power[:, a:b].mean(1) / mean for a, b in itertools.pairwise(edges)]
    return np.log(np.stack(powers, axis=1) + LEAST * LEAST)
