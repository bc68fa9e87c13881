"""Independent models for the antenna's tests, in numpy: nothing of jaxclear's equations, only its
numbers.

`Antenna`: three free bodies by Newton and Euler, held together by multipliers (maximal coordinates,
rotation matrices, RK4), joints rubbing with arm x sum over the bearing's ends of sin(atan mu) |R|.
It slides only; it knows no sticking. `pendulum`: a link on a rubbing pin in the plane, stick and
slip as phases between located events."""

import numpy as np
from scipy.integrate import solve_ivp


def skew(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


class Antenna:
    """The bodies of a jaxclear antenna. `ends`: 1 for a planar bearing, 2 for a spatial one.
    `mu(slip speed)`."""

    names = ("satellite", "link1", "link2")

    def __init__(self, rig, torques, mu, ends):
        bodies = [rig.bodies[name] for name in self.names]
        self.mass = [float(b.mass) for b in bodies]
        self.inertia = [np.diag([float(x) for x in b.inertia]) for b in bodies]
        com = [np.zeros(3) if b.com is None else np.array(list(map(float, b.com))) for b in bodies]
        self.torques, self.mu, self.ends = torques, mu, ends
        bearing = rig.connections["J1"].joint
        self.radius = float(bearing.bearing_radius - bearing.clearance)
        self.length = float(bearing.length)
        # (parent, child, arms from the centres of mass, axis) in body axes.
        self.joints = []
        for k, (name, axis) in enumerate((("J1", 2), ("J2", 0))):
            at = np.array([float(x) for x in rig.connections[name].parent.at])
            frame = np.roll(np.eye(3), -axis - 1, axis=0)
            self.joints.append((k, k + 1, at - com[k], -com[k + 1], frame))
        tops = [np.zeros(3)]
        for k, name in enumerate(("J1", "J2")):
            tops.append(tops[k] + [float(x) for x in rig.connections[name].parent.at])
        still = [*np.eye(3).ravel(), *np.zeros(6)]
        self.start = np.array(
            [x for t, c in zip(tops, com, strict=True) for x in (*(t + c), *still)]
        )

    def unpack(self, state):
        return [(p[:3], p[3:12].reshape(3, 3), p[12:15], p[15:]) for p in state.reshape(3, 18)]

    def rates(self, time, state):
        bodies = self.unpack(state)
        size = 18 + 10
        matrix, right = np.zeros((size, size)), np.zeros((size, 3))
        for k, (_, R, _, w) in enumerate(bodies):
            inertia = R @ self.inertia[k] @ R.T
            matrix[6 * k : 6 * k + 3, 6 * k : 6 * k + 3] = self.mass[k] * np.eye(3)
            matrix[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6] = inertia
            right[6 * k + 3 : 6 * k + 6, 0] -= np.cross(w, inertia @ w)
        axes, slips = [], []
        for number, (i, j, a, b, frame) in enumerate(self.joints):
            (_, Ri, _, wi), (_, Rj, _, wj) = bodies[i], bodies[j]
            a, b, (n1, n2, n) = Ri @ a, Rj @ b, frame @ Ri.T
            rows = np.zeros((5, 18))
            rows[:3, 6 * j : 6 * j + 6] = np.hstack([np.eye(3), -skew(b)])
            rows[:3, 6 * i : 6 * i + 6] = -np.hstack([np.eye(3), -skew(a)])
            for row, across in ((3, n1), (4, n2)):
                rows[row, 6 * j + 3 : 6 * j + 6], rows[row, 6 * i + 3 : 6 * i + 6] = across, -across
            bias = np.cross(wj, np.cross(wj, b)) - np.cross(wi, np.cross(wi, a))
            turning = [np.cross(wi, across) @ (wj - wi) for across in (n1, n2)]
            first = 18 + 5 * number
            matrix[first : first + 5, :18], matrix[:18, first : first + 5] = rows, -rows.T
            right[first : first + 5, 0] = -np.array([*bias, *turning])
            right[6 * j + 3 : 6 * j + 6, 0] += self.torques[number](time) * n
            right[6 * i + 3 : 6 * i + 6, 0] -= self.torques[number](time) * n
            right[6 * j + 3 : 6 * j + 6, 1 + number] += n
            right[6 * i + 3 : 6 * i + 6, 1 + number] -= n
            axes.append((n1, n2, n))
            slips.append(self.radius * (wj - wi) @ n)
        base, *units = np.linalg.solve(matrix, right).T
        friction = np.zeros(2)
        for _ in range(50):
            before = friction
            found = base + sum(f * unit for f, unit in zip(friction, units, strict=True))
            rubbing = (self._friction(found[18 + 5 * k :], axes[k], slips[k]) for k in range(2))
            friction = np.array(list(rubbing))
            if np.abs(friction - before).max() < 1e-14:
                break
        self.friction = friction
        out = []
        for k, (_, R, v, w) in enumerate(bodies):
            out.append(np.concatenate([v, (skew(w) @ R).ravel(), found[6 * k : 6 * k + 6]]))
        return np.concatenate(out)

    def _friction(self, multipliers, axes, slip):
        n1, n2, n = axes
        force, torque = multipliers[:3], multipliers[3] * n1 + multipliers[4] * n2
        across = force - (force @ n) * n
        pair = np.cross(torque, n) / self.length
        ends = [across] if self.ends == 1 else [across / 2 + s * pair for s in (-1, 1)]
        sizes = sum(map(np.linalg.norm, ends))
        mu = self.mu(abs(slip))
        return -np.sign(slip) * self.radius * mu / np.sqrt(1 + mu * mu) * sizes

    def speeds(self, state):
        bodies = self.unpack(state)
        return [
            (bodies[j][3] - bodies[i][3]) @ (bodies[i][1] @ frame[2])
            for i, j, _, _, frame in self.joints
        ]

    def run(self, duration, step, every=1):
        """Speeds of both joints at every `every`-th step."""
        state, out = self.start, []
        for k in range(round(duration / step) + 1):
            if k % every == 0:
                out.append(self.speeds(state))
            t = k * step
            k1 = self.rates(t, state)
            k2 = self.rates(t + step / 2, state + step / 2 * k1)
            k3 = self.rates(t + step / 2, state + step / 2 * k2)
            k4 = self.rates(t + step, state + step * k3)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return np.array(out)


def pendulum(mass, inertia, arm, radius, mu_kinetic, mu_static, weight, torque, times):
    """(angle, speed) at `times` of a link whose centre of mass hangs `arm` below a rubbing pin,
    from rest at angle 0; and how often it stuck."""
    grip = lambda mu: radius * mu / np.sqrt(1 + mu * mu)
    about = inertia + mass * arm**2

    def load(angle, speed, acceleration):
        along = mass * (-arm * speed**2) - weight * np.cos(angle)
        return np.hypot(along, mass * arm * acceleration + weight * np.sin(angle))

    def acceleration(time, angle, speed, sign):
        found = 0.0
        for _ in range(60):
            rubs = sign * grip(mu_kinetic) * load(angle, speed, found)
            found = (demand(time, angle) - rubs) / about
        return found

    def demand(time, angle):
        return torque(time) - weight * arm * np.sin(angle)

    def breaks(time, angle):
        return abs(demand(time, angle)) - grip(mu_static) * load(angle, 0.0, 0.0)

    time, angle, sticks, filled = 0.0, 0.0, 0, np.zeros((len(times), 2))
    end = times[-1]
    while time < end:
        if breaks(time, angle) < 0:
            sticks += 1
            event = lambda t, y, angle=angle: breaks(t, angle)
            event.terminal, event.direction = True, 1
            rate, start, how = (lambda t, y: [0.0, 0.0]), [angle, 0.0], {"max_step": 1e-2}
        else:
            sign = np.sign(demand(time, angle))
            event = lambda t, y: y[1]
            event.terminal, event.direction = True, -sign
            rate = lambda t, y, sign=sign: [y[1], acceleration(t, *y, sign)]
            start, how = [angle, sign * 1e-12], {"rtol": 1e-10, "atol": 1e-12}
        phase = solve_ivp(rate, (time, end), start, events=event, dense_output=True, **how)
        inside = (times >= time) & (times <= phase.t[-1])
        filled[inside] = phase.sol(times[inside]).T
        time, angle = phase.t[-1], phase.y[0, -1]
        time += 1e-13
    return filled, sticks
