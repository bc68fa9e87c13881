"""The guide's mechanism written by hand.

Crank angle theta gives the slider's distance r from C, the guide's angle phi and their rates in
closed form; Euler's equations of slider and guide give the resultant N across the guide and its
moment M about the slider's centre, and with a ratio of friction to the corners' forces the forces n
of the front and back corner."""

import importlib

import numpy as np

from jaxclear.complementarity import HorizontalLCP
from tests.rigs.lemke import lemke

# The module, which the scene of the same name hides.
scene = importlib.import_module("jaxclear.scenes.guide")
MU = 0.1


def by_hand(angle, speed, acceleration, ratio):
    """Reactions for a crank's motion and a ratio of friction to the sum of the corners' forces; `n`
    front and back corner."""
    half = scene.GUIDE_ARM
    c, s, g = np.cos(angle), np.sin(angle), scene.GRAVITY
    tangent, inward = np.stack([-s, c]), np.stack([-c, -s])
    place = np.stack([scene.GROUND_DISTANCE + scene.CRANK * c, scene.CRANK * s])
    velocity = scene.CRANK * speed * tangent
    pull = scene.CRANK * (acceleration * tangent + speed**2 * inward)
    r = np.hypot(*place)
    along = place / r
    across = np.stack([-along[1], along[0]])
    slip, turn = (along * velocity).sum(0), (across * velocity).sum(0) / r
    swing = ((across * pull).sum(0) - 2 * slip * turn) / r
    moment = scene.SLIDER_INERTIA * swing
    force = (
        -(
            (scene.GUIDE_INERTIA + scene.SLIDER_INERTIA) * swing
            + scene.GUIDE_MASS * g * half * along[0]
        )
        / r
    )
    pair = (moment - 0.5 * scene.WIDTH * ratio * force) / scene.SLIDER
    n = np.stack([0.5 * force + pair, 0.5 * force - pair])
    friction = ratio * np.abs(n).sum(0)
    up = np.array([0.0, g]).reshape(2, *[1] * np.ndim(angle))
    pin = scene.SLIDER_MASS * (pull + up) - force * across - friction * along
    ground = scene.CRANK_MASS * (0.5 * pull + up) + pin
    arm = scene.CRANK * (c * pin[1] - s * pin[0])
    torque = scene.CRANK_INERTIA * acceleration + 0.5 * scene.CRANK_MASS * g * scene.CRANK * c + arm
    return {
        "slip": slip,
        "n": n,
        "friction": friction,
        "A": pin,
        "O": ground,
        "torque": torque,
        "r": r,
        "N": force,
        "M": moment,
    }


def regularised(angle, speed):
    """By hand with the friction mu tanh(v / v_s) of the paper's comparison."""
    slip = by_hand(angle, speed, 0.0, 0.0)["slip"]
    return by_hand(angle, speed, 0.0, -MU * np.tanh(slip / scene.REGULARISING_SPEED))


def friction_problem(offset, slope, mu, slip, answer):
    """Corner forces n = offset + slope T = p - m, friction T, slip s = slip + answer T = s+ - s- as
    a horizontal LCP.

    0 <= p perp m >= 0 at both corners, 0 <= s+ perp mu sum(p + m) + T >= 0, 0 <= s- perp mu sum(p +
    m) - T >= 0. z: p, s+, the last one; w: m, the one before, s-."""
    w, z = np.zeros((4, 4)), np.zeros((4, 4))
    for k in range(2):
        # p - m - slope T = offset, with T = y - mu sum(p + m)
        w[k, k], z[k, k] = 1.0, 1.0
        w[k, :2] -= slope[k] * mu
        z[k, :2] += slope[k] * mu
        w[k, 2] = slope[k]
    w[2], z[2] = [-2 * mu, -2 * mu, 1.0, 0.0], [2 * mu, 2 * mu, 0.0, -1.0]
    w[3], z[3] = [-answer * mu, -answer * mu, answer, 1.0], [answer * mu, answer * mu, 1.0, 0.0]
    return HorizontalLCP(w, z, np.array([-offset[0], -offset[1], 0.0, -slip]))


def solved(problem, mu):
    """Corner forces, friction and slip that Lemke finds, and how well they are complementary beside
    the largest force."""
    found = lemke(problem)
    z, w = found.z, found.w
    total = (z[:2] + w[:2]).sum()
    return z[:2] - w[:2], w[2] - mu * total, z[2] - w[3], found.residual / total
