"""Derivatives of rigid contact in steps are those of the motion in joints of every kind: a slider
between two walls, a ball in space, and a pendulum that rests and is then struck. Beside
extrapolated differences of runs in steps a tenth as long.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

# Millions of steps: they take longer than a kernel takes to be optimised.
pytestmark = pytest.mark.usefixtures("optimised_kernels")
GRAVITY = jc.load.Gravity((0.0, -9.81))
STEP = 2e-7
# Shares of a number for differences: impacts must move by many of the short steps.
SHARES = 2e-2, 1e-2
JOINT = lambda rig: rig.connections["B"].joint
CLEARANCE = lambda rig: JOINT(rig).clearance


def guide(*laws):
    joint = jc.clearance.SliderGuide(*laws, clearance=1e-3)
    along = jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
    return jc.Mechanism(
        {"slider": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(joint, *along)},
        {"gravity": GRAVITY},
        start={"slider": (0.0, 0.0, 2e-3)},
        speeds={"slider": (0.1, -0.05, 0.3)},
    )


def ball(*laws):
    joint = jc.clearance.BallSocket(*laws, clearance=1e-3)
    return jc.Mechanism(
        {"ball": jc.Body(1.0, (1e-4, 1e-4, 1e-4))},
        {"B": jc.Connection(joint, "ground", "ball")},
        {"gravity": jc.load.Gravity((0.0, -9.81, 0.0))},
        speeds={"ball": (0.02, -0.05, 0.01, 1.0, 2.0, 0.0)},
    )


def blow(time):
    """Up to 60 N upwards [N], from 40 ms to 60 ms."""
    left = 1 - ((time - 0.05) / 0.01) ** 2
    return jnp.where(left > 0, left * left, 0.0) * jnp.array([3.0, 60.0])


def struck(*laws):
    joint = jc.clearance.PlanarJournalBearing(*laws, clearance=2e-4)
    struck = jc.Marker("rod", at=(0.0, -0.1))
    return jc.Mechanism(
        {"rod": jc.Body(1.0, 2e-3, com=(0.0, -0.1))},
        {"B": jc.Connection(joint, "ground", jc.Marker("rod"))},
        {"gravity": GRAVITY, "blow": jc.load.Force(struck, blow)},
        start={"rod": (0.0, -1.9e-4, 0.05)},
        speeds={"rod": (0.0, -0.01, 0.2)},
    )


# By joint: the mechanism, restitution, friction, ends of runs [s].
CASES = {
    "guide": (guide, 0.0, 0.3, 0.018, 0.03),
    "struck": (struck, 0.0, 0.3, 0.048, 0.07),
    "ball": (ball, 0.9, 0.3, 0.025, 0.06),
}


def asked(rig):
    """Places of all bodies and how far their speeds go in 10 ms [m], by clearance, start speed and
    gravity."""
    first = next(iter(rig.bodies))
    read = {
        f"{name}{k}{part}": lambda run, name=name, k=k, part=part: (
            run.body(name).com[-1, k] if part else 1e-2 * run.body(name).velocity[-1, k]
        )
        for name in rig.bodies
        for k in range(2)
        for part in (0, 1)
    }
    places = {
        "clearance": CLEARANCE,
        "speed": lambda rig: rig.speeds[first][1],
        "gravity": lambda rig: rig.loads["gravity"].acceleration[1],
    }
    return jc.Problem(
        rig,
        read,
        {name: jc.Variable(place, tolerance=1e-9) for name, place in places.items()},
        duration=0.01,
        integrator=jc.integrator.MoreauJean(),
        save=2,
        state=jc.State(concentric=False),
    )


def answers(problem):
    def answer(values, end, step):
        own = eqx.tree_at(lambda p: (p.duration, p.integrator.step), problem, (end, step))
        return jnp.stack(list(own.evaluate(values).responses.values()))

    return answer


def differences(answer, values, end):
    """(extrapolated differences, by how much they change with their step)."""
    whole, half = (
        np.stack(
            [(answer(values + w, end) - answer(values - w, end)) / (2 * w.sum()) for w in ways], -1
        )
        for ways in (share * np.diag(values) for share in SHARES)
    )
    return half + (half - whole) / 3, np.linalg.norm(half - whole, axis=0)


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize("name", CASES)
def test_every_joint_has_the_derivatives_of_its_motion(name):
    """To half a hundredth, as far as differences tell: 7e-4 measured where they tell it best."""
    rig, restitution, mu, *ends = CASES[name]
    friction = jc.friction.Coulomb(mu_kinetic=mu) if mu else None
    problem = asked(rig(jc.contact.Rigid(restitution=restitution), friction))
    answer, values = answers(problem), np.asarray(problem.nominal())
    slopes = jax.jit(jax.jacfwd(answer))
    run = jax.jit(lambda values, end: answer(values, end, STEP))
    for end in ends:
        found = np.asarray(slopes(values, end, STEP))
        wanted, scatter = differences(run, values, end)
        size = np.linalg.norm(wanted, axis=0)
        off = np.linalg.norm(found - wanted, axis=0)
        assert np.all(off < 5e-3 * size + scatter) and np.all(scatter < 0.1 * size)
