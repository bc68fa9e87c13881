"""A four-bar at one position of its crank, the tolerances of its four links and of one clearance
free: designs with a closed-form optimum.

By hand: the loop closes, moments of the weights about the two other joints give the force through
the loose one, and its journal lies where that presses it. Over tolerances of some micrometres the
follower's angle is linear in all five numbers, but for parts in 1e5, so reciprocal costs b/t are
least at t ~ (b / s^2)^(1/3), s being the angle's slopes."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import fsolve

import jaxclear as jc

CLEARANCE, GRAVITY = 0.2e-3, 9.81
NAMES = ("clearance", "crank", "coupler", "follower", "ground")
NUMBERS = np.array([CLEARANCE, 0.1, 0.4, 0.3, 0.3])
# Weights of coupler and follower [N], and where they act along these [m].
WEIGHTS, CENTRES = GRAVITY * np.array([1.44, 1.63]), (0.2, 0.15)
# Costs [cost x m], assumed; the room of the angle [rad].
PRICED = np.array([2e-6, 0.5e-6, 1e-6, 1e-6, 2e-6])
ROOM, DEVIATIONS = 4e-5, 3
PLACES = {
    "clearance": lambda rig: rig.connections["B"].joint.clearance,
    "crank": lambda rig: rig.connections["A"].parent.at[0],
    "coupler": lambda rig: rig.connections["B"].parent.at[0],
    "follower": lambda rig: rig.connections["B"].child.at[0],
    "ground": lambda rig: rig.connections["D"].parent.at[0],
}
# Positions of the crank [rad].
CRANKS = (0.4, 2.0, 4.0)
# Normal distributions have three deviations in a tolerance.
SPREAD = 1 / 3


class Optimum(NamedTuple):
    """Bounds [m] in the order of `NAMES`, cost, and what a radian more of the limit saves."""

    tolerances: np.ndarray
    cost: float
    price: float


def along(angle):
    return np.array([np.cos(angle), np.sin(angle)])


def follower_angle(crank, numbers=NUMBERS):
    """Of the mechanism with these numbers, in the order of `NAMES`."""
    clearance, first, coupler, follower, ground = numbers

    def pressed(angles):
        """The direction of the force on the coupler: about A and D it holds the weights."""
        arms = [coupler * along(angles[0]), follower * along(angles[1])]
        rows = np.array([[-arms[0][1], arms[0][0]], [arms[1][1], -arms[1][0]]])
        moments = [w * c * np.cos(a) for w, c, a in zip(WEIGHTS, CENTRES, angles, strict=True)]
        force = np.linalg.solve(rows, moments)
        return force / np.linalg.norm(force)

    def left(angles):
        end = first * along(crank) + coupler * along(angles[0]) + clearance * pressed(angles)
        return end - np.array([ground, 0.0]) - follower * along(angles[1])

    return fsolve(left, (crank + 0.81, 1.32), xtol=1e-12)[1]


def slopes(crank):
    """Of the follower's angle by each number [rad/m]; by differences of 20 um."""
    steps = 2e-5 * np.eye(len(NUMBERS))
    pairs = [[follower_angle(crank, NUMBERS + side * step) for side in (-1, 1)] for step in steps]
    return np.array([high - low for low, high in pairs]) / 4e-5


def optimum(crank):
    steep = slopes(crank)
    shape = (PRICED / steep**2) ** (1 / 3)
    best = shape * ROOM / (DEVIATIONS * SPREAD * np.linalg.norm(steep * shape))
    cost = float((PRICED / best).sum())
    return Optimum(best, cost, cost / ROOM)


def designed(crank, **priced):
    """What `jaxclear.design` makes of it: the crank held, the follower's angle limited. `priced`:
    other costs by name."""
    rig = jc.scenes.four_bar("planar", CLEARANCE, friction=False, wear=False)
    problem = jc.PositionProblem(
        rig,
        lambda found: found.coordinate("D")[0],
        {name: jc.Variable(PLACES[name], jc.distribution.Normal(5e-6)) for name in NAMES},
        positions={"O": [crank]},
    )
    at_most = follower_angle(crank) + ROOM
    limit = jc.limit.MeanAndDeviation("response", at_most=at_most, deviations=DEVIATIONS)
    costs = {n: jc.cost.Reciprocal(b) for n, b in zip(NAMES, PRICED, strict=True)}
    tolerance, settings = dict.fromkeys(NAMES, (1e-7, 1e-4)), jc.DesignSettings(surface=False)
    return jc.design(problem, costs | priced, limit, tolerance=tolerance, settings=settings)
