"""Moreau-Jean steps beside Siconos: balls that bounce, a column of beads, Glocker's woodpecker.

Reference: siconos-tutorials b6c9bfd (2024-07-24); a few rows of each are in
refdata/siconos_rigid.json."""

import json
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.complementarity import FrictionContact, ProjectedGaussSeidel
from jaxclear.components.clearance import AbstractClearance, ContactCandidate, ContactLaws
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.stiffness import Shape

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata" / "siconos_rigid.json").read_text())
GRAVITY = 9.81
# What a carriage without mass weighs: below rounding of the ball's kilogram.
NOTHING = 1e-20


class Wall(AbstractClearance):
    """The child's origin stays at least `reach` above the parent's along x."""

    ideal_rows: ClassVar = ("x",)
    contact: AbstractNormalLaw
    friction: Any = None
    reach: Any = 0.0

    @property
    def axes(self):
        return ()

    def contact_laws(self):
        return (ContactLaws(self.contact, self.friction, Shape(1e-2, 1.0, None), False),)

    def indentations(self, offset, axes, worn):
        return (self.reach - offset[0],)

    def contact_candidates(self, offset, axes, indentations):
        return (ContactCandidate((offset[0] - self.reach, offset[1], 0), (-1, 0, 0), ((0, 1, 0),)),)

    def maps(self):
        return {}

    def features(self, surface, offset, axes, indentations, index):
        raise NotImplementedError


def up(child):
    return jc.Connection(jc.joint.Prismatic(), "ground", child, axis="x")


def run(case, mechanism, integrator):
    times = np.arange(case["steps"] + 1) * case["step"]
    return jc.simulate(
        mechanism, times[-1], save=times, integrator=integrator, state=jc.State(concentric=False)
    )


def integrator(case, **more):
    """One step to a saving interval, whose length rounds."""
    return jc.integrator.MoreauJean(case["step"] * (1 + 1e-6), project=False, **more)


def rows(case, *columns):
    """Rows kept of the reference, and the run's columns there."""
    kept = np.array(case["rows"])
    return np.array(case["values"]), np.stack([np.asarray(c)[kept] for c in columns], 1)


def bouncing_ball(restitution):
    wall = Wall(jc.contact.Rigid(restitution=restitution))
    return jc.Mechanism(
        {"ball": jc.Body(1.0, 0.1)},
        {"up": up("ball"), "floor": jc.Connection(wall, "ground", "ball")},
        {"gravity": jc.load.Gravity((-GRAVITY, 0.0))},
        start={"up": 1.0},
    )


def test_bouncing_ball():
    case = REFERENCE["bouncing_ball"]
    found = run(case, bouncing_ball(0.9), integrator(case))
    expected, own = rows(case, found.coordinate("up"), found.speed("up"))
    np.testing.assert_allclose(own, expected, atol=case["tolerance"])


@pytest.mark.slow
def test_ball_with_friction_and_spin():
    case = REFERENCE["ball_with_friction"]
    mass, radius = 1.0, 0.5
    wall = Wall(jc.contact.Rigid(restitution=0.9), jc.friction.Coulomb(mu_kinetic=0.1), radius)
    carriage = jc.Body(NOTHING, (NOTHING,) * 3)
    mechanism = jc.Mechanism(
        {"lift": carriage, "slide": carriage, "ball": jc.Body(mass, (0.4 * mass * radius**2,) * 3)},
        {
            "up": up("lift"),
            "aside": jc.Connection(jc.joint.Prismatic(), "lift", "slide", axis="y"),
            "spin": jc.Connection(jc.joint.Revolute(), "slide", "ball"),
            "floor": jc.Connection(wall, "ground", "ball"),
        },
        {"gravity": jc.load.Gravity((-GRAVITY, 0.0, 0.0))},
        start={"up": 1.0},
        speeds={"spin": (2.0,)},
    )
    found = run(case, mechanism, integrator(case, gamma=1.0))
    expected, own = rows(case, found.coordinate("up"), found.speed("up"), found.speed("spin"))
    np.testing.assert_allclose(own, expected, atol=case["tolerance"])


def beads(count, restitution, mass, place, floor):
    """Balls of radius 0.1 above one another, the lowest one `floor` above the ground."""
    radius = 0.1
    names = [f"bead{i}" for i in range(count)]
    law = jc.contact.Rigid(restitution=restitution)
    contact_candidates = {"floor": jc.Connection(Wall(law, reach=floor), "ground", names[0])}
    contact_candidates |= {
        f"c{i}": jc.Connection(Wall(law, reach=2 * radius), names[i], names[i + 1])
        for i in range(count - 1)
    }
    return jc.Mechanism(
        {name: jc.Body(mass(i), 0.1) for i, name in enumerate(names)},
        {f"up{i}": up(name) for i, name in enumerate(names)} | contact_candidates,
        {"gravity": jc.load.Gravity((-GRAVITY, 0.0))},
        start={f"up{i}": place(i) for i in range(count)},
    )


