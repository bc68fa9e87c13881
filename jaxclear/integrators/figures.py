"""What a run has found out about itself: the figures by which it is judged, each beside its limit,
as a table, as sentences, and of many samples at once.
"""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxclear.ground.quantity import is_traced
from jaxclear.ground.shown import AbstractShown
from jaxclear.ground.table import as_table
from jaxclear.integrators.checks import Check

# So large a figure is that of a run which grew without bound.
RAN_AWAY = 1e6


class Figure(eqx.Module):
    """The worst of a figure at each of its `places`, and at what `time` [s] its saving interval
    ended."""

    worst: Float[Array, "*batch places"]
    time: Float[Array, "*batch places"]
    places: tuple[str, ...] = eqx.field(static=True)


class Checks(AbstractShown):
    """The figures by which a run is judged. `print` shows them as a table; `warnings` are the
    sentences of those beyond their limits. After `jax.vmap` every array has the samples in front:
    `beyond` and `any_beyond` stay arrays, the rest is for one run.

    Of all figures together it holds the `worst` and the `time` [s]: a short run would pay for every
    array that it hands over. `named`: the checks in order, each with the names of its places.
    """

    worst: Float[Array, "*batch all_places"] = eqx.field(default_factory=lambda: np.zeros(0))
    time: Float[Array, "*batch all_places"] = eqx.field(default_factory=lambda: np.zeros(0))
    named: tuple[tuple[Check, tuple[str, ...]], ...] = eqx.field(static=True, default=())

    def __check_init__(self):
        columns = self.worst.shape[-1], self.time.shape[-1]
        named = sum(len(places) for _, places in self.named)
        if columns != (named, named):
            raise ValueError(
                f"Checks has {columns[0]} figures and {columns[1]} times for {named} named places; "
                "it must have one of each for every place, in the same order."
            )

    @classmethod
    def of(cls, figures: Mapping[Check, Figure]) -> "Checks":
        """Of each figure by its check."""
        if not figures:
            return cls()
        together = jnp if is_traced(figures) else np
        rows = zip(*((figure.worst, figure.time) for figure in figures.values()), strict=True)
        worst, time = (together.concatenate(row, axis=-1) for row in rows)
        return cls(worst, time, tuple((check, own.places) for check, own in figures.items()))

    @property
    def figures(self) -> dict[Check, Figure]:
        """Each figure by its check."""
        found, start = {}, 0
        worst: Any = self.worst
        time: Any = self.time
        # JAX takes long to give a part of an array, NumPy does not.
        if not is_traced((worst, time)):
            worst, time = np.asarray(worst), np.asarray(time)
        for check, places in self.named:
            own = slice(start, start + len(places))
            found[check] = Figure(worst[..., own], time[..., own], places)
            start = own.stop
        return found

    def beyond(self) -> dict[Check, Bool[Array, "*batch"]]:
        """For each figure whether it is beyond its limit anywhere; samples stay in front."""
        return {
            check: (figure.worst > check.limit).any(axis=-1)
            for check, figure in self.figures.items()
        }

    def any_beyond(self) -> Bool[Array, "*batch"]:
        """Whether any figure is beyond its limit."""
        found = jnp.zeros((), bool)
        for beyond in self.beyond().values():
            found = found | beyond
        return found

    def of_sample(self, index: int) -> "Checks":
        """The figures of one sample of many."""
        return jax.tree.map(lambda array: array[index], self)

    def attributes(self) -> dict[str, str]:
        """Each figure of one run beside its limit, by name, as text that goes with saved data."""
        return {
            f"check_{check.name.lower()}": f"{worst:.6g} (limit {check.limit:g})"
            + (f", joint {place}" if place else "")
            for check, worst, place, _ in self.rows()
        }

    def rows(self) -> list[tuple[Check, float, str, float]]:
        """(check, worst figure, its place, when [s]) of each figure of one run."""
        out = []
        for check, figure in self.figures.items():
            worst = np.asarray(figure.worst)
            at = int(np.argmax(worst))
            out.append((check, float(worst[at]), figure.places[at], float(figure.time[at])))
        return out

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each figure beyond its limit; empty for a clean run."""
        return tuple(_sentence(*row) for row in self._told())

    @property
    def before_the_end(self) -> tuple[str, ...]:
        """The warnings of a run that ended early but for those of figures that grew without bound
        with it: what was beyond its limit before may tell why."""
        return tuple(_sentence(*row) for row in self._told() if row[1] < RAN_AWAY)

    def _told(self) -> list[tuple[Check, float, str]]:
        """(check, worst figure, its place) of those beyond their limits."""
        return [row[:3] for row in self.rows() if row[1] > row[0].limit]

    def table(self) -> Any:
        """A pandas table: figure, unit, limit, where and when [s] the worst was met, what it
        concerns, whether it is within its limit."""
        return as_table(
            [
                {
                    "check": check.label,
                    "figure": worst,
                    "limit": check.limit,
                    "unit": check.unit,
                    "joint": place or "-",
                    "time [s]": time,
                    "concerns": check.concerns,
                    "within": worst <= check.limit,
                }
                for check, worst, place, time in self.rows()
            ]
        )

    def _shown(self):
        if not self.named:
            return "This run had nothing to check."
        return (self.table().drop(columns="time [s]"),)


def _sentence(check: Check, worst: float, place: str) -> str:
    said = check.sentence.format(figure=worst, place=place, limit=check.limit)
    return f"{said[0].upper()}{said[1:]}."
