"""From the losses of a cycle to the surfaces of a life: steps of many cycles with an error control.

The embedded pair of Bogacki and Shampine, carried on with its third-order answer. A stage is not a
rate of depth, which is stiff (a cell deeper than those beside it wears less at once), but what the
contacts of a cycle lose and where; a weighted sum of stages is put on the wall by its own law
(`Carry`), which levels cells as it goes. So steps are as long as the losses change slowly.

Volumes lost add up, and so do their errors: the estimate of a step is that of its second-order
answer; multiplied by 3.5 times the relative change of the losses over the step it is the error of
the third-order one, 1.75 times too large where wear dies away exponentially. What is too large for
losses that change smoothly is scatter; where shorter steps do not help they are taken. Of the shape
that a volume has taken a wall forgets: what it may be off is carried on by the wall's law, too.

An error is a root mean square over the cells of a surface, as a share of what it wears in the step,
of the worst surface: so the shares asked for are those of a whole life.

Source: Bogacki & Shampine 1989, Appl. Math. Lett. 2, 321, doi:10.1016/0893-9659(89)90079-7; sums of
stages put on by a flow as in Crouch & Grossman 1993, J. Nonlinear Sci. 3, 1,
doi:10.1007/BF02429858.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import diffrax
import numpy as np
import scipy

TABLEAU = diffrax.Bosh3.tableau
WEIGHTS, ERRORS = np.asarray(TABLEAU.b_sol), np.asarray(TABLEAU.b_error)
STAGES = tuple(np.asarray(row) for row in TABLEAU.a_lower)
# Of y' = -y the errors of third and second order are as 2 z to 1, z the change of the rate; the
# rest is a margin for steps in which z is not small.
OF_THIRD_ORDER = 3.5
# Error of a step, as a share of what it wears, beside the cube of the change of the rate: the same
# equation.
OF_CUBE = OF_THIRD_ORDER / 48.0
# Estimates of smooth rates are at most this share of what a step wears, times the square of the
# change of the rate (that of a law of square roots). What is more comes of rates that scatter
# about a smooth one; it is so many times smaller in the estimate than in the answer.
SMOOTH = 1 / 16
OF_SCATTER = float(np.linalg.norm(WEIGHTS) / np.linalg.norm(ERRORS))
# Once steps were found not to help, errors up to so many times the one found are told, not fought.
ACCEPTED_ERROR_RATIO = 2.0
# A step aims at this share of the error allowed, and is at most so many times the one before.
SAFETY, GROWTH, LEAST = 0.9, 5.0, 0.1
# A step is at most this share of one that was taken back, which grows so many times a step.
BELOW, WIDENS = 0.7, 1.3
# A step that is this many times too long is given up after its second rate.
HOPELESS = 2.0
# Noise that an estimate consists of within two standard errors is no error.
CONFIDENCE = 2.0
# So many cycles of a life may fail, each shortening its step, before it ends.
MOST_FAILURES = 6
# What a step loses is put on in so many parts, and in twice as many, in which half as much tells
# losses apart, until what these may still be off is less than this share of the tolerance, to which
# that adds 3 % as independent errors do: it costs no cycle. A loss has the pressure at its
# end, as in the implicit Euler method, and cycles go forwards and backwards by the same map, not by
# its adjoint: of first order (Hairer, Lubich & Wanner 2006, doi:10.1007/3-540-30666-8, II.3), so
# twice as many parts make an error twice as small, whatever few of them look like; where edges of a
# contact move, by the root of 2 at the least.
PARTS, MOST_PARTS, OF_TOLERANCE = 8, 64, 0.25
TIMES_SMALLER = np.sqrt(2.0), 2.0
# Where a step is looked at on its way: more often where a new wall wears fast.
FRACTIONS = (4**-4, 4**-3, 4**-2, 4**-1, 9 / 16)
# A surface that wears less than this share of the one that wears most is judged beside that, and a
# step that wears less than this share of what is worn so far.
NEGLIGIBLE = 0.01
# A normal variable stays within this many deviations in 95 % of cases; errors told are that many.
NORMAL = 1.96
# A spline is cubic where it has so many places. What an order extrapolates that three resolutions
# show counts so many times: Roache 1994, J. Fluids Eng. 116, 405, doi:10.1115/1.2910291.
PLACES, MARGIN = 5, 1.25
# Estimates so many times larger than those of smooth rates come of scatter.
CLEARLY = 1.3


class CycleFailed(RuntimeError):
    """A rate that does not exist; the sentence says why."""


class Rate(NamedTuple):
    """Depth [m] that a cycle wears in each cell (a row, `Cells`), its standard error, the number of
    cycles that it took to know it, and how the motion `settled` there."""

    wear: np.ndarray
    noise: np.ndarray
    cost: int
    settled: Any = None


# Cycles of each rate that surfaces are worn by.
Losses = Sequence[tuple[float, Rate]]


class Job(NamedTuple):
    """A row of depths that a `share` [1] of losses is put on, in so many parts."""

    row: np.ndarray
    losses: Losses
    parts: int
    share: float = 1.0


class Cells(NamedTuple):
    """How the depths of a life stand in one row: the cells of one surface after the other, and
    behind them for each surface the mean depth that its lost volume makes, whose noise is far less
    than that of the cells. `areas` [m2] of all cells."""

    surfaces: tuple[slice, ...]
    areas: np.ndarray

    @property
    def full_areas(self) -> np.ndarray:
        """Area [m2] of each surface."""
        return np.array([self.areas[surface].sum() for surface in self.surfaces])

    def means(self, row: np.ndarray) -> np.ndarray:
        """Mean depth of each surface, as its lost volume has it."""
        return row[len(self.areas) :]

    def sizes(self, row: np.ndarray) -> np.ndarray:
        """Root mean square over the cells of each surface."""
        squares = self.areas * row[: len(self.areas)] ** 2
        return np.sqrt([squares[surface].sum() for surface in self.surfaces] / self.full_areas)

    def shares(self, errors: np.ndarray, of: np.ndarray) -> np.ndarray:
        """Errors of each surface as shares of something else of it."""
        scale = np.maximum(np.abs(of), NEGLIGIBLE * np.abs(of).max(initial=0.0))
        return np.divide(np.abs(errors), scale, out=np.zeros(len(scale)), where=scale > 0)

    def shape(self, row: np.ndarray, of: np.ndarray) -> np.ndarray:
        """What a row has beyond the shape of another one, as deep on the whole: of cells alone."""
        part = self.means(row) / np.where(self.means(of) == 0, 1.0, self.means(of))
        return (row - of * self.each(part))[: len(self.areas)]

    def each(self, values: np.ndarray) -> np.ndarray:
        """A row that has at all cells of a surface, and at its mean, the value of that surface."""
        counts = [surface.stop - surface.start for surface in self.surfaces]
        return np.concatenate([np.repeat(values, counts), values])


class Node(NamedTuple):
    """A point of a life: after so many `cycles` the `depth` (a row [m]) and the `rate`. Of the mean
    depth of each surface since the start what steps may be off (`error` [m]) and the `variance`
    [m2] that noise has left; of the shape of cells what steps (`shape`) and noise (`noise`) may
    have left [m]. `path`: rows on the way from the node before."""

    cycles: float
    depth: np.ndarray
    rate: Rate
    error: np.ndarray
    variance: np.ndarray
    shape: np.ndarray
    noise: np.ndarray
    path: tuple[np.ndarray, ...] = ()
    parts: int = 0

    @classmethod
    def first(cls, depth: np.ndarray, rate: Rate, cells: Cells) -> "Node":
        """The node at the start of a life.

        Args:
            depth: of all cells [m].
            rate: of wear there.
            cells: of all surfaces.
        """
        none, flat = np.zeros(len(cells.surfaces)), np.zeros(len(cells.areas))
        return cls(0.0, depth, rate, none, none, flat, flat)

    def deviations(self, cells: Cells, start: "Node") -> tuple[np.ndarray, np.ndarray]:
        """Standard deviation that noise leaves, of each surface as a share of its depth and of its
        volume."""
        grown = self.depth - start.depth
        volume = cells.shares(np.sqrt(self.variance), cells.means(grown))
        return np.hypot(volume, cells.shares(cells.sizes(self.noise), cells.sizes(grown))), volume

    def errors(self, cells: Cells, start: "Node") -> tuple[np.ndarray, np.ndarray]:
        """What each surface may be off, as a share of its depth and of its volume, noise with
        95 %."""
        grown, noise = self.depth - start.depth, self.deviations(cells, start)
        volume = cells.shares(self.error, cells.means(grown))
        depth = volume + cells.shares(cells.sizes(self.shape), cells.sizes(grown))
        return depth + NORMAL * noise[0], volume + NORMAL * noise[1]


class Stepped(NamedTuple):
    """Nodes of a life, how many steps were taken back, and why it ended before its time; ""."""

    nodes: tuple[Node, ...]
    rejected: int
    ended: str


class Length(NamedTuple):
    """Of a step: cycles, and in how many parts its losses were put on (0: it was one cycle)."""

    cycles: float
    parts: int


class Trial(NamedTuple):
    """A step that was tried, kept or taken back: the node `after` it; what the volume of each
    surface may be off by the estimate, as `shares` of what is lost in the step, beyond what `noise`
    explains (shares too), up to which share it is `smooth`, and how much such a share `counts`
    [1]."""

    after: Node
    shares: np.ndarray
    noise: np.ndarray
    smooth: float
    counts: float


class Machine(NamedTuple):
    """What a life is of. `evaluate`: a row of depths -> the rate there. `carry`: of each
    of some jobs the row that the wall's law makes of it. `halves`: of a rate that is a mean over
    cycles two, by half of them each, that wear as much; None of one without noise. `hear`: of the
    share of the life by which it has gone on."""

    evaluate: Callable[[np.ndarray], Rate]
    carry: Callable[[Sequence[Job]], Sequence[np.ndarray]]
    cells: Cells
    halves: Callable[[Rate], tuple[Rate, Rate] | None] = lambda rate: None
    hear: Callable[[float], None] = lambda share: None


def live(machine: Machine, start: Node, cycles: float, tolerance: float, first: float) -> Stepped:
    """Steps of many cycles to the end of a life, with an error control.

    Steps no longer than the cycles that their rates cost are replaced by single cycles.

    Args:
        machine: rates of wear and what surfaces become.
        start: node at the beginning.
        cycles: of the life.
        tolerance: largest error of a step as a share of what it wears [1].
        first: length of the first step [cycles].
    """
    nodes, rejected, failures, length = [start], 0, 0, first
    refused: tuple[float, float] | None = None
    scatter, ceiling = 0.0, cycles
    trials: list[Trial] = []
    while cycles - nodes[-1].cycles > 1e-9 * cycles:
        now, remaining = nodes[-1], cycles - nodes[-1].cycles
        # What wears nothing goes on so.
        if not (now.rate.wear.any() or now.rate.noise.any()):
            length = ceiling = remaining
        length = min(length, ceiling)
        length = remaining / np.ceil(remaining / length - 1e-9)
        try:
            if min(length, remaining) <= len(STAGES) * now.rate.cost:
                nodes.append(_step_single_cycle(machine, now, min(1.0, remaining)))
                length, ceiling = max(length, 1.0) * GROWTH, ceiling * WIDENS
                machine.hear(min(1.0, remaining) / cycles)
                continue
            trial, error = _step_many_cycles(machine, nodes, length, tolerance)
        except CycleFailed as reason:
            failures, rejected = failures + 1, rejected + 1
            if failures > MOST_FAILURES or length <= 1.0:
                return Stepped(_trusted(nodes, trials, machine.cells), rejected, str(reason))
            length *= LEAST
            continue
        trials += [trial] if trial else []
        factor = GROWTH if error == 0 else SAFETY * (tolerance / error) ** (1 / 3)
        # Errors of steps fall with their length; one that does not is none, and is only told.
        helps = refused is None or error < refused[1] * length / refused[0]
        if trial is None or (error > max(tolerance, scatter) and helps):
            rejected, refused = rejected + 1, (length, error)
            ceiling = BELOW * length
        else:
            nodes.append(trial.after)
            machine.hear(length / cycles)
            ceiling *= WIDENS
            if error > tolerance:
                scatter, ceiling = max(scatter, ACCEPTED_ERROR_RATIO * error), cycles
                factor = max(1.0, refused[0] / length if refused else 1.0)
            refused = None
        length *= float(np.clip(factor, LEAST, GROWTH))
    return Stepped(_trusted(nodes, trials, machine.cells), rejected, "")


def live_along(machine: Machine, start: Node, lengths: Sequence[Length]) -> Stepped:
    """A life in given steps, whatever their errors: those of another life.

    Args:
        machine: rates of wear and what surfaces become.
        start: node at the beginning.
        lengths: cycles and parts of each step.
    """
    nodes, cycles = [start], sum(length.cycles for length in lengths)
    trials: list[Trial] = []
    for length, parts in lengths:
        try:
            if parts == 0:
                nodes.append(_step_single_cycle(machine, nodes[-1], length))
            else:
                trial, _ = _step_many_cycles(machine, nodes, length, np.inf, parts)
                assert trial is not None
                trials.append(trial)
                nodes.append(trial.after)
        except CycleFailed as reason:
            return Stepped(_trusted(nodes, trials, machine.cells), 0, str(reason))
        machine.hear(length / cycles)
    return Stepped(_trusted(nodes, trials, machine.cells), 0, "")


def live_by_jumps(machine: Machine, start: Node, cycles: float, jump: float) -> Stepped:
    """A life in equal jumps, each with the losses at its start.

    Half of the difference to the losses at the next start is their error.

    Args:
        machine: rates of wear and what surfaces become.
        start: node at the beginning.
        cycles: of the life.
        jump: length of a step [cycles].
    """
    nodes, cells = [start], machine.cells
    while cycles - nodes[-1].cycles > 1e-9 * cycles:
        now = nodes[-1]
        length = min(jump, cycles - now.cycles)
        losses = [(length, now.rate)]
        depth, *path = machine.carry(_make_jobs(now.depth, losses, PARTS))
        try:
            rate = machine.evaluate(depth)
        except CycleFailed as reason:
            return Stepped(tuple(nodes), 0, str(reason))
        off = 0.5 * (machine.carry([Job(now.depth, [(length, rate)], PARTS)])[0] - depth)
        shape = cells.shape(off, depth - now.depth)
        after = _node_after(machine, now, losses, (*path, depth), rate, shape, PARTS)
        nodes.append(after._replace(error=now.error + np.abs(cells.means(off))))
        machine.hear(length / cycles)
    return Stepped(tuple(nodes), 0, "")


def _step_single_cycle(machine: Machine, now: Node, length: float) -> Node:
    """A cycle (or what is left of one) as it was simulated."""
    depth = now.depth + length * now.rate.wear
    noise = length * machine.cells.means(now.rate.noise)
    return now._replace(
        cycles=now.cycles + length,
        depth=depth,
        rate=machine.evaluate(depth),
        variance=now.variance + noise**2,
        path=(depth,),
        parts=0,
    )


def _step_many_cycles(
    machine: Machine, nodes: Sequence[Node], length: float, tolerance: float, parts: int = PARTS
) -> tuple[Trial | None, float]:
    """(a step of `length` cycles, None where it is hopeless; its error as a share of what it
    wears, of its shape as one of all that is worn). Its losses are put on in so many `parts`, or
    more where that tells."""
    now, cells = nodes[-1], machine.cells
    rates, so_far = [now.rate], now.depth - nodes[0].depth
    for row in STAGES[:-1]:
        (depth,) = machine.carry([Job(now.depth, _sum_stages(length * row, rates), parts)])
        rates.append(machine.evaluate(depth))
        if len(rates) == 2:
            change = _relative_change(cells, rates[0], rates[1]) / row[0]
            counts = _error_weights(cells, _largest_wear(cells, length, rates), so_far)
            # What is little is off by all of itself at the most.
            share = OF_CUBE * change**3 if counts == 1 else counts * min(OF_CUBE * change**3, 1.0)
            far = (share / tolerance) ** (1 / 3)
            if far > HOPELESS:
                return None, tolerance * far**3
    # The last stage is the answer of third order.
    losses = _sum_stages(length * STAGES[-1], rates)
    path, parts, by_parts = _carry_parts(machine, now.depth, losses, so_far, tolerance, parts)
    depth = path[-1]
    rates.append(machine.evaluate(depth))
    losses_of_second = _sum_stages(length * (WEIGHTS - ERRORS), rates)
    (other,) = machine.carry([Job(now.depth, losses_of_second, parts)])
    grown, estimate = depth - now.depth, depth - other
    noise = [w * rate.noise for w, rate in zip(ERRORS, rates, strict=True)]
    noise = length * np.linalg.norm(noise, axis=0)
    shape = cells.shape(estimate, grown)
    sizes = cells.sizes(shape)
    beyond = _subtract_noise(sizes, cells.sizes(noise))
    shape = shape * cells.each(cells.shares(beyond, sizes))[: len(shape)]
    # Steps are chosen by what their length can mend.
    off = cells.shares(beyond, cells.sizes(so_far + grown))
    shape = np.copysign(np.hypot(shape, by_parts), shape)
    increments = cells.means(grown)
    noise_shares = cells.shares(cells.means(noise), increments)
    shares = _subtract_noise(cells.shares(cells.means(estimate), increments), noise_shares)
    change = _relative_change(cells, rates[0], rates[-1])
    smooth = np.minimum(shares, SMOOTH * change**2)
    most = _largest_wear(cells, length, rates)
    error = np.minimum(smooth * OF_THIRD_ORDER * change, cells.shares(most, increments))
    counts = _error_weights(cells, most, so_far)
    ratios = (error + OF_SCATTER * (shares - smooth)) * counts + off
    after = _node_after(machine, now, losses, path, rates[-1], shape, parts)
    after = after._replace(error=now.error + error * np.abs(increments))
    trial = Trial(after, shares, noise_shares, SMOOTH * change**2, counts)
    return trial, float(ratios.max(initial=0.0))


def _largest_wear(cells: Cells, length: float, rates: Sequence[Rate]) -> np.ndarray:
    """Mean depth of each surface that a step of this length wears by the largest of its rates."""
    return length * np.max([np.abs(cells.means(rate.wear)) for rate in rates], axis=0)


def _error_weights(cells: Cells, losses: np.ndarray, so_far: np.ndarray) -> float:
    """How much an error counts [1] that is a share of what a step loses, `losses` at the most: less
    where that is little beside what is worn so far, as of wear that comes to an end."""
    share = cells.shares(losses, np.abs(cells.means(so_far)) + np.abs(losses)).max(initial=0.0)
    return float(min(share / NEGLIGIBLE, 1.0))


def _sum_stages(weights: np.ndarray, rates: Sequence[Rate]) -> list[tuple[float, Rate]]:
    """Stages and how many cycles of each; those of none are left out."""
    pairs = zip(map(float, weights), rates, strict=True)
    return [(cycles, rate) for cycles, rate in pairs if cycles > 0]


def _make_jobs(row: np.ndarray, losses: Losses, parts: int) -> list[Job]:
    """A row behind these losses, and on the way there."""
    return [Job(row, losses, parts, share) for share in (1.0, *FRACTIONS)]


def _carry_parts(
    machine: Machine,
    row: np.ndarray,
    losses: Losses,
    so_far: np.ndarray,
    tolerance: float,
    parts: int,
) -> tuple[tuple[np.ndarray, ...], int, np.ndarray]:
    """(rows on the way to that behind these losses, and that one; in how many parts; what the shape
    of cells may be off for their number [m]): more than `parts` until that is little beside what is
    worn `so_far`."""
    cells = machine.cells
    fewer = [Job(row, losses, max(parts // few, 1)) for few in (2, 4)]
    depth, *path, half, fourth = machine.carry([*_make_jobs(row, losses, parts), *fewer])
    rows = [fourth, half, depth]
    while True:
        before, off = ((b - a)[: len(cells.areas)] for a, b in pairwise(rows[-3:]))
        last = np.linalg.norm(off)
        smaller = np.clip(np.linalg.norm(before) / last if last else np.inf, *TIMES_SMALLER)
        off = MARGIN * off / (smaller - 1.0)
        sizes = cells.sizes(so_far + rows[-1] - row)
        share = cells.shares(cells.sizes(off), sizes).max(initial=0.0)
        if share <= OF_TOLERANCE * tolerance or parts >= MOST_PARTS:
            return (*path, rows[-1]), parts, off
        parts *= 2
        depth, *path = machine.carry(_make_jobs(row, losses, parts))
        rows.append(depth)


def _node_after(
    machine: Machine,
    now: Node,
    losses: Losses,
    path: tuple[np.ndarray, ...],
    rate: Rate,
    shape: np.ndarray,
    parts: int,
) -> Node:
    """The node at the end of the `path` of a step, with what is known of its shape and its
    noise."""
    cells, cycles, few = machine.cells, sum(length for length, _ in losses), max(parts // 2, 1)
    halves = [machine.halves(rate) for _, rate in losses]
    pairs = list(zip(losses, halves, strict=True))
    jobs = [
        Job(now.depth, [(length, half[i] if half else rate) for (length, rate), half in pairs], few)
        for i in (0, 1)
        if any(halves)
    ]
    # What the wall's law leaves of differences in shape from before the step.
    differences = [now.shape, now.noise] if now.shape.any() or now.noise.any() else []
    for difference in differences:
        moved = now.depth.copy()
        moved[: len(difference)] = np.maximum(moved[: len(difference)] + difference, 0.0)
        jobs.append(Job(moved, losses, few))
    jobs += [Job(now.depth, losses, few)] if differences else []
    ends = [row[: len(shape)] for row in machine.carry(jobs)] if jobs else []
    remainder, noise = (end - ends[-1] for end in ends[-3:-1]) if differences else (0.0, now.noise)
    if any(halves):
        change = 0.5 * (ends[0] - ends[1])
        noise = np.copysign(np.hypot(change, noise), change)
    spread = [length * cells.means(rate.noise) for length, rate in losses]
    variance = now.variance + np.sum(np.square(spread), axis=0)
    return Node(
        now.cycles + cycles,
        path[-1],
        rate,
        now.error,
        variance,
        shape + remainder,
        noise,
        path,
        parts,
    )


def _relative_change(cells: Cells, one: Rate, other: Rate) -> float:
    """Relative change between the volumes of two rates, beyond their noise."""
    volumes = [cells.means(rate.wear) for rate in (one, other)]
    less, more = sorted(np.abs(volumes), key=lambda volume: float(volume.max(initial=0.0)))
    less = np.maximum(less, np.finfo(float).eps * more)
    noise = np.hypot(*(cells.means(rate.noise) for rate in (one, other)))
    change = _subtract_noise(cells.shares(volumes[1] - volumes[0], less), cells.shares(noise, less))
    return float(change.max(initial=0.0))


def _subtract_noise(sizes: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Sizes without what noise explains."""
    return np.sqrt(np.maximum(sizes**2 - (CONFIDENCE * noise) ** 2, 0.0))


