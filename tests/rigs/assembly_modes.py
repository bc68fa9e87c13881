"""Linkages all of whose modes are known: by circles that meet, by the roots of one equation in one
angle, and of a spatial four-bar in closed form. Dimensions are drawn from a generator.

Places of bodies are (x, y, angle); in space a rocker's angle tells a mode."""

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import jaxclear as jc

REVOLUTE, MARKER = jc.joint.Revolute, jc.Marker


class Joint(NamedTuple):
    """A revolute joint: the bodies and where it lies in each; `angle`: at which a drive holds it
    (None: free)."""

    parent: str
    at: tuple
    child: str
    own: tuple = (0.0, 0.0)
    angle: float | None = None


class Linkage(NamedTuple):
    """Joints by name, all modes as places of all bodies, and what is held (`start`)."""

    joints: dict[str, Joint]
    modes: list[dict[str, tuple]]
    start: dict[str, tuple]

    def rig(self, guess=None):
        """The mechanism."""
        names = [name for joint in self.joints.values() for name in (joint.parent, joint.child)]
        bodies = {name: jc.Body(1.0, 1e-3) for name in dict.fromkeys(names) if name != "ground"}
        connections = {}
        for name, (parent, at, child, own, angle) in self.joints.items():
            drive = None if angle is None else jc.drive.ConstantSpeed(0.0, float(angle))
            ends = MARKER(parent, tuple(map(float, at))), MARKER(child, tuple(map(float, own)))
            connections[name] = jc.Connection(REVOLUTE(drive=drive), *ends)
        return jc.Mechanism(bodies, connections, start=self.start, guess=guess)

    def angle(self, mode, name):
        """Of a joint in a mode [rad]."""
        joint = self.joints[name]
        places = mode | {"ground": (0.0, 0.0, 0.0)}
        return wrapped(places[joint.child][2] - places[joint.parent][2])

    def angles(self, mode):
        """Of all joints that nothing drives."""
        return {n: self.angle(mode, n) for n, joint in self.joints.items() if joint.angle is None}


def wrapped(x):
    """An angle within half a turn."""
    return float(np.angle(np.exp(1j * x)))


def turned(angle):
    """The rotation by an angle."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def place(origin, towards):
    """Of a link with its x axis from one point to another."""
    way = np.subtract(towards, origin)
    return (float(origin[0]), float(origin[1]), float(np.arctan2(way[1], way[0])))


def meet(p, r, q, s):
    """Where two circles meet: twice, or nowhere."""
    way = np.subtract(q, p)
    far = np.hypot(*way)
    along = (far**2 + r**2 - s**2) / (2 * far)
    across = r**2 - along**2
    if across <= 0:
        return []
    normal = np.array([-way[1], way[0]]) / far
    return [p + along * way / far + side * np.sqrt(across) * normal for side in (1, -1)]


def four_bar(rng):
    """A crank that is held, with its 2 modes."""
    while True:
        crank, coupler, rocker, ground = rng.uniform(
            [0.08, 0.25, 0.2, 0.25], [0.15, 0.45, 0.4, 0.4]
        )
        angle = rng.uniform(-np.pi, np.pi)
        a, d = crank * turned(angle)[:, 0], np.array([ground, 0.0])
        ends = meet(a, coupler, d, rocker)
        if ends and np.linalg.norm(ends[0] - ends[1]) > 0.05:
            break
    joints = {
        "O": Joint("ground", (0.0, 0.0), "crank", angle=angle),
        "A": Joint("crank", (crank, 0.0), "coupler"),
        "B": Joint("coupler", (coupler, 0.0), "rocker", (rocker, 0.0)),
        "D": Joint("ground", (ground, 0.0), "rocker"),
    }
    modes = [
        {"crank": (0.0, 0.0, angle), "coupler": place(a, b), "rocker": place(d, b)} for b in ends
    ]
    return Linkage(joints, modes, {})


def watt(rng):
    """Watt's six-bar with its crank held: two dyads one after the other, 2 x 2 modes."""
    while True:
        angle = rng.uniform(-np.pi, np.pi)
        arm = 0.22 * turned(rng.uniform(0.4, 1.0))[:, 0]
        a, d, g = 0.1 * turned(angle)[:, 0], np.array([0.3, 0.0]), np.array([0.7, 0.0])
        modes = []
        for b in meet(a, 0.3, d, 0.25):
            follower = place(d, b)
            e = d + turned(follower[2]) @ arm
            modes += [
                {"a": (0.0, 0.0, angle), "b": place(a, b), "c": follower}
                | {"d": place(e, f), "e": place(g, f)}
                for f in meet(e, 0.5, g, 0.3)
            ]
        if len(modes) == 4:
            break
    joints = {
        "O": Joint("ground", (0.0, 0.0), "a", angle=angle),
        "A": Joint("a", (0.1, 0.0), "b"),
        "B": Joint("b", (0.3, 0.0), "c", (0.25, 0.0)),
        "D": Joint("ground", (0.3, 0.0), "c"),
        "E": Joint("c", tuple(arm), "d"),
        "F": Joint("d", (0.5, 0.0), "e", (0.3, 0.0)),
        "G": Joint("ground", (0.7, 0.0), "e"),
    }
    return Linkage(joints, modes, {})


