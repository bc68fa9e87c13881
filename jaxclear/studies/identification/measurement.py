"""A record of a machine: what its sensors showed over time, and how turns are told."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from jaxclear.ground.arguments import check_name, check_number, expect
from jaxclear.ground.columns import columns_of
from jaxclear.ground.printing import AbstractShown
from jaxclear.ground.table import as_table
from jaxclear.ground.wording import described, listed
from jaxclear.studies.sensor import AbstractSensor, Encoder, Series

# Times that stand equally but for this share of their interval are equally spaced.
EVEN = 0.01
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


class Measurement(AbstractShown):
    """Signals that sensors recorded at common times.

    Times that are not equally spaced are resampled along straight lines. A record is compared with
    the end of a run, apart from its last `cut_off`.

    Args:
        time: times [s], increasing, an array (samples,).
        signals: recorded signals by name, a dictionary of arrays (samples,), each in the unit of
            its sensor.
        sensors: sensor of each signal by its name, a dictionary of members of `jaxclear.sensor`.
        turn: what divides the record into turns: name of an `Encoder`'s signal, whose angle does at
            whole multiples of 2 pi, or the period [s], counted from the start of the record; None
            (default) where nothing turns.
        cut_off: time by which the record ends before the run [s], >= 0; 0 by default.

    Raises:
        ValueError: if an argument is wrong, or signals and sensors do not belong together.
    """

    time: np.ndarray
    signals: dict[str, np.ndarray]
    sensors: dict[str, AbstractSensor]
    turn: str | float | None = eqx.field(static=True)
    cut_off: float = eqx.field(static=True)

    def __init__(
        self,
        time: Any,
        signals: Mapping[str, Any],
        sensors: Mapping[str, AbstractSensor],
        turn: str | float | None = None,
        *,
        cut_off: float = 0.0,
    ):
        at = _column("time of a Measurement", time)
        if len(at) < 2 or np.any(np.diff(at) <= 0):
            raise ValueError("time of a Measurement must rise from sample to sample, two at least.")
        expect(signals, Mapping, "signals of a Measurement", "a dictionary from names to arrays")
        expect(sensors, Mapping, "sensors of a Measurement", "a dictionary from names to sensors")
        if not signals or set(signals) != set(sensors):
            raise ValueError(
                f"a Measurement has signals {listed(signals) or 'none'} and sensors "
                f"{listed(sensors) or 'none'}; each signal needs its sensor, and there must be one."
            )
        columns = {name: _column(f'signal "{name}"', values) for name, values in signals.items()}
        for name, values in columns.items():
            if len(values) != len(at):
                raise ValueError(
                    f'signal "{name}" has {len(values)} samples, and there are {len(at)} times.'
                )
            expected = 'one of jaxclear.sensor, such as Accelerometer("slider", axis="x")'
            expect(sensors[name], AbstractSensor, f'the sensor of signal "{name}"', expected)
        even = np.linspace(at[0], at[-1], len(at))
        if np.max(np.abs(at - even)) > EVEN * (even[1] - even[0]):
            columns = {name: np.interp(even, at, values) for name, values in columns.items()}
        self.time, self.signals = even, columns
        self.sensors = {name: sensors[name] for name in columns}
        if isinstance(turn, str):
            check_name("signal", turn, columns, " of the Measurement to tell its turns")
            expect(sensors[turn], Encoder, f'the sensor of signal "{turn}"', "an Encoder")
        elif turn is not None:
            check_number("turn of a Measurement", turn, "s", above=0)
        self.turn, self.cut_off = turn, cut_off

    @classmethod
    def read_csv(
        cls,
        path: str | Path,
        *,
        time: str,
        signals: Mapping[str, AbstractSensor],
        turn: str | float | None = None,
        time_unit: str = "s",
    ) -> "Measurement":
        """Read a record from a text file whose first line names its columns.

        Columns are separated by commas, semicolons or tabs.

        Args:
            path: path of the file.
            time: name of the column of times.
            signals: sensor of each column to read, a dictionary by name of the column, each in the
                unit of its sensor.
            turn: what divides the record into turns, a name or a period [s], as of `Measurement`.
            time_unit: unit of the times, "s" (default), "ms" or "us".

        Returns:
            The `Measurement`.

        Raises:
            ValueError: if there is no such file, column or unit, or the record is invalid.
        """
        check_name("unit", time_unit, UNITS, " of time")
        at, *values = columns_of(path, (time, *signals))
        columns = dict(zip(signals, values, strict=True))
        return cls(UNITS[time_unit] * at, columns, signals, turn)

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return float((len(self.time) - 1) / (self.time[-1] - self.time[0]))

    @property
    def lasts(self) -> float:
        """Duration from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def compared(self) -> "Measurement":
        """The record without the signals that are inputs of the machine."""
        names = [n for n, s in self.sensors.items() if isinstance(s, Series) and s.is_input]
        if not names:
            return self
        signals = {name: values for name, values in self.signals.items() if name not in names}
        sensors = {n: self.sensors[n] for n in signals}
        return Measurement(self.time, signals, sensors, self.turn, cut_off=self.cut_off)

    def part(self, begin: float, end: float) -> "Measurement":
        """The samples between two times.

        The part is compared with the same part of a run, so that turns may be cut anywhere.

        Args:
            begin: first time [s].
            end: last time [s].

        Returns:
            The `Measurement`.
        """
        inside = (self.time >= begin) & (self.time <= end)
        signals = {name: values[inside] for name, values in self.signals.items()}
        at = self.time[inside]
        cut_off = self.cut_off + float(self.time[-1] - at[-1]) if len(at) else 0.0
        return Measurement(at, signals, self.sensors, self.turn, cut_off=cut_off)

    def _summary(self):
        rows = [
            {
                "signal": name,
                "sensor": type(self.sensors[name]).__name__,
                "least": float(values.min()),
                "largest": float(values.max()),
                "standard deviation": float(values.std()),
            }
            for name, values in self.signals.items()
        ]
        what = f"Measurement of {self.lasts:.6g} s at {self.rate:.6g} Hz, {len(self.time)} samples"
        return what, as_table(rows)


def checked_records(data: Any) -> list[Measurement]:
    """One record or several, in a list. Raises `ValueError` with a sentence for anything else."""
    several = isinstance(data, Sequence) and not isinstance(data, str)
    records = list(data) if several else [data]
    for record in records:
        expect(record, Measurement, "data of identify", "a jaxclear.Measurement, or several")
    if not records:
        raise ValueError("data of identify holds no record; it must hold a jaxclear.Measurement.")
    return records


def _column(what: str, values: Any) -> np.ndarray:
    """Finite numbers in a row."""
    try:
        array = np.array(values, float)
    except (TypeError, ValueError):
        array = np.zeros((0, 0))
    if array.ndim != 1:
        raise ValueError(f"{what} is {described(values)}; it must be finite numbers in a row.")
    holes = np.flatnonzero(~np.isfinite(array))
    if len(holes):
        raise ValueError(
            f"{what} is {array[holes[0]]} at sample {holes[0] + 1} of {len(array)}, and not finite "
            f"at {len(holes)} in all; it must be finite numbers in a row. Interpolate there, "
            "or cut the record off before."
        )
    return array