def _trusted(nodes: Sequence[Node], trials: Sequence[Trial], cells: Cells) -> tuple[Node, ...]:
    """The nodes with what is told of their volumes at the end of the life.

    Smooth rates: the errors of the steps add up. A second opinion comes from the rates at the
    nodes of the whole life: a cubic spline through them, integrated, is of higher order than the
    steps. It knows the law that the rates follow where a step supposes one; the lesser is told.
    Rates that scatter without saying so (means over cycles tell their noise): how much is known
    from all steps that were tried, those taken back among them. Were they left out, steps whose
    rates lie by chance on a line would be kept and believed."""
    errors, scatter = _errors(nodes, trials, cells), _scatter(trials, len(cells.surfaces))
    trusted, variance = [nodes[0]], np.zeros(len(cells.surfaces))
    for before, after, error in zip(nodes[:-1], nodes[1:], errors[1:], strict=True):
        trial = next((one for one in trials if one.after is after), None)
        if trial is not None:
            losses = np.abs(cells.means(after.depth - before.depth))
            # Without scatter, what little is beyond smooth rates.
            less = np.maximum(trial.shares - trial.smooth, 0.0)
            variance = variance + (OF_SCATTER * np.where(scatter > 0, scatter, less) * losses) ** 2
        trusted.append(after._replace(error=error, variance=after.variance + variance))
    return tuple(trusted)


