"""Clutches and brakes that a signal presses: a function of time, or the force of something else."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.cells import slow

MASS = 2.0
STEPS = {
    "adaptive": jc.integrator.Adaptive(),
    "fixed": jc.integrator.FixedStep(1e-3),
    "implicit": jc.integrator.ImplicitStep(1e-3),
    "rigid": jc.integrator.MoreauJean(1e-3),
    "permanent": jc.integrator.NonColliding(1e-3),
}


def each(*fast):
    """Steps of every kind, those that are not fast marked slow."""
    return [pytest.param(n, marks=() if n in fast else pytest.mark.slow) for n in STEPS]


def ran(rig, duration, integrator, save=2):
    return jc.simulate(rig, duration, integrator=integrator, save=save, balance=True, verify=False)


def last(run, what, name):
    return float(np.ravel(getattr(run, what)(name))[-1])


def slide(*loads, speed=0.0):
    return jc.Mechanism(
        {"block": jc.Body(MASS, 1e-3)},
        {"slide": jc.Connection(jc.joint.Prismatic(), "ground", "block", axis="x")},
        {f"load {i}": load for i, load in enumerate(loads)},
        speeds={"slide": speed},
    )


@pytest.mark.parametrize("kind", each("adaptive", "rigid"))
def test_a_brake_holds_until_it_is_let_go_below_what_pulls(kind):
    """Under 2 N, by 5 - 2 t: at rest up to 1.5 s, then m q'' = 2 t - 3; from 2.5 s on nothing
    holds, and the negative rest of the signal counts as 0."""
    brake = jc.load.JointFriction("slide", lambda t: 5.0 - 2.0 * t)
    run = ran(slide(brake, jc.load.JointTorque("slide", 2.0)), 3.0, STEPS[kind], save=31)
    slid = np.clip(np.asarray(run.time) - 1.5, 0.0, 1.0)
    free = np.maximum(np.asarray(run.time) - 2.5, 0.0)
    way = (slid**3 / 3 + slid**2 * free + free**2) / MASS
    np.testing.assert_allclose(np.ravel(run.coordinate("slide")), way, atol=3e-3)
    held = -np.asarray(run.transmitted("load 0"))
    np.testing.assert_allclose(held[[5, 10, 27]], [2.0, 2.0, 0.0], atol=0.01)
    # What a signal gives a bristle counts as lost, so that the balance closes.
    assert np.abs(run.energy_balance().error).max() < 1e-4


def pulses(most):
    """A clutch that is pressed twice, by 0 to `most` and back."""
    return lambda t: most * jnp.maximum(jnp.sin(2 * jnp.pi * t), 0.0)


@pytest.mark.parametrize("kind", each("fixed", "permanent"))
def test_what_a_clutch_takes_from_a_shaft_is_the_impulse_of_its_signal(kind):
    run = ran(slide(jc.load.JointFriction("slide", pulses(3.0)), speed=5.0), 2.0, STEPS[kind])
    np.testing.assert_allclose(last(run, "speed", "slide"), 5.0 - 2 * 3.0 / np.pi / MASS, rtol=2e-4)


@pytest.mark.parametrize("kind", ["permanent", *slow("adaptive", "rigid")])
def test_derivatives_go_by_the_friction_of_a_clutch(kind):
    """Of Adaptive through a bristle that it resolves; through a stiffer one, as by default, they
    are that or nan."""

    def slope(**bristle):
        def end(most):
            clutch = jc.load.JointFriction("slide", pulses(most), **bristle)
            rig = slide(clutch, speed=5.0)
            run = jc.simulate(rig, 2.0, integrator=STEPS[kind], save=2, throw=False, verify=False)
            return run.speed("slide").ravel()[-1]

        return jax.jvp(end, (3.0,), (1.0,))[1]

    wanted, usual = -2 / np.pi / MASS, slope()
    if kind == "adaptive":
        np.testing.assert_allclose(slope(presliding=1e-4), wanted, rtol=1e-3)
        if np.isnan(usual):
            assert jc.explain_nan(usual)
            return
    np.testing.assert_allclose(usual, wanted, rtol=1e-3)


STIFFNESS, INERTIA, START = 800.0, 0.05, 0.01


def brake(by="pad spring", factor=0.02, **more):
    """A wheel and a pad that swings on its spring as a cosine of 20 rad/s and presses the wheel."""
    return jc.Mechanism(
        {"wheel": jc.Body(1.0, INERTIA), "pad": jc.Body(MASS, 1e-3)},
        {
            "axle": jc.Connection(jc.joint.Revolute(), "ground", "wheel"),
            "pad": jc.Connection(jc.joint.Prismatic(), "ground", "pad", axis="x"),
        },
        {
            "pad spring": jc.load.JointSpring("pad", STIFFNESS),
            "brake": jc.load.JointFriction("axle", jc.load.Pressed(by, factor)),
            **more.pop("loads", {}),
        },
        start={"pad": START},
        speeds={"axle": 40.0},
        **more,
    )


@pytest.mark.parametrize("kind", each("implicit", "rigid"))
def test_a_brake_takes_its_share_of_the_force_that_presses_it(kind):
    """The spring's force is k x_0 |cos(20 t)|: over half a turn its impulse is 2 k x_0 / 20."""
    run = ran(brake(), np.pi / 20, STEPS[kind])
    taken = 0.02 * 2 * STIFFNESS * START / 20 / INERTIA
    np.testing.assert_allclose(last(run, "speed", "axle"), 40.0 - taken, rtol=2e-4)


