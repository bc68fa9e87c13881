"""The cheapest candidate by an augmented Lagrangian whose steps optax takes: for more free numbers
than SLSQP's dense matrices like, and where slopes are known with noise only.

$$ L = C + \\frac{1}{2 \\rho} \\sum_j \\big( (\\lambda_j + \\rho g_j)_+^2 - \\lambda_j^2 \\big) $$

is lowered by Adam with steps that die away, within the bounds; then $\\lambda_j$ becomes
$\\max(0, \\lambda_j + \\rho g_j)$. What counts in the end is the mean over the last steps.

Source: Bertsekas 1982, Constrained Optimization and Lagrange Multiplier Methods, chapter 3.
"""

from collections.abc import Callable

import numpy as np

from jaxclear.studies.design.optimise import Candidate, Search, judged

# (cost and excesses (1 + limits,), slopes (1 + limits, free)) of a place.
Told = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
# Adam's steps: places run from 0 to 1.
FIRST_STEP, LAST_SHARE = 0.03, 1e-3
# The penalty of a limit, in costs; how often multipliers are set anew, and steps between.
PENALTY, ROUNDS, STEPS = 20.0, 8, 120
# The mean is over this share of the last steps.
LAST = 0.2


def cheapest_by_steps(search: Search, start: np.ndarray) -> Candidate:
    """The candidate that optax finds where slopes are exact."""
    found, _ = descend(search.told, start, search.low, search.high, ROUNDS, STEPS)
    return judged(search, found)


def descend(
    told: Told, start: np.ndarray, low: np.ndarray, high: np.ndarray, rounds: int, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """(place (free,), multipliers (limits,) in costs at the start) that the augmented Lagrangian
    ends with."""
    import optax

    place = np.clip(start, low, high)
    first = told(place)[0]
    whole, forces = abs(first[0]) or 1.0, np.zeros(len(first) - 1)
    for number in range(rounds):
        size = FIRST_STEP * 0.5**number if number else FIRST_STEP
        rate = optax.cosine_decay_schedule(max(size, 1e-3), steps, LAST_SHARE)
        rule = optax.adam(rate)
        state = rule.init(place)
        summed, excess, count = np.zeros_like(place), np.zeros_like(forces), 0
        for step in range(steps):
            found, slopes = told(place)
            push = np.maximum(forces + PENALTY * found[1:], 0.0)
            slope = slopes[0] / whole + push @ slopes[1:]
            change, state = rule.update(slope, state, place)
            place = np.clip(np.asarray(optax.apply_updates(place, change)), low, high)
            if step >= (1 - LAST) * steps:
                summed, excess, count = summed + place, excess + found[1:], count + 1
        place = summed / count
        forces = np.maximum(forces + PENALTY * excess / count, 0.0)
    return place, forces
