"""A life as an answer: depth, volume and responses over cycles, how far they are to be trusted, and
after how many cycles one of them reaches a limit.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from jaxclear.ground.arguments import check_name, check_number
from jaxclear.ground.printing import LEAST_ERROR_SHARE, with_text_repr
from jaxclear.integrators.checks import Checks
from jaxclear.multibody.system import wearing_in
from jaxclear.results.response import depends_on
from jaxclear.results.state_history import State
from jaxclear.simulation.wear import Worn
from jaxclear.studies.answer import AbstractAnswer, Column, Stated, with_unit
from jaxclear.studies.life.settling import Settling
from jaxclear.studies.life.steps import Cells, Length, Node
from jaxclear.studies.problem import Problem

# A normal variable stays within this many deviations in 95 % of cases.
CONFIDENCE = 1.96
# Places between two stages at which a limit is looked for.
LOOKS = 64
# The slope of a response is taken over twice this share of the way between two stages.
SLOPE_OVER = 1e-3
DEPTH, VOLUME = "depth", "volume"
# The rate at which a life goes on is that over its last part, this share of it.
LAST = 0.1
HOUR = 3600.0
TINY = np.finfo(float).tiny


def _percent(error: float) -> str:
    """A relative error in words: one that is rounding is none to be seen."""
    least = LEAST_ERROR_SHARE
    return f"{100 * error:.2g} %" if not error < least else f"better than {100 * least:.4f} %"


# The depth of the deepest place of a surface, of its cells in a row; one program for all lives.
_deepest = jax.jit(lambda wear_map, row: wear_map.deepest(row.reshape(wear_map.cells)))


class Stage(NamedTuple):
    """A point of a life at which cycles were run: the `node` of the steps, and how the motion
    `settled` there."""

    node: Node
    settled: Settling


@with_text_repr
class Lifetime(NamedTuple):
    """Cycles after which a limit is reached (`inf` where it is not within the life that was asked
    for), half the width of a 95 % interval, and a sentence."""

    cycles: float
    error: float
    sentence: str

    def __str__(self) -> str:
        return self.sentence


class WearLife(AbstractAnswer):
    """The wear of a life. `stages` are the points at which cycles were run, `cells` say how depths
    stand in a row, `new` are the surfaces at its start; `requested_cycles` [cycles] and
    `accuracy` [1] as in the request; `ended` says why a life ended before its time, "" for one that
    did not; `simulated` cycles were run in all, `rejected` steps taken back; `checks` is the worst
    that any cycle found out about itself; `by_cells` [1]: the relative error that cells leave in
    the depth (None: not verified).
    """

    problem: Problem
    stages: tuple[Stage, ...]
    cells: Cells
    new: Worn
    checks: Checks
    requested_cycles: float = eqx.field(static=True)
    accuracy: float = eqx.field(static=True)
    ended: str = eqx.field(static=True)
    simulated: int = eqx.field(static=True)
    rejected: int = eqx.field(static=True)
    by_cells: float | None = eqx.field(static=True, default=None)

    @property
    def cycles(self) -> np.ndarray:
        """Cycles of machine life at the stages."""
        return np.array([stage.node.cycles for stage in self.stages])

    @property
    def lengths(self) -> tuple[Length, ...]:
        """The steps between the stages."""
        nodes = [stage.node for stage in self.stages]
        return tuple(Length(b.cycles - a.cycles, b.parts) for a, b in pairwise(nodes))

    @property
    def surfaces(self) -> tuple[tuple[str, str], ...]:
        """(joint, surface) of all that wears."""
        # In the order of JAX, as the cells are.
        return tuple(
            (joint, surface) for joint in sorted(self.new) for surface in sorted(self.new[joint])
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the cycles behind the life warn of."""
        return self.checks.warnings

    @property
    def errors(self) -> np.ndarray:
        """Error of the depth at each stage, as a share of it: what the steps may be off and the
        95 % interval of what noise has left, root mean squares over the cells, of the worst
        surface; of a verified life what cells leave. What hangs on the saving times of a cycle
        comes beside it (`by_saves`)."""
        return self._errors(0)

    @property
    def by_saves(self) -> np.ndarray:
        """By which share the depth that a cycle wears at each stage, root mean square over the
        cells of the worst surface, would be another one if surfaces were updated at every fourth of
        its saving times alone: between the cycles that are simulated they are updated at each. A
        bound of what the life is off: surfaces that wear on level some of it."""
        shares = []
        for stage in self.stages:
            other = np.concatenate(
                [np.ravel(leaf) for leaf in jax.tree.leaves(stage.settled.by_saves)]
            )
            sizes = self.cells.sizes(other), self.cells.sizes(stage.node.rate.wear)
            shares.append(float(self.cells.shares(*sizes).max(initial=0.0)))
        return np.array(shares)

    @property
    def errors_of_volume(self) -> np.ndarray:
        """The same of the volume lost."""
        return self._errors(1)

    def _errors(self, which: int) -> np.ndarray:
        """Of the depths (0) or of the volumes (1)."""
        first = self.stages[0].node
        errors = [node.errors(self.cells, first)[which] for node, _ in self.stages]
        of_cells = 0.0 if which or self.by_cells is None else self.by_cells
        return np.array([float(error.max(initial=0.0)) for error in errors]) + of_cells

    @property
    def error(self) -> float:
        """Error of the depth at the end, as a share of it."""
        return float(self.errors[-1])

    @property
    def quantities(self) -> dict[str, str]:
        """What a life tells of, with its unit: the largest depth and the whole volume lost, those
        of each surface, and the responses."""
        quantities = {}
        for joint, surface in self.surfaces:
            quantities[f"{DEPTH} {joint} {surface}"] = "m"
            quantities[f"{VOLUME} {joint} {surface}"] = "m^3"
        return {DEPTH: "m", VOLUME: "m^3"} | quantities | self.problem.units()

    def over_life(self, name: str, cycles: Any = None) -> np.ndarray:
        """A quantity at the stages, or after so many `cycles`."""
        check_name("quantity", name, self.quantities, " in this life")
        at = self.cycles if cycles is None else np.asarray(cycles, float)
        for end in (at.min(initial=0.0), at.max(initial=0.0)):
            self._within(end)
        function = self._function(name)
        return np.array([function(float(one)) for one in at.ravel()]).reshape(at.shape)

    def at_end(self, name: str) -> float:
        """A quantity after the last cycle."""
        return float(self.over_life(name, self.cycles[-1]))

    def worn(self, cycles: float | None = None) -> Worn:
        """Depth of all surfaces [m] after so many cycles, by joint and surface; at the end without
        a number."""
        at = self.cycles[-1] if cycles is None else cycles
        flat, back = ravel_pytree(self.new)
        row: Any = self._row_at()(self._within(at))[: len(flat)]
        return jax.tree.map(np.asarray, back(row))

    def state(self, cycles: float | None = None) -> State:
        """A start of a run on surfaces worn so far."""
        return State(self.worn(cycles))

    def until(self, name: str, limit: float) -> Lifetime:
        """After how many cycles a quantity first reaches a limit, in its unit: from "depth" (the
        largest of all), "volume", those of one surface, or a response. The error is what that of
        the depth, and for a response its noise and the way between stages, may shift it by."""
        check_name("quantity", name, self.quantities, " in this life")
        check_number("the limit", limit)
        unit, last = self.quantities[name], float(self.cycles[-1])
        function = self._function(name)
        at = first_crossing(function, self.cycles, float(limit))
        if at is None:
            sentence = (
                f"The {name} is {function(last):.4g} {unit} after {last:.4g} cycles and does not "
                f"reach {limit:.4g}"
            )
            far = last + self.cycles_ahead(name, float(limit))
            if np.isfinite(far) and not self.ended:
                sentence += f"; at its last rate it would after about {self._time(far, 2)}"
            return Lifetime(np.inf, np.nan, f"{sentence}. {self.ended}".rstrip())
        error = self._shift(name, at)
        reached = f"The {name} reaches {limit:.4g} {unit} after "
        return Lifetime(at, error, f"{reached}{self._time(at, 4, f' ± {error:.1g}')}.")

    def _time(self, cycles: float, digits: int, error: str = "") -> str:
        """Cycles in words, with their time at the frequency of the machine."""
        period = float(self.problem.duration)
        hours = cycles * period / HOUR
        return f"{cycles:.{digits}g}{error} cycles ({hours:.{digits}g} h at {1 / period:.4g} Hz)"

    def cycles_ahead(self, name: str, limit: float) -> float:
        """Cycles that a quantity takes from the end to a limit at its last rate.

        Args:
            name: name of the quantity.
            limit: the value [unit of the quantity].

        Returns:
            The number of cycles; infinite where it never gets there.
        """
        last = float(self.cycles[-1])
        before, now = self.over_life(name, [(1.0 - LAST) * last, last])
        ahead = LAST * last * (limit - now) / (now - before) if now != before else np.inf
        return float(ahead) if ahead > 0 else np.inf

    def _shift(self, name: str, at: float) -> float:
        """By how many cycles errors may shift the time at which a quantity has its value."""
        row, last = self._row_at(), float(self.cycles[-1])
        which = int(name.startswith(VOLUME))
        sizes = self.cells.means if which else self.cells.sizes
        after = min(max(int(np.searchsorted(self.cycles, at)), 1), len(self.cycles) - 1)
        step = SLOPE_OVER * float(self.cycles[after] - self.cycles[after - 1])
        low, high = max(at - step, 0.0), min(at + step, last)
        wear = np.abs(sizes(row(high) - row(low))) / (high - low)
        moved = _around(at, self.cycles, self._errors(which)) * np.abs(sizes(row(at) - row(0.0)))
        shift = float(np.max(np.divide(moved, wear, out=np.zeros_like(wear), where=wear > 0)))
        if name not in self.problem.response_names:
            return shift
        function = self._function(name)
        slope = abs(function(high) - function(low)) / (high - low)
        means, noise = np.array([stage.settled.responses()[name] for stage in self.stages]).T
        curved = abs(function(at) - float(np.interp(at, self.cycles, means)))
        error_of_length = CONFIDENCE * _around(at, self.cycles, noise) + curved
        return float(np.hypot(shift, error_of_length / slope)) if slope > 0 else np.inf

    def _function(self, name: str) -> Callable[[float], float]:
        """A quantity over cycles."""
        if name in self.problem.response_names:
            means = np.array([stage.settled.responses()[name][0] for stage in self.stages])
            curve = _monotone(self.cycles, means)
            return lambda at: float(curve(at))
        kind, _, surface = name.partition(" ")
        row, places = self._row_at(), self.surfaces
        indices = [i for i, place in enumerate(places) if surface in ("", " ".join(place))]
        if kind == DEPTH:
            wearing, parts = wearing_in(self.problem.mechanism), self.cells.surfaces
            maps = {i: wearing[places[i][0]].maps()[places[i][1]][0] for i in indices}
            return lambda at: max(float(_deepest(maps[i], row(at)[parts[i]])) for i in indices)
        areas = self.cells.full_areas[indices]
        return lambda at: float(np.dot(areas, self.cells.means(row(at))[indices]))

    def _row_at(self) -> Callable[[float], np.ndarray]:
        """Depths of all cells and mean depths of all surfaces, in a row, over cycles: volumes by
        cubics through them and their rates, and how deep cells are at a volume from the parts in
        which steps put it on."""
        from scipy.interpolate import CubicHermiteSpline

        nodes, cells = [stage.node for stage in self.stages], self.cells
        if len(nodes) < 2:
            return lambda at: nodes[0].depth
        means = np.array([cells.means(node.depth) for node in nodes])
        rates = np.array([cells.means(node.rate.wear) for node in nodes])
        volumes = CubicHermiteSpline(self.cycles, means, rates)
        rows = np.array([nodes[0].depth, *(row for node in nodes[1:] for row in node.path)])
        shapes = []
        for i, surface in enumerate(cells.surfaces):
            reached = rows[:, len(cells.areas) + i]
            new = np.flatnonzero(np.diff(reached, prepend=-np.inf) > 0)
            shapes.append((_monotone(reached[new], rows[new, surface]), reached[new[[0, -1]]]))

        def row(at: float) -> np.ndarray:
            mean = volumes(at)
            parts = [
                shape(np.clip(one, *ends)) for (shape, ends), one in zip(shapes, mean, strict=True)
            ]
            return np.concatenate([*parts, mean])

        return row

    def _within(self, cycles: Any) -> float:
        check_number("cycles of this life", cycles, at_least=0, at_most=float(self.cycles[-1]))
        return float(cycles)

    def sentence(self) -> str:
        """How far the life went, from how many cycles, how deep it has worn, and what limits the
        trust in it."""
        reached, deepest = float(self.cycles[-1]), self.at_end(DEPTH)
        back = f", {self.rejected} steps taken back" if self.rejected else ""
        text = f"{reached:.4g} cycles of machine life from {self.simulated} simulated ones{back}: "
        percents = [_percent(error) for error in (self.error, self.errors_of_volume[-1])]
        text += f"{deepest:.4g} m deep, known to {percents[0]}, the volume to {percents[1]}."
        text += (
            " The error by the size of cells is not included; verify=True adds it."
            if self.by_cells is None
            else ""
        )
        if self.ended:
            early = f"The life ended before its {self.requested_cycles:.4g} cycles: {self.ended}"
            text = f"{early} Until then, {text}"
        restless = sum(not stage.settled.periodic for stage in self.stages)
        if restless:
            text += (
                f" At {restless} of {len(self.stages)} stages no cycle is periodic: rates are "
                "means over cycles, and their noise is part of that error."
            )
        if self.error > self.accuracy:
            text += f" That is more than the {100 * self.accuracy:.2g} % asked for"
            text += "; with a larger `max_cycles` noise is less." if restless else "."
        by_saves = float(self.by_saves.max())
        if by_saves > self.accuracy:
            text += (
                " Between simulated cycles surfaces are updated at the saving times of a cycle; at "
                "a fourth of these a cycle would spread wear otherwise, by up to "
                f"{100 * by_saves:.2g} % of the depth of cells. Volumes do not depend on them."
            )
        return text

    def _summary(self):
        return self.sentence(), *self.warnings

    def is_affected(self, response: str) -> bool:
        """Whether a warning concerns this response."""
        function = self.problem.response[response]
        return any(
            worst > check.limit and depends_on(function, check.concerns)
            for check, worst, _, _ in self.checks.rows()
        )

    def _stated(self):
        over, responses = ("cycles",), self.problem.response_names
        columns = {"cycles": Column(over, self.cycles)}
        for name, unit in self.quantities.items():
            column = Column(over, self.over_life(name), unit, label=with_unit(name, unit))
            if name in responses:
                scatter = [stage.settled.responses()[name][1] for stage in self.stages]
                column = column._replace(error=scatter)
            columns[name] = column
        columns |= {
            "error of depth": Column(over, self.errors, "1"),
            "error of volume": Column(over, self.errors_of_volume, "1"),
            "by saving times": Column(over, self.by_saves, "1"),
            "periodic": Column(over, [stage.settled.periodic for stage in self.stages]),
        }
        for joint, surface in self.surfaces:
            dims = ("cycles", f"{joint}.{surface}.around", f"{joint}.{surface}.along")
            maps = [self.worn(at)[joint][surface] for at in self.cycles]
            columns[f"{joint}.{surface}.worn"] = Column(dims, np.stack(maps), "m")
        attributes = self.checks.attributes()
        return Stated("wear life", columns, self.problem, self.warnings, attributes, labelled=False)