def _errors(nodes: Sequence[Node], trials: Sequence[Trial], cells: Cells) -> list[np.ndarray]:
    """Of smooth rates, by surface, at each node [m]."""
    own_errors = [node.error for node in nodes]
    if len(nodes) < PLACES:
        return own_errors
    cycles = np.array([node.cycles for node in nodes])
    rates = np.array([cells.means(node.rate.wear) for node in nodes])
    path = scipy.interpolate.CubicSpline(cycles, rates).antiderivative()(cycles)
    stepped = {id(trial.after) for trial in trials}
    sum_, errors = np.zeros(len(cells.surfaces)), [own_errors[0]]
    for i, node in enumerate(nodes[1:], 1):
        before, now = np.abs(rates[i - 1]), np.abs(rates[i])
        # An error grows with the rate where that grows with wear; that it shrinks is not counted.
        growth = np.divide(now, before, out=np.ones_like(now), where=before > 0)
        sum_ = sum_ * np.maximum(growth, 1.0)
        if id(node) in stepped:
            losses = cells.means(node.depth - nodes[i - 1].depth)
            sum_ = sum_ + MARGIN * np.abs(losses - (path[i] - path[i - 1]))
        errors.append(np.minimum(own_errors[i], sum_))
    return errors


def _scatter(trials: Sequence[Trial], surfaces: int) -> np.ndarray:
    """Of the estimates of steps, as shares of what they wear, by surface; from few steps a scatter
    is little known, and Student's factor widens it."""
    scatter = np.zeros(surfaces)
    # The tail of wear that comes to an end is no scatter.
    trials = [trial for trial in trials if trial.counts == 1]
    if not trials:
        return scatter
    smooth = np.array([trial.smooth for trial in trials])
    noise = np.array([trial.noise for trial in trials]).T
    for i, shares in enumerate(np.array([trial.shares for trial in trials]).T):
        beyond = shares[shares > CLEARLY * smooth]
        if not len(beyond) or noise[i].any():
            continue
        # Also the steps tell in which smooth rates could not have made as much.
        telling = shares[smooth <= np.sqrt(np.mean(beyond**2))]
        factor = scipy.special.stdtrit(len(telling), 0.975) / NORMAL
        scatter[i] = factor * np.sqrt(np.mean(telling**2))
    return scatter