def platforms(feet, pivots, lengths):
    """Places of a platform that three links hold, each turning about its foot: the angles at which
    three circles have a point in common, by the signs of one function of them."""

    def function(angle):
        centres = feet - pivots @ turned(angle).T
        rows = 2 * (centres[1:] - centres[0])
        sides = np.sum(centres**2, axis=1) - lengths**2
        sides = sides[1:] - sides[0]
        det, (one, other) = np.linalg.det(rows), rows
        found = np.array(
            [sides[0] * other[1] - sides[1] * one[1], one[0] * sides[1] - other[0] * sides[0]]
        )
        left = np.sum((found - det * centres[0]) ** 2) - (det * lengths[0]) ** 2
        return left, found / det

    grid = np.linspace(-np.pi, np.pi, 1441)
    values = np.array([function(x)[0] for x in grid])
    roots = [
        brentq(lambda x: function(x)[0], *grid[i : i + 2], xtol=1e-14)
        for i in np.flatnonzero(values[1:] * values[:-1] < 0)
    ]
    return [(*map(float, function(x)[1]), float(x)) for x in roots]


def held_by_links(feet, pivots, lengths):
    """(joints, places of links and platform) of a platform that three links hold."""
    joints, modes = {}, []
    for i in range(3):
        joints[f"P{i}"] = Joint(f"l{i}", (lengths[i], 0.0), "platform", tuple(pivots[i]))
    for at in platforms(feet, pivots, lengths):
        ends = np.array(at[:2]) + pivots @ turned(at[2]).T
        modes.append({"platform": at} | {f"l{i}": place(feet[i], ends[i]) for i in range(3)})
    return joints, modes


def triad(rng, count=None):
    """Stephenson's third six-bar, held where its crank ends: a platform on three links, of up to 6
    modes, or of so many."""
    while True:
        feet, pivots = rng.uniform(-0.3, 0.3, (2, 3, 2))
        pivots -= pivots.mean(axis=0)
        lengths = rng.uniform(0.1, 0.5, 3)
        joints, modes = held_by_links(feet, pivots, lengths)
        apart = np.diff(sorted(mode["platform"][2] for mode in modes))
        if (len(modes) == count or (count is None and modes)) and np.all(apart > 0.1):
            break
    joints |= {f"E{i}": Joint("ground", tuple(feet[i]), f"l{i}") for i in range(3)}
    return Linkage(joints, modes, {})


def _three_rrr(rng):
    """Bases, pivots of the platform, lengths of cranks and links, a place within reach, and where
    the elbows are there: both of each leg."""
    around = np.deg2rad([90.0, 210.0, 330.0])
    ring = np.stack([np.cos(around), np.sin(around)], axis=1)
    bases, pivots = 0.3 * ring, 0.1 * ring
    at = np.array([*rng.uniform(-0.04, 0.04, 2), rng.uniform(-0.3, 0.3)])
    ends = at[:2] + pivots @ turned(at[2]).T
    elbows = [meet(base, 0.18, end, 0.2) for base, end in zip(bases, ends, strict=True)]
    return bases, pivots, at, ends, elbows


def three_rrr_cranks_held(rng):
    """The planar 3-RRR with its cranks held: a platform on three links."""
    while True:
        bases, pivots, _, _, elbows = _three_rrr(rng)
        feet = np.array([own[rng.integers(2)] for own in elbows])
        joints, modes = held_by_links(feet, pivots, np.full(3, 0.2))
        apart = np.diff(sorted(mode["platform"][2] for mode in modes))
        if len(modes) == 2 and np.all(apart > 0.2):
            break
    cranks = {f"c{i}": place(bases[i], feet[i]) for i in range(3)}
    for i in range(3):
        angle = cranks[f"c{i}"][2]
        joints[f"O{i}"] = Joint("ground", tuple(bases[i]), f"c{i}", angle=angle)
        joints[f"E{i}"] = Joint(f"c{i}", (0.18, 0.0), f"l{i}")
    return Linkage(joints, [mode | cranks for mode in modes], {})