def _around(at: float, cycles: np.ndarray, errors: np.ndarray) -> float:
    """The larger of the errors at the two stages around so many cycles."""
    after = min(int(np.searchsorted(cycles, at)), len(cycles) - 1)
    return float(max(errors[after], errors[max(after - 1, 0)]))


def _monotone(places: np.ndarray, values: np.ndarray) -> Callable:
    """A curve through values whose rates are not known, monotone where they are."""
    from scipy.interpolate import PchipInterpolator

    if len(values) > 1:
        return PchipInterpolator(places, values)
    return lambda at: values[0]


def first_crossing(
    function: Callable[[float], float], cycles: np.ndarray, limit: float
) -> float | None:
    """Number of cycles at which a function first reaches a limit; None where it does not.

    Args:
        function: of a number of cycles.
        cycles: ends of the steps between which it is smooth.
        limit: in the function's unit.
    """
    from scipy.optimize import brentq

    shares = np.arange(LOOKS) / LOOKS
    parts = [a + (b - a) * shares for a, b in pairwise(cycles)]
    places = np.concatenate([*parts, cycles[-1:]])
    excess = np.array([function(float(place)) for place in places]) - limit
    if excess[0] == 0:
        return float(places[0])
    crossed = np.flatnonzero(np.sign(excess[1:]) != np.sign(excess[0]))
    if not len(crossed):
        return None
    first = crossed[0]
    return float(brentq(lambda at: function(at) - limit, places[first], places[first + 1]))
