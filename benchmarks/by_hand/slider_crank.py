"""The slider-crank of `peers.rig`, written by hand for numba: what a user without a library would
write.

Coordinates are the rod's angle and the slider's place. The step that would enter the contact is
shortened to end at first touch, which captures the impact speed. Beside the fixed steps stands an
adaptive run, for a user who writes that by hand as well.
"""

import math

import numba
import numpy as np

from benchmarks.peers.rig import ATOL_SHARE, Answer

# Newton steps to first touch; the gap is nearly straight within a step.
TOUCH_STEPS = 4
# Within this share of the clearance the direction of the offset is not needed and may not exist.
CENTRE = 1e-4


@numba.njit(inline="always", error_model="numpy")
def _forces(p, c, stiffness, cth, sth, phi, x, w, u, memory):
    """(accelerations of rod and slider, indentation, its rate, normal force); `memory`: impact
    speed."""
    sphi, cphi = math.sin(phi), math.cos(phi)
    ex, ey = x - p.crank * cth - p.rod * cphi, -p.crank * sth - p.rod * sphi
    moment = p.pull * (sth * cphi - cth * sphi)
    square = ex * ex + ey * ey
    if square < (CENTRE * c) ** 2:
        return moment / p.inertia, 0.0, -c, 0.0, 0.0
    vx, vy = (
        u + p.crank * p.speed * sth + p.rod * w * sphi,
        -p.crank * p.speed * cth - p.rod * w * cphi,
    )
    r = math.sqrt(square)
    nx, ny = ex / r, ey / r
    delta, rate = r - c, nx * vx + ny * vy
    if delta <= 0.0:
        return moment / p.inertia, 0.0, delta, rate, 0.0
    loss = 1.0 + p.damping * rate / max(memory, p.slowest)
    normal = stiffness * delta * math.sqrt(delta) * max(loss, 0.0)
    reach = p.radius + 0.5 * delta
    slip = nx * vy - ny * vx - w * reach
    share = min(max((abs(slip) - p.inner) / (p.outer - p.inner), 0.0), 1.0)
    drag = -math.copysign(p.mu * share, slip) * normal
    fx, fy = -normal * nx - drag * ny, -normal * ny + drag * nx
    moment -= p.rod * (cphi * fy - sphi * fx) + reach * drag
    return moment / p.inertia, fx / p.slider, delta, rate, normal


@numba.njit(inline="always", error_model="numpy")
def _step(p, c, k, t, h, y, m, f):
    """One classical Runge-Kutta step from y = (phi, x, w, u) with forces f there: (y, f) at its
    end."""
    phi, x, w, u = y
    half = 0.5 * h
    cm, sm = math.cos(p.speed * (t + half)), math.sin(p.speed * (t + half))
    ce, se = math.cos(p.speed * (t + h)), math.sin(p.speed * (t + h))
    w2, u2 = w + half * f[0], u + half * f[1]
    g = _forces(p, c, k, cm, sm, phi + half * w, x + half * u, w2, u2, m)
    w3, u3 = w + half * g[0], u + half * g[1]
    i = _forces(p, c, k, cm, sm, phi + half * w2, x + half * u2, w3, u3, m)
    w4, u4 = w + h * i[0], u + h * i[1]
    j = _forces(p, c, k, ce, se, phi + h * w3, x + h * u3, w4, u4, m)
    s = h / 6.0
    phi += s * (w + 2.0 * (w2 + w3) + w4)
    x += s * (u + 2.0 * (u2 + u3) + u4)
    w += s * (f[0] + 2.0 * (g[0] + i[0]) + j[0])
    u += s * (f[1] + 2.0 * (g[1] + i[1]) + j[1])
    return (phi, x, w, u), _forces(p, c, k, ce, se, phi, x, w, u, m)


@numba.njit(error_model="numpy")
def _to_touch(p, c, t, h, y, f):
    """(time, state, impact speed) of first touch within a step that began open: flight without
    contact, shortened until the gap is 0."""
    for n in range(TOUCH_STEPS + 1):
        z, g = _step(p, c, 0.0, t, h, y, 0.0, f)
        if n < TOUCH_STEPS:
            h -= g[2] / g[3]
    return t + h, z, g[3]


@numba.njit(error_model="numpy")
def _run(p, c, saves, per_save, h, out):
    """Slider's place at `saves` times into `out`; returns the peak force."""
    k = 4.0 / 3.0 * p.modulus * math.sqrt((p.radius - c) * p.radius / c)
    y, m = (0.0, p.crank + p.rod, -p.crank * p.speed / p.rod, 0.0), 0.0
    f = _forces(p, c, k, 1.0, 0.0, y[0], y[1], y[2], y[3], m)
    peak, closed = 0.0, False
    for save in range(saves):
        for i in range(per_save):
            n = save * per_save + i
            t, rest = n * h, h
            z, g = _step(p, c, k, t, rest, y, m, f)
            if not closed and g[2] > 0.0:
                t, y, m = _to_touch(p, c, t, rest, y, f)
                ct, st = math.cos(p.speed * t), math.sin(p.speed * t)
                f = _forces(p, c, k, ct, st, y[0], y[1], y[2], y[3], m)
                z, g = _step(p, c, k, t, (n + 1) * h - t, y, m, f)
            closed = g[2] > 0.0
            y, f = z, g
            peak = max(peak, g[4])
        out[save] = y[1]
    return peak