@pytest.mark.parametrize("kind", [*slow("adaptive"), "rigid"])
def test_derivatives_go_by_the_factor_of_what_presses(kind):
    def end(factor):
        where = lambda own: own.loads["brake"].torque.factor
        rig = eqx.tree_at(where, brake(), factor)
        run = jc.simulate(
            rig, np.pi / 20, integrator=STEPS[kind], save=2, throw=False, verify=False
        )
        return run.speed("axle").ravel()[-1]

    slope = jax.jvp(end, (0.02,), (1.0,))[1]
    np.testing.assert_allclose(slope, -2 * STIFFNESS * START / 20 / INERTIA, rtol=1e-3)


@pytest.mark.parametrize("kind", ["adaptive", *slow("permanent")])
def test_a_coupling_that_is_a_force_presses_as_a_load_does(kind):
    """A rope of the spring's stiffness, taut throughout, in the spring's place."""
    rope = jc.coupling.Rope(("pad",), (1.0,), stiffness=STIFFNESS, pretension=20.0)
    loads = {"pad spring": jc.load.JointTorque("pad", 20.0)}
    rig = brake("rope", loads=loads, couplings={"rope": rope})
    run = ran(rig, np.pi / 20, STEPS[kind])
    taken = 0.02 * 20.0 * (np.pi / 20) / INERTIA
    np.testing.assert_allclose(last(run, "speed", "axle"), 40.0 - taken, rtol=2e-4)


PLAY = {"play": 1e-3, "stiffness": 100.0, "damping": 0.1}
REFUSED = {
    "nothing of this name": (lambda: brake("pad sprnig"), "does not exist|pad spring"),
    "a rigid coupling": (
        lambda: brake("tie", couplings={"tie": jc.coupling.Ratio("axle", "pad", 10.0)}),
        'load "brake" is pressed by coupling "tie", which is rigid.*stiffness',
    ),
    "a stop": (
        lambda: brake("stop", loads={"stop": jc.load.JointStop("pad", upper=0.1, restitution=0.5)}),
        'pressed by load "stop", a JointStop, whose force steps find',
    ),
    "a seated play": (
        lambda: ran(
            brake("tie", couplings={"tie": jc.coupling.Ratio("axle", "pad", 10.0, **PLAY)}),
            0.1,
            STEPS["permanent"],
        ),
        'coupling "tie", whose play integrator.NonColliding takes as seated',
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_press_is_refused(what):
    make, sentence = REFUSED[what]
    with pytest.raises(ValueError, match=sentence):
        make()


class Halved(jc.load.JointFriction):
    """Friction of which an effect of its own lets half act."""

    def effect(self, time, positions, speeds, states):
        found = super().effect(time, positions, speeds, states)
        return found._replace(forces=(0.5 * found.forces[0],))


class HalvedEverywhere(Halved):
    def dry_friction(self):
        return 0.5 * self.torque


@pytest.mark.parametrize("kind", ["rigid", "permanent"])
def test_an_effect_for_which_steps_do_not_ask_is_refused(kind):
    name = type(STEPS[kind]).__name__
    with pytest.raises(
        ValueError, match=f'"load 0" is a Halved with an effect.*{name} does not ask'
    ):
        ran(slide(Halved("slide", 3.0), speed=5.0), 0.1, STEPS[kind])
    found = ran(slide(HalvedEverywhere("slide", 3.0), speed=5.0), 1.0, STEPS[kind])
    np.testing.assert_allclose(last(found, "speed", "slide"), 5.0 - 1.5 / MASS, rtol=1e-9)
