"""From the depth that a cycle wears to the depth of a life: steps of many cycles with an error
control.

The embedded pair of Bogacki and Shampine, carried on with its third-order answer. Its own estimate
is the error of its second-order answer, far too large for that; multiplied by 3.5 times the
relative change of the rate over the step it is the error of the third-order answer, 1.75 times too
large where wear dies away exponentially. What is too large for rates that change smoothly (cycles
that settle now here, now there) counts as noise; where shorter steps do not help they are taken.
What the whole life may be off by is told once all its steps are known (`trust`).

An error is a root mean square over the cells of a surface, as a share of what it wears in the step,
of the worst surface: so the shares asked for are those of a whole life.

Source: Bogacki & Shampine 1989, Appl. Math. Lett. 2, 321, doi:10.1016/0893-9659(89)90079-7.
"""

from collections.abc import Callable
from typing import NamedTuple

import diffrax
import numpy as np

from jaxclear.studies.life.nodes import Cells, Node, Rate, Trial
from jaxclear.studies.life.trust import trusted

__all__ = ["CycleFailed", "Stepped", "live", "live_along", "live_by_jumps"]

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
TOLD = 2.0
# A step aims at this share of the error allowed, and is at most so many times the one before.
SAFETY, GROWTH, LEAST = 0.9, 3.0, 0.1
# A step is at most this share of one that was taken back, which grows so many times a step.
BELOW, WIDENS = 0.7, 1.3
# A step that is this many times too long is given up after its second rate.
HOPELESS = 2.0
# Noise that an estimate consists of within two standard errors is no error.
CONFIDENCE = 2.0
# So many cycles of a life may fail, each shortening its step, before it ends.
MOST_FAILURES = 6


class CycleFailed(RuntimeError):
    """A rate that does not exist; the sentence says why."""


class Stepped(NamedTuple):
    """Nodes of a life, how many steps were taken back, and why it ended before its time; ""."""

    nodes: tuple[Node, ...]
    rejected: int
    ended: str


Evaluate = Callable[[np.ndarray], Rate]
# Hears of the share of the life by which it has gone on.
Hear = Callable[[float], None]


def live(
    evaluate: Evaluate,
    start: Node,
    cells: Cells,
    cycles: float,
    tolerance: float,
    first: float,
    hear: Hear = lambda share: None,
) -> Stepped:
    """Steps to the end of `cycles`, each with an error of at most `tolerance` [1] of what it wears;
    the `first` is so many cycles long. Steps that would be no longer than what their rates cost
    give way to cycles one by one."""
    nodes, rejected, failures, length = [start], 0, 0, first
    refused: tuple[float, float] | None = None
    scatter, ceiling = 0.0, cycles
    trials: list[Trial] = []
    while cycles - nodes[-1].cycles > 1e-9 * cycles:
        now, left = nodes[-1], cycles - nodes[-1].cycles
        length = min(length, ceiling)
        length = left / np.ceil(left / length - 1e-9)
        try:
            if min(length, left) <= len(STAGES) * now.rate.cost:
                nodes.append(_one_by_one(evaluate, now, min(1.0, left)))
                length = max(length, 1.0) * GROWTH
                hear(min(1.0, left) / cycles)
                continue
            trial, error = _stepped(evaluate, now, cells, length, tolerance)
        except CycleFailed as reason:
            failures, rejected = failures + 1, rejected + 1
            if failures > MOST_FAILURES or length <= 1.0:
                return Stepped(trusted(nodes, trials, cells, OF_SCATTER), rejected, str(reason))
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
            hear(length / cycles)
            ceiling *= WIDENS
            if error > tolerance:
                scatter, ceiling = max(scatter, TOLD * error), cycles
                factor = max(1.0, refused[0] / length if refused else 1.0)
            refused = None
        length *= float(np.clip(factor, LEAST, GROWTH))
    return Stepped(trusted(nodes, trials, cells, OF_SCATTER), rejected, "")


