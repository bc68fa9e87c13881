"""The cheapest candidate by an augmented Lagrangian whose steps optax takes: for more free numbers
than SLSQP's dense matrices like.

$$ L = C + \\frac{1}{2 \\rho} \\sum_j \\big( (\\lambda_j + \\rho g_j)_+^2 - \\lambda_j^2 \\big) $$

is lowered by Adam with steps that die away, within the bounds; then $\\lambda_j$ becomes
$\\max(0, \\lambda_j + \\rho g_j)$. What counts in the end is the mean over the last steps.

Source: Bertsekas 1982, Constrained Optimization and Lagrange Multiplier Methods, chapter 3; steps
that die away: Robbins & Monro 1951, Ann. Math. Stat. 22, 400, doi:10.1214/aoms/1177729586.
"""

import numpy as np

from jaxclear.studies.design.optimise import Candidate, Search, judged

# Adam's steps: places run from 0 to 1.
FIRST_STEP, LAST_SHARE = 0.03, 1e-3
# The penalty of a limit, in costs; how often multipliers are set anew, and steps between.
PENALTY, ROUNDS, STEPS = 20.0, 8, 120
# The mean is over this share of the last steps.
LAST = 0.2


def cheapest_by_steps(search: Search, start: np.ndarray) -> Candidate:
    """The candidate at the place that the augmented Lagrangian ends with."""
    import optax

    place = np.clip(start, search.low, search.high)
    first = search.evaluate(place)[0]
    scale, forces = abs(first[0]) or 1.0, np.zeros(len(first) - 1)
    for number in range(ROUNDS):
        size = max(FIRST_STEP * 0.5**number, 1e-3)
        rule = optax.adam(optax.cosine_decay_schedule(size, STEPS, LAST_SHARE))
        state = rule.init(place)
        summed, excess, count = np.zeros_like(place), np.zeros_like(forces), 0
        for step in range(STEPS):
            values, slopes = search.evaluate(place)
            push = np.maximum(forces + PENALTY * values[1:], 0.0)
            slope = slopes[0] / scale + push @ slopes[1:]
            change, state = rule.update(slope, state, place)
            moved = np.asarray(optax.apply_updates(place, change))
            place = np.clip(moved, search.low, search.high)
            if step >= (1 - LAST) * STEPS:
                summed, excess, count = summed + place, excess + values[1:], count + 1
        place = summed / count
        forces = np.maximum(forces + PENALTY * excess / count, 0.0)
    return judged(search, place)