def agree_on_beads(case, mechanism, **more):
    found = run(case, mechanism, integrator(case, max_sweeps=5000.0, tolerance=1e-15, **more))
    count = len(mechanism.bodies)
    columns = [part(f"up{i}") for i in range(count) for part in (found.coordinate, found.speed)]
    expected, own = rows(case, *columns)
    np.testing.assert_allclose(own, expected, atol=case["tolerance"])


def test_two_balls():
    # Its contacts count as closed one step and a half before they are: read from the reference's
    # own instants.
    mechanism = beads(2, 0.95, lambda i: 1.0 + i, lambda i: 0.1 + 0.201 * i, floor=0.0)
    agree_on_beads(REFERENCE["two_balls"], mechanism, gamma=1.5)


@pytest.mark.slow
def test_column_of_beads():
    agree_on_beads(
        REFERENCE["column_of_beads"],
        beads(10, 0.9, lambda i: 1.0, lambda i: 1.0 + 0.25 * i, floor=0.1),
    )


def woodpecker(case):
    """Linear equations, implicit in the spring (Glocker's toy): position and speed at every
    step."""
    d = case["data"]
    mass, moment, lm, lg = d["mS"], d["JS"], d["lM"], d["lG"]
    whole = mass + d["mM"]
    inertia = np.array(
        [
            [whole, mass * lm, mass * lg],
            [mass * lm, d["JM"] + mass * lm**2, mass * lm * lg],
            [mass * lg, mass * lm * lg, moment + mass * lg**2],
        ]
    )
    spring = d["c_phi"] * np.array([[0, 0, 0], [0, 1, -1], [0, -1, 1]])
    weight = -GRAVITY * np.array([whole, mass * lm, mass * lg])
    normal = np.array([[0, 0, -d["hS"]], [0, d["hM"], 0], [0, -d["hM"], 0]])
    gaps = np.array([lm + lg - d["lS"] - d["rO"], d["rM"] - d["rO"], d["rM"] - d["rO"]])
    tangent = np.array([[1, lm, lg - d["lS"]], [1, d["rM"], 0], [1, d["rM"], 0]])
    across = np.stack([normal, tangent], 1).reshape(6, 3)
    h, theta = case["step"], 0.5
    solve = np.linalg.inv(inertia + (h * theta) ** 2 * spring)
    delassus = across @ solve @ across.T

    def step(carry, _):
        q, v = carry
        smooth = v + solve @ (h * weight - h * spring @ q - h * h * theta * spring @ v)
        before = (across @ v).reshape(3, 2)
        active = gaps + normal @ (q + 0.5 * h * v) <= 0
        restitution, mu = jnp.array([0.5, 0.0, 0.0]), jnp.full(3, 0.3)
        wanted = (across @ smooth).reshape(3, 2).at[:, 0].add(restitution * before[:, 0])
        problem = FrictionContact(delassus, wanted.reshape(-1), mu, active=active)
        percussion = ProjectedGaussSeidel(1e-15, 2000).iterate(problem).z
        after = smooth + solve @ (across.T @ percussion)
        q = q + h * (theta * after + (1 - theta) * v)
        return (q, after), (q, after)

    first = (jnp.array(case["q0"]), jnp.array(case["v0"]))
    q, v = jax.jit(lambda: jax.lax.scan(step, first, length=case["steps"])[1])()
    return np.vstack([first[0], q]), np.vstack([first[1], v])


@pytest.mark.slow
def test_woodpecker():
    case = REFERENCE["woodpecker"]
    q, v = woodpecker(case)
    expected, own = rows(case, *[column for i in range(3) for column in (q[:, i], v[:, i])])
    np.testing.assert_allclose(own[:, ::2], expected[:, ::2], atol=case["tolerance"])
    np.testing.assert_allclose(own[:, 1::2], expected[:, 1::2], atol=case["tolerance_speed"])


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9])
def test_bounces_have_the_closed_form_s_times(restitution):
    """Impacts at t1 = sqrt(2 H / g), then every 2 e^k t1 (Zeno); a step's error for each."""
    step = 1e-3
    times = np.arange(0, 1.2, step)
    how = {"integrator": jc.integrator.MoreauJean(step), "state": jc.State(concentric=False)}
    found = jc.simulate(bouncing_ball(restitution), times[-1], save=times, **how)
    speed, first = np.asarray(found.speed("up")), np.sqrt(2 / GRAVITY)
    impacts = times[1:][np.diff(speed) > 1.0]
    shares = restitution ** np.arange(4.0)
    expected = first + 2 * first * (np.cumsum(shares) - 1.0)
    expected = expected[(shares > 0.3) & (expected < times[-1])]
    assert len(impacts) >= len(expected)
    for k, instant in enumerate(expected):
        assert abs(impacts[k] - instant) < (2 * k + 1) * 1.5 * step
    assert np.min(found.coordinate("up")) > -step * np.sqrt(2 * GRAVITY)