@numba.njit(parallel=True, error_model="numpy")
def _batch(p, clearances, saves, per_save, h, out):
    """Peak force and the slider's last place for every clearance, on all threads."""
    for j in numba.prange(clearances.shape[0]):
        places = np.empty(saves)
        out[j, 0] = _run(p, clearances[j], saves, per_save, h, places)
        out[j, 1] = places[saves - 1]


# Dormand & Prince 1980: nodes, rows of weights, and the difference of the two results.
_NODES = (0.2, 0.3, 0.8, 8 / 9, 1.0, 1.0)
_ROWS = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
_DIFFERENCE = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)
_TABLE, _GAPS = np.zeros((6, 6)), np.array(_DIFFERENCE)
for _i, _row in enumerate(_ROWS):
    _TABLE[_i, : len(_row)] = _row
_TIMES = np.array(_NODES)
# Longest step of an adaptive run [s]: a touch shorter than this may be missed in flight.
LONGEST = 1e-5


@numba.njit(error_model="numpy")
def _embedded(p, c, k, t, h, y, m, slopes, z, rtol, atol):
    """One step of Dormand and Prince from y, its slope in slopes[0]: (indentation, rate, force at
    its end z, error).
    """
    last = (0.0, 0.0, 0.0, 0.0, 0.0)
    for i in range(6):
        for n in range(4):
            moved = 0.0
            for j in range(i + 1):
                moved += _TABLE[i, j] * slopes[j, n]
            z[n] = y[n] + h * moved
        angle = p.speed * (t + _TIMES[i] * h)
        last = _forces(p, c, k, math.cos(angle), math.sin(angle), z[0], z[1], z[2], z[3], m)
        slopes[i + 1, 0], slopes[i + 1, 1], slopes[i + 1, 2], slopes[i + 1, 3] = (
            z[2],
            z[3],
            last[0],
            last[1],
        )
    worst = 0.0
    for n in range(4):
        off = 0.0
        for j in range(7):
            off += _GAPS[j] * slopes[j, n]
        worst = max(worst, abs(h * off) / (atol + rtol * max(abs(y[n]), abs(z[n]))))
    return last[2], last[3], last[4], worst


@numba.njit(error_model="numpy")
def _run_adaptive(p, c, saves, interval, rtol, atol, out):
    """Exact capture under error control: (peak force, steps tried)."""
    stiff = 4.0 / 3.0 * p.modulus * math.sqrt((p.radius - c) * p.radius / c)
    y, z, slopes = (
        np.array([0.0, p.crank + p.rod, -p.crank * p.speed / p.rod, 0.0]),
        np.zeros(4),
        np.zeros((7, 4)),
    )
    slopes[0, 0], slopes[0, 1] = y[2], y[3]
    t, m, peak, closed, tried, wish = 0.0, 1.0, 0.0, False, 0, 1e-7
    for save in range(saves):
        stop = (save + 1) * interval
        while t < stop:
            h = min(wish, LONGEST, stop - t)
            k = stiff if closed else 0.0
            delta, rate, normal, worst = _embedded(p, c, k, t, h, y, m, slopes, z, rtol, atol)
            tried += 1
            # The usual controller of a method of order five, with the usual safety and limits.
            wish = h * min(5.0, max(0.2, 0.9 * max(worst, 1e-10) ** -0.2))
            if worst > 1.0:
                continue
            if not closed and delta > 0.0:
                for _ in range(TOUCH_STEPS):
                    h -= delta / rate
                    delta, rate, normal, worst = _embedded(
                        p, c, k, t, h, y, m, slopes, z, rtol, atol
                    )
                m, closed, wish, tried = rate, True, min(wish, 1e-7), tried + TOUCH_STEPS
                t += h
            else:
                closed = delta > 0.0
                t = stop if h == stop - t else t + h
            y[:] = z
            slopes[0] = slopes[6]
            peak = max(peak, normal)
        out[save] = y[1]
    return peak, tried


@numba.njit(parallel=True, error_model="numpy")
def _batch_adaptive(p, clearances, saves, interval, rtol, atol, out):
    for j in numba.prange(clearances.shape[0]):
        places = np.empty(saves)
        out[j, 0] = _run_adaptive(p, clearances[j], saves, interval, rtol, atol, places)[0]
        out[j, 1] = places[saves - 1]


def run(p, clearance: float, saves: int, per_save: int, h: float) -> Answer:
    """Slider's place at the saving times and the peak force."""
    places = np.empty(saves)
    peak = _run(p, clearance, saves, per_save, h, places)
    return Answer(places, peak, saves * per_save)


def batch(p, clearances: np.ndarray, saves: int, per_save: int, h: float) -> np.ndarray:
    """(peak force, slider's last place) of every sample, on all threads."""
    out = np.empty((len(clearances), 2))
    _batch(p, clearances, saves, per_save, h, out)
    return out


def run_adaptive(p, clearance: float, saves: int, interval: float, rtol: float) -> Answer:
    """As `run`, under error control."""
    places = np.empty(saves)
    peak, tried = _run_adaptive(p, clearance, saves, interval, rtol, ATOL_SHARE * rtol, places)
    return Answer(places, peak, tried)


def batch_adaptive(
    p, clearances: np.ndarray, saves: int, interval: float, rtol: float
) -> np.ndarray:
    """As `batch`, under error control."""
    out = np.empty((len(clearances), 2))
    _batch_adaptive(p, clearances, saves, interval, rtol, ATOL_SHARE * rtol, out)
    return out