def three_rrr_platform_held(rng):
    """The same with its platform held and its cranks free: each elbow on one of two sides, 2^3
    modes."""
    bases, pivots, at, ends, elbows = _three_rrr(rng)
    joints, modes = {}, []
    for i in range(3):
        joints[f"O{i}"] = Joint("ground", tuple(bases[i]), f"c{i}")
        joints[f"E{i}"] = Joint(f"c{i}", (0.18, 0.0), f"l{i}")
        joints[f"P{i}"] = Joint(f"l{i}", (0.2, 0.0), "platform", tuple(pivots[i]))
    for sides in np.ndindex(2, 2, 2):
        mode = {"platform": tuple(map(float, at))}
        for i, side in enumerate(sides):
            elbow = elbows[i][side]
            mode |= {f"c{i}": place(bases[i], elbow), f"l{i}": place(elbow, ends[i])}
        modes.append(mode)
    return Linkage(joints, modes, {"platform": tuple(map(float, at))})


PLANAR = {
    "four-bar": four_bar,
    "Watt": watt,
    "triad": triad,
    "3-RRR, cranks held": three_rrr_cranks_held,
    "3-RRR, platform held": three_rrr_platform_held,
}


class Rssr(NamedTuple):
    """A spatial four-bar: crank and rocker on revolute joints, a coupler between two balls, which
    turns idly about its length. The rocker's axis is y; `modes`: its angles [rad]."""

    crank: float
    coupler: float
    rocker: float
    foot: tuple
    angle: float
    modes: list[float]

    def rig(self, guess=None):
        """The mechanism, its crank held."""
        inertia = (1e-3, 1e-3, 1e-3)
        driven = REVOLUTE(drive=jc.drive.ConstantSpeed(0.0, self.angle))
        ball, end = jc.joint.Spherical(), lambda name: MARKER(name, (getattr(self, name), 0.0, 0.0))
        feet = MARKER("ground", self.foot, axis="y"), MARKER("rocker", (0.0, 0.0, 0.0), axis="y")
        return jc.Mechanism(
            {name: jc.Body(1.0, inertia) for name in ("crank", "coupler", "rocker")},
            {
                "O": jc.Connection(driven, "ground", "crank"),
                "A": jc.Connection(ball, end("crank"), "coupler"),
                "B": jc.Connection(ball, end("coupler"), end("rocker")),
                "D": jc.Connection(REVOLUTE(), *feet),
            },
            guess=guess,
        )

    def ends(self, mode):
        """The balls' centres in a mode: on the crank, and on the rocker."""
        a = self.crank * np.array([np.cos(self.angle), np.sin(self.angle), 0.0])
        return a, np.array(self.foot) + self.rocker * np.array([np.cos(mode), 0.0, -np.sin(mode)])

    def coupler_at(self, mode, spin):
        """Place of the coupler, turned about its length: origin and unit quaternion."""
        a, b = self.ends(mode)
        x = (b - a) / np.linalg.norm(b - a)
        y = np.cross(x, [0.3, -0.5, 0.8])
        y /= np.linalg.norm(y)
        z = np.cross(x, y)
        y, z = np.cos(spin) * y + np.sin(spin) * z, np.cos(spin) * z - np.sin(spin) * y
        last = Rotation.from_matrix(np.stack([x, y, z], axis=1)).as_quat()
        return (*map(float, a), float(last[3]), *map(float, last[:3]))


def rssr(rng):
    """A spatial four-bar: |foot + rocker (cos, 0, -sin) - a| = coupler is p cos + q sin = r."""
    while True:
        crank, rocker = rng.uniform([0.08, 0.2], [0.15, 0.35])
        foot = rng.uniform([0.2, 0.1, -0.1], [0.4, 0.3, 0.1])
        angle = rng.uniform(-np.pi, np.pi)
        coupler = rng.uniform(0.3, 0.6)
        way = foot - crank * np.array([np.cos(angle), np.sin(angle), 0.0])
        p, q = 2 * rocker * way[0], -2 * rocker * way[2]
        r = coupler**2 - rocker**2 - way @ way
        size = np.hypot(p, q)
        if abs(r) < 0.95 * size:
            break
    modes = [wrapped(np.arctan2(q, p) + side * np.arccos(r / size)) for side in (1, -1)]
    return Rssr(crank, coupler, rocker, tuple(map(float, foot)), angle, modes)