def live_along(
    evaluate: Evaluate,
    start: Node,
    cells: Cells,
    lengths: np.ndarray,
    hear: Hear = lambda share: None,
) -> Stepped:
    """Steps of these lengths, whatever their errors: those of another life."""
    nodes, cycles = [start], float(np.sum(lengths))
    trials: list[Trial] = []
    for length in map(float, lengths):
        now = nodes[-1]
        try:
            if length <= 1.0:
                nodes.append(_one_by_one(evaluate, now, length))
            else:
                trial, _ = _stepped(evaluate, now, cells, length, np.inf)
                assert trial is not None
                trials.append(trial)
                nodes.append(trial.after)
        except CycleFailed as reason:
            return Stepped(trusted(nodes, trials, cells, OF_SCATTER), 0, str(reason))
        hear(length / cycles)
    return Stepped(trusted(nodes, trials, cells, OF_SCATTER), 0, "")


def live_by_jumps(
    evaluate: Evaluate,
    start: Node,
    cells: Cells,
    cycles: float,
    jump: float,
    hear: Hear = lambda share: None,
) -> Stepped:
    """Steps of `jump` cycles, each with the rate at its start; half of what the next rate says
    otherwise is their error."""
    nodes = [start]
    while cycles - nodes[-1].cycles > 1e-9 * cycles:
        now = nodes[-1]
        length = min(jump, cycles - now.cycles)
        try:
            depth = now.depth + length * now.rate.wear
            rate = evaluate(depth)
        except CycleFailed as reason:
            return Stepped(tuple(nodes), 0, str(reason))
        error = now.error + cells.sizes(0.5 * length * (rate.wear - now.rate.wear))
        variance = now.variance + (length * now.rate.noise) ** 2
        nodes.append(Node(now.cycles + length, depth, rate, error, variance))
        hear(length / cycles)
    return Stepped(tuple(nodes), 0, "")


def _one_by_one(evaluate: Evaluate, now: Node, length: float) -> Node:
    """A cycle (or what is left of one) as it was simulated."""
    depth = now.depth + length * now.rate.wear
    variance = now.variance + (length * now.rate.noise) ** 2
    return Node(now.cycles + length, depth, evaluate(depth), now.error, variance)


def _stepped(
    evaluate: Evaluate, now: Node, cells: Cells, length: float, tolerance: float
) -> tuple[Trial | None, float]:
    """(a step of `length` cycles, None where it is hopeless; its error as a share of what it
    wears)."""
    rates = [now.rate]
    for row in STAGES:
        depth = now.depth + length * sum(a * own.wear for a, own in zip(row, rates, strict=True))
        rates.append(evaluate(depth))
        if len(rates) == 2:
            change = _change(cells, rates[0], rates[1]) / row[0]
            far = change * (OF_CUBE / tolerance) ** (1 / 3)
            if far > HOPELESS:
                return None, tolerance * far**3
    # The last stage is the answer of third order: `depth` is where the step ends.
    grown = depth - now.depth
    estimate = length * sum(w * own.wear for w, own in zip(ERRORS, rates, strict=True))
    noise = length * np.sqrt(sum((w * r.noise) ** 2 for w, r in zip(ERRORS, rates, strict=True)))
    known = cells.shares(noise, grown)
    shares = _beyond(cells.shares(estimate, grown), known)
    change = _change(cells, rates[0], rates[-1])
    smooth = np.minimum(shares, SMOOTH * change**2)
    scattered = shares - smooth
    error = smooth * OF_THIRD_ORDER * change
    left = sum((w * r.noise) ** 2 for w, r in zip(WEIGHTS, rates, strict=True))
    whole = now.error + error * cells.sizes(grown)
    told = float((error + OF_SCATTER * scattered).max(initial=0.0))
    variance = now.variance + length**2 * left
    after = Node(now.cycles + length, depth, rates[-1], whole, variance)
    return Trial(after, estimate, shares, known, SMOOTH * change**2), told


def _change(cells: Cells, one: Rate, other: Rate) -> float:
    """Relative change between two rates, beyond their noise."""
    less = min((one.wear, other.wear), key=lambda wear: float(cells.sizes(wear).max(initial=0.0)))
    noise = np.hypot(one.noise, other.noise)
    found = _beyond(cells.shares(other.wear - one.wear, less), cells.shares(noise, less))
    return float(found.max(initial=0.0))


def _beyond(sizes: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Sizes without what noise explains."""
    return np.sqrt(np.maximum(sizes**2 - (CONFIDENCE * noise) ** 2, 0.0))
