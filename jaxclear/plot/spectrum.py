"""What frequencies a motion or a force holds."""

from typing import Any

import numpy as np

from jaxclear.ground.answering import answering
from jaxclear.ground.arguments import check_count, check_number
from jaxclear.plot.canvas import panels, readable, warned
from jaxclear.plot.signal import reached, signal
from jaxclear.results.trajectory import Trajectory

__all__ = ["spectral_density", "spectrum"]

# Saving times count as evenly spread within this share of their distance.
EVEN = 1e-6
# The least number of saving times in a segment, and how many harmonics are marked.
FEWEST, HARMONICS = 8, 10


def spectral_density(time: np.ndarray, values: np.ndarray, segments: int) -> tuple:
    """(frequencies [Hz], one-sided power spectral density [unit^2/Hz]) by Welch's method: Hann
    windows that overlap by half, each without its mean. Raises `ValueError` unless the times are
    evenly spread."""
    from scipy.signal import welch

    steps = np.diff(time)
    if len(time) < FEWEST or np.ptp(steps) > EVEN * steps.mean() * len(time):
        raise ValueError(
            "a spectrum needs saving times that are evenly spread, at least "
            f"{FEWEST} of them; simulate with save=a number of them."
        )
    length = max(2 * len(time) // (segments + 1), FEWEST)
    return welch(values, 1.0 / steps.mean(), window="hann", nperseg=min(length, len(time)))


@answering
def spectrum(
    run: Trajectory,
    of: str,
    axis: str | None = None,
    *,
    since: float = 0.0,
    period: float | None = None,
    segments: int = 3,
    ax: Any = None,
) -> Any:
    """Root of the power spectral density over frequency, by Welch's method: of a body the place
    "x", "y", "z" or the "turn" about z (ground frame), of a joint those of the child's marker in
    the parent's axes, or the normal "force" of its contacts.

    `since` [s]: from when on. `period` [s] of the drive: its harmonics are marked. `segments`:
    means over so many halves that overlap; more are smoother and tell frequencies less apart.
    `ax`: axes to draw in. Raises `ValueError` for saving times that are not evenly spread.
    """
    own = signal(run, of, axis)
    check_number("since of spectrum", since, "s")
    check_count("segments of spectrum", segments)
    if period is not None:
        check_number("period of spectrum", period, "s", above=0)
    kept = reached(run, since)
    frequency, density = spectral_density(own.time[kept], own.values[kept], segments)
    root = np.sqrt(density[1:])
    factor, unit = readable(root, own.unit)
    sheet = panels("spectrum", ax, size=(7.0, 4.4))
    sheet.one.loglog(frequency[1:], factor * root, lw=1.0, color="C0")
    if period is not None:
        for number in range(1, HARMONICS + 1):
            if number / period < frequency[-1]:
                sheet.one.axvline(number / period, color="0.75", lw=0.6, zorder=0)
    sheet.one.set_xlabel("frequency [Hz]")
    sheet.one.set_ylabel(rf"root of spectral density [{unit}/$\sqrt{{\mathrm{{Hz}}}}$]")
    marked = "" if period is None else f", harmonics of {1 / period:.4g} Hz in grey"
    sheet.title(f"Spectrum of the {own.label}{marked}")
    return warned(sheet, {"": run})
