"""The four-bar with a spatial clearance joint and friction, written by hand in plain Python: an
oracle of its rates.

Same mechanism, coordinates and laws as `four_bar_variants.build(RUBBING)`; simplified by hand:
crank and coupler in the plane, the follower by its quaternion, gradients of the indentation worked
out on paper.
"""

from math import cos, pi, sin, sqrt
from typing import Any, NamedTuple

CRANK, COUPLER, FOLLOWER, GROUND, SPEED, GRAVITY = 0.1, 0.4, 0.3, 0.3, 10.0, 9.81
COUPLER_MASS, FOLLOWER_MASS, THIN = 1.44, 1.63, 1e-4
COUPLER_INERTIA = COUPLER_MASS * COUPLER**2 / 3
SWING_INERTIA = FOLLOWER_MASS * FOLLOWER**2 / 3
HALF_FOLLOWER = 0.5 * FOLLOWER * FOLLOWER_MASS
HALF_COUPLER = 0.5 * COUPLER * COUPLER_MASS
SLIP_ROUNDING = 1e-14


class Parameters(NamedTuple):
    """Numbers of the joint at B, SI units; `damping` is the factor d of the contact law."""

    clearance: Any
    radius: Any
    length: Any
    stiffness: Any
    damping: Any
    slowest: Any
    mu_static: Any
    mu_kinetic: Any
    static_speed: Any
    kinetic_speed: Any


def parameters(system: Any) -> Parameters:
    """The same numbers, from a prepared system."""
    bearing = system.bearings["B"]
    joint, contact, friction = (
        bearing.joint,
        bearing.contact_laws[0].contact,
        bearing.contact_laws[0].friction,
    )
    return Parameters(
        joint.clearance,
        joint.bearing_radius,
        joint.length,
        contact.stiffness,
        0.75 * (1 - contact.restitution**2),
        contact.memory.slowest_impact,
        friction.mu_static,
        friction.mu_kinetic,
        friction.static_speed,
        friction.kinetic_speed,
    )


def normal_force(p: Parameters, delta: float, rate: float, memory: float) -> float:
    """Of the contact law [N]."""
    if delta < 0:
        return 0.0
    speed = memory if memory > 0 else abs(rate)
    loss = max(1 + p.damping * rate / max(speed, p.slowest), 0.0)
    return p.stiffness * delta * sqrt(delta) * loss


def friction_coefficient(p: Parameters, speed: float) -> float:
    """Of the law of three zones."""
    if speed < p.static_speed:
        return p.mu_static * sin(pi / 2 * speed / p.static_speed)
    if speed > p.kinetic_speed:
        return p.mu_kinetic
    share = (speed - p.static_speed) / (p.kinetic_speed - p.static_speed)
    return p.mu_static + (p.mu_kinetic - p.mu_static) * (0.5 - 0.5 * cos(pi * share))


def end_force(p, z, u, a, s, velocity, spin, turning, memory):
    """One end of the bearing: force and torque on the journal."""
    rise = z - u[2]
    cx, cy = u[0] + rise * s[0], u[1] + rise * s[1]
    r = sqrt(cx * cx + cy * cy)
    nx, ny = cx / r, cy / r
    lean = s[0] * nx + s[1] * ny
    bend = (p.radius - p.clearance) * lean
    delta = r - p.clearance + 0.5 * bend * lean
    gx = nx + bend * (s[0] - lean * nx) / r
    gy = ny + bend * (s[1] - lean * ny) / r
    gz = -(gx * s[0] + gy * s[1])
    hx, hy = (rise * gx + bend * nx) / a[2], (rise * gy + bend * ny) / a[2]
    hz = -(hx * s[0] + hy * s[1])
    rate = gx * velocity[0] + gy * velocity[1] + gz * velocity[2]
    rate = rate + hx * turning[0] + hy * turning[1] + hz * turning[2]
    force = normal_force(p, delta, rate, memory)
    reach = p.radius + 0.5 * delta
    ax, ay, az = reach * nx - u[0], reach * ny - u[1], rise
    vx = velocity[0] + spin[1] * az - spin[2] * ay
    vy = velocity[1] + spin[2] * ax - spin[0] * az
    slip, along = nx * vy - ny * vx, velocity[2] + spin[0] * ay - spin[1] * ax
    speed = sqrt(slip * slip + along * along + SLIP_ROUNDING * SLIP_ROUNDING)
    drag = -force * friction_coefficient(p, speed) / speed
    tx, ty, tz = -drag * slip * ny, drag * slip * nx, drag * along
    fx, fy, fz = tx - force * gx, ty - force * gy, tz - force * gz
    mx = ay * tz - az * ty - force * (a[1] * hz - a[2] * hy)
    my = az * tx - ax * tz - force * (a[2] * hx - a[0] * hz)
    mz = ax * ty - ay * tx - force * (a[0] * hy - a[1] * hx)
    return fx, fy, fz, mx, my, mz


def rate(time: float, y: Any, p: Parameters) -> tuple[float, ...]:
    """Of the state (11,) at a time [s]."""
    phi, q = SPEED * time, y[0]
    sphi, cphi, sq, cq = sin(phi), cos(phi), sin(q), cos(q)
    c, s = cphi * cq - sphi * sq, sphi * cq + cphi * sq
    w, x, yy, z = y[1], y[2], y[3], y[4]
    qd, o1, o2, o3 = y[5], y[6], y[7], y[8]
    k = 2.0 / (w * w + x * x + yy * yy + z * z)
    r00, r01, r02 = 1 - k * (yy * yy + z * z), k * (x * yy - w * z), k * (x * z + w * yy)
    r10, r11, r12 = k * (x * yy + w * z), 1 - k * (x * x + z * z), k * (yy * z - w * x)
    r20, r21, r22 = k * (x * z - w * yy), k * (yy * z + w * x), 1 - k * (x * x + yy * yy)
    turn = SPEED + qd
    # Journal in the bearing: place, axis, velocity and spin, in the coupler's axes.
    gx, gy = GROUND + FOLLOWER * r00 - CRANK * cphi, FOLLOWER * r10 - CRANK * sphi
    u = (c * gx + s * gy - COUPLER, c * gy - s * gx, FOLLOWER * r20)
    a = (c * r02 + s * r12, c * r12 - s * r02, r22)
    slope = (a[0] / a[2], a[1] / a[2])
    b1, b2 = FOLLOWER * o3, -FOLLOWER * o2
    vx, vy, vz = r01 * b1 + r02 * b2, r11 * b1 + r12 * b2, r21 * b1 + r22 * b2
    velocity = (
        c * vx + s * vy - CRANK * SPEED * sq + turn * u[1],
        c * vy - s * vx - CRANK * SPEED * cq - turn * (COUPLER + u[0]),
        vz,
    )
    wx, wy = r00 * o1 + r01 * o2 + r02 * o3, r10 * o1 + r11 * o2 + r12 * o3
    spin = (c * wx + s * wy, c * wy - s * wx, r20 * o1 + r21 * o2 + r22 * o3 - turn)
    turning = (
        spin[1] * a[2] - spin[2] * a[1],
        spin[2] * a[0] - spin[0] * a[2],
        spin[0] * a[1] - spin[1] * a[0],
    )
    half = 0.5 * p.length
    e = end_force(p, -half, u, a, slope, velocity, spin, turning, y[9])
    f = end_force(p, half, u, a, slope, velocity, spin, turning, y[10])
    fx, fy, fz = e[0] + f[0], e[1] + f[1], e[2] + f[2]
    mx, my, mz = e[3] + f[3], e[4] + f[4], e[5] + f[5]
    # Coupler about A.
    moment = -(mz + (COUPLER + u[0]) * fy - u[1] * fx)
    qdd = (moment - HALF_COUPLER * (CRANK * SPEED * SPEED * sq + GRAVITY * c)) / COUPLER_INERTIA
    # Follower about D, in its own axes.
    hx, hy, nx, ny = c * fx - s * fy, s * fx + c * fy, c * mx - s * my, s * mx + c * my
    f2 = r01 * hx + r11 * hy + r21 * fz
    f3 = r02 * hx + r12 * hy + r22 * fz
    t1 = r00 * nx + r10 * ny + r20 * mz
    t2 = r01 * nx + r11 * ny + r21 * mz - FOLLOWER * f3 + HALF_FOLLOWER * GRAVITY * r12
    t3 = r02 * nx + r12 * ny + r22 * mz + FOLLOWER * f2 - HALF_FOLLOWER * GRAVITY * r11
    d2 = (t2 - (THIN - SWING_INERTIA) * o3 * o1) / SWING_INERTIA
    d3 = (t3 - (SWING_INERTIA - THIN) * o1 * o2) / SWING_INERTIA
    return (
        qd,
        0.5 * (-x * o1 - yy * o2 - z * o3),
        0.5 * (w * o1 + yy * o3 - z * o2),
        0.5 * (w * o2 + z * o1 - x * o3),
        0.5 * (w * o3 + x * o2 - yy * o1),
        qdd,
        t1 / THIN,
        d2,
        d3,
        0.0,  # impact speeds stand still
        0.0,
    )
