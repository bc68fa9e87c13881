"""The implicit rung: its dissipation in closed form, energy at every stiffness and clearance,
derivatives, loops, memories.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.multibody.assembly import guess
from jaxclear.simulation.loop import Extras, run
from tests.rigs.falling_journal import touching_journal
from tests.rigs.full_loop import full_loop

STEP = 1e-4
PRESSED = {"load": jc.load.Force(jc.Marker("journal"), (0.0, -300.0, 0.0))}
THROWN = jc.State(concentric=False)


def held_journal(law, clearance=1e-4, speeds=(0.0, 0.0, 0.0), **rest):
    joint = jc.clearance.PlanarJournalBearing(law, clearance=clearance)
    connections = {"B": jc.Connection(joint, "ground", "journal")}
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)}, connections, speeds={"journal": speeds}, **rest
    )


@pytest.mark.parametrize("rebound", [1.0, 0.9, 0.0])
@pytest.mark.parametrize("angle", [0.3, 3.0])
def test_linear_contact_is_damped_as_by_the_theta_method(rebound, angle):
    """A spring contact that weight keeps closed; |lambda|^2 = (1 + (1 - theta)^2 z^2) / (1 +
    theta^2 z^2).
    """
    stiffness = (angle / STEP) ** 2
    depth = 9.81 / stiffness
    rig = held_journal(
        jc.contact.KelvinVoigt(stiffness=stiffness, damping=0.0),
        loads={"gravity": jc.load.Gravity((9.81, 0.0))},
        start={"journal": (1e-4 + 1.2 * depth, 0.0, 0.0)},
    )
    integrator = jc.integrator.ImplicitStep(STEP, rebound=rebound, newton_iterations=2)
    run = jc.simulate(rig, 8 * STEP, save=9, integrator=integrator, state=THROWN)
    path = np.asarray(run.states[:, 0])
    assert (path > 1e-4).all()
    # d(n+2) = trace d(n+1) - determinant d(n) for any linear method; differences d drop the
    # equilibrium.
    d = np.diff(path)
    if rebound > 0 or angle < 1:
        _, determinant = np.linalg.lstsq(np.stack([d[1:-1], -d[:-2]], axis=1), d[2:], rcond=None)[0]
        theta = 1 / (1 + rebound)
        wanted = (1 + (1 - theta) ** 2 * angle**2) / (1 + theta**2 * angle**2)
        # indentations are differences of lengths of 1e-4 m: rounding of 1e-20 m against amplitudes
        # of 1e-9 m and more
        assert determinant == pytest.approx(wanted, rel=1e-6)
    else:
        assert np.abs(d[-1]) < np.abs(d[0]) * (1 + angle**2) ** -3


@pytest.mark.slow
@pytest.mark.parametrize(("clearance", "step"), [(1e-4, 1e-4), (1e-4, 2e-5), (5e-5, 1e-4)])
def test_what_rests_on_a_contact_is_pressed_by_its_weight_at_every_saving_time(clearance, step):
    """However strongly the contact damps: the bias of the steps is no speed."""
    law = jc.contact.HuntCrossley(stiffness=1e10, restitution=0.3)
    rig = held_journal(law, clearance, loads=PRESSED)
    steps = jc.integrator.ImplicitStep(step)
    run = jc.simulate(rig, 0.02, save=21, integrator=steps, state=jc.resting_state(rig))
    forces = np.asarray(run.contact("B").normal_force)[1:, 0]
    # At its start it swings by what a step of the stiffness of the contact leaves.
    np.testing.assert_allclose(forces, 300.0, rtol=2e-2)
    np.testing.assert_allclose(forces[5:], 300.0, rtol=1e-6)
    assert float(jc.response.PeakContactForce("B")(run)) == pytest.approx(300.0, rel=0.05)
    np.testing.assert_allclose(run.body("journal").velocity[5:], 0.0, atol=1e-6)
    assert run.warnings == ()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*asks for longer steps")
@pytest.mark.parametrize("step", [1e-5, 1e-4])
def test_a_run_goes_on_in_steps_of_another_length_as_it_rests(step):
    """What rests does not begin to swing where saving times change the steps."""
    law = jc.contact.HuntCrossley(stiffness=1e10, restitution=0.3)
    rig = held_journal(law, loads=PRESSED)
    times = np.concatenate([np.linspace(0.0, 0.01, 11), 0.01 + np.cumsum([3.7e-5, 2e-4, 1e-5])])
    steps = jc.integrator.ImplicitStep(step)
    run = jc.simulate(rig, times[-1], save=times, integrator=steps, state=jc.resting_state(rig))
    np.testing.assert_allclose(run.contact("B").normal_force[6:, 0], 300.0, rtol=1e-4)


@pytest.mark.parametrize("rebound", [1.0, 0.9, 0.0])
def test_elastic_impact_within_a_step_keeps_the_rebound(rebound):
    """z is 50 or more. Radau's rule for the mean force, and what a last short contact gives back: 2
    % of the speed.
    """
    rig = held_journal(jc.contact.Hertz(stiffness=1e13), speeds=(0.06, 0.08, 0.0))
    steps = jc.integrator.ImplicitStep(STEP, rebound=rebound)
    end = jc.simulate(rig, 2.6e-3, save=2, integrator=steps, state=THROWN)
    velocity = np.asarray(end.body("journal").velocity[-1, :2])
    np.testing.assert_allclose(velocity, -rebound * np.array([0.06, 0.08]), atol=2e-3)


def planar(law, friction, clearance):
    joint = jc.clearance.PlanarJournalBearing(law, friction, clearance=clearance)
    return joint, 1e-4, (1.0, 0.3, 20.0)


def journal(law, friction, clearance):
    flange = jc.clearance.Flange(
        law, friction, radius=0.0 * clearance + 14e-3, clearance=0.0 * clearance + 1e-3
    )
    joint = jc.clearance.JournalBearing(law, friction, clearance=clearance, flange=flange)
    return joint, (1e-4, 3e-4, 2e-4), (1.0, 0.3, 0.2, 5.0, 2.0, 20.0)


def elastic(stiffness):
    return jc.contact.Hertz(stiffness=stiffness), None


def rough(stiffness):
    one = 0.0 * stiffness + 1.0
    law = jc.contact.CarvalhoMartins(
        stiffness=stiffness,
        restitution=0.8 * one,
        slowest_impact=1e-3 * one,
    )
    return law, jc.friction.ThreeZone(
        mu_static=0.15 * one,
        mu_kinetic=0.1 * one,
        static_speed=1e-5 * one,
        kinetic_speed=1e-4 * one,
    )


def abrupt(stiffness):
    one = 0.0 * stiffness + 1.0
    law = jc.contact.MarhefkaOrin(stiffness=stiffness, loss_per_speed=0.2 * one)
    return law, jc.friction.Ambrosio(
        mu_kinetic=0.1 * one, inner_speed=1e-6 * one, outer_speed=1e-5 * one
    )


@pytest.mark.parametrize(
    ("kind", "laws"),
    [
        pytest.param(planar, rough, marks=pytest.mark.slow),
        (planar, elastic),
        pytest.param(journal, abrupt, marks=pytest.mark.slow),
    ],
)
def test_energy_never_grows(kind, laws):
    """Stiffness 1e6 to 1e12 N/m^1.5, clearance 1 um to 1 mm, thrown at 0.01 to 1 m/s: up to 100
    clearances a step.
    """

    def energies(stiffness, clearance, speed):
        joint, inertia, speeds = kind(*laws(stiffness), clearance)
        body = jc.Body(1.0, inertia, None if kind is planar else (0.02, 0.01, 0.03))
        rig = jc.Mechanism(
            {"j": body}, {"B": jc.Connection(joint, "ground", "j")}, speeds={"j": speeds}
        )
        q, v = guess(rig)
        times, steps = jnp.linspace(0.0, 0.05, 21), jc.integrator.ImplicitStep(STEP)
        end = run(rig, q, speed * v, times, steps, Extras(balance=True))
        return end.energy_balance().kinetic, end.outcome

    ranges = 10.0 ** np.arange(6, 13, 2), 10.0 ** np.arange(-6, -2), [0.01, 0.1, 1.0]
    cases = np.stack(np.meshgrid(*ranges)).reshape(3, -1)
    kinetic, outcome = jax.jit(jax.vmap(energies))(*cases)
    assert (outcome == 0).all()
    # Free flight of a turning body keeps its energy to second order in the step: 3e-8 here. Contact
    # adds nothing.
    assert float((kinetic.max(1) / kinetic[:, 0]).max()) < 1 + 1e-7


@pytest.mark.slow
def test_agrees_with_the_reference_on_a_sliding_wearing_journal():
    """Measured 8e-7 m and 3e-5."""
    tight = jc.integrator.Adaptive(rtol=1e-9, atol=1e-11)
    runs = [
        jc.simulate(touching_journal(), 0.05, save=26, integrator=own, state=THROWN)
        for own in (jc.integrator.ImplicitStep(5e-5, rebound=1.0), tight)
    ]
    com = [np.asarray(run.body("journal").com) for run in runs]
    np.testing.assert_allclose(*com, atol=3e-6)
    np.testing.assert_allclose(
        *[float(run.worn_volume("B", "bearing")[-1]) for run in runs], rtol=1e-3
    )


@pytest.mark.slow
def test_loop_with_bristles_drive_and_loads_agrees_with_the_reference():
    """Contact within a closed loop is solved in its rows: measured 9e-7 m, drift 4e-7 m."""
    both = jc.integrator.ImplicitStep(), jc.integrator.Adaptive(rtol=1e-8, atol=1e-10)
    runs = [jc.simulate(full_loop(), 0.03, save=4, integrator=own) for own in both]
    for name in ("rocker", "blade"):
        np.testing.assert_allclose(*[np.asarray(run.body(name).com) for run in runs], atol=5e-6)
    assert float(runs[0].drift()["B"].max()) < 2e-6


@pytest.mark.slow
def test_energy_balance_closes():
    how = {"integrator": jc.integrator.ImplicitStep(), "balance": True, "state": THROWN}
    energy = jc.simulate(touching_journal(), 0.05, save=11, **how).energy_balance()
    lost = float(energy.contact_loss[-1] + energy.friction_loss[-1])
    assert lost > 1e-4 and float(jnp.abs(energy.error).max()) < 0.1 * lost


def falling(clearance, integrator):
    """Height of a journal after its first bounces, with friction and without wear."""
    rig = eqx.tree_at(lambda m: m.connections["B"].joint.bearing_wear, touching_journal(), None)
    rig = eqx.tree_at(lambda m: m.connections["B"].joint.clearance, rig, clearance)
    q, v = guess(rig)
    discrete = Extras(discrete=True)
    return run(rig, q, v, jnp.linspace(0.0, 0.02, 3), integrator, discrete).states[-1, 1]


@pytest.mark.slow
def test_derivatives_are_those_of_the_discrete_run():
    """Forward through the loop, reverse through the scan, and central differences of the run
    itself.
    """
    at = jnp.asarray(1e-3)
    loop, scan = (
        jc.integrator.ImplicitStep(newton_iterations=2),
        jc.integrator.ImplicitStep(newton_iterations=2, steps_per_save=100),
    )
    value, slope = jax.jit(lambda c: jax.jvp(lambda c: falling(c, loop), (c,), (jnp.ones(()),)))(at)
    backward = jax.jit(jax.grad(lambda c: falling(c, scan)))(at)
    plain = jax.jit(lambda c: falling(c, scan))
    d = 1e-9
    difference = (plain(at + d) - plain(at - d)) / (2 * d)
    assert float(value) == pytest.approx(float(plain(at)), rel=1e-9)
    np.testing.assert_allclose(backward, slope, rtol=1e-8)
    # curvature d^2 over lengths of 1e-5 m, and rounding 1e-16 / d
    np.testing.assert_allclose(difference, slope, rtol=1e-5)


@pytest.mark.slow
def test_rest_is_finite_with_its_derivative():
    """Without slip, concentric, at the very touch, and pressed in."""
    friction = jc.friction.ThreeZone()
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.CarvalhoMartins(stiffness=1e9), friction, clearance=1e-4
    )
    parts = {"journal": jc.Body(1.0, 1e-4)}, {"B": jc.Connection(joint, "ground", "journal")}
    rig, times = jc.Mechanism(*parts), jnp.linspace(0.0, 1e-3, 3)
    end = lambda q: run(rig, q, jnp.zeros(3), times, jc.integrator.ImplicitStep()).states[-1]
    go = jax.jit(lambda q: jax.jvp(end, (q,), (jnp.ones_like(q),)))
    for offset in (0.0, 1e-4, 1.1e-4):
        value, slope = go(jnp.array([offset, 0.0, 0.0]))
        assert np.isfinite(value).all() and np.isfinite(slope).all()


@pytest.mark.slow
def test_a_bearing_without_friction_wears_as_on_a_tight_run():
    """Archard's wear asks for sliding, not for friction."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Flores(stiffness=1e8, restitution=0.5),
        clearance=1e-3,
        bearing_wear=jc.Wearing(jc.wear.Archard()),
    )
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"load": jc.load.Force(jc.Marker("journal"), (0.0, -100.0))},
        speeds={"journal": (0.0, 0.0, 20.0)},
    )
    tight, long = (
        jc.simulate(rig, 0.02, save=11, integrator=integrator).worn_volume("B", "bearing")[-1]
        for integrator in (jc.integrator.Adaptive(), jc.integrator.ImplicitStep(1e-4))
    )
    # An impact that a step resolves hardly takes another path: a tenth of the volume.
    np.testing.assert_allclose(long, tight, rtol=0.1)


@pytest.mark.slow
def test_a_contact_without_damping_beside_a_play_moves_as_alone():
    """Nothing connects the two, so each is where it is without the other."""
    journal = held_journal(jc.contact.Hertz(stiffness=1e8), speeds=(0.0, -0.1, 0.0))
    arm = {"A": jc.Connection(jc.joint.Revolute(), "ground", "arm")}
    play = {"play": jc.clearance.Backlash(1e-3), "stiffness": 1e3, "damping": 1.0}
    gear = {"gear": jc.coupling.Gear(jc.coupling.Motor(2e-5), "A", 10.0, **play)}
    running = {"gear.motor": 20.0}
    geared = jc.Mechanism({"arm": jc.Body(1.0, 0.1)}, arm, couplings=gear, speeds=running)
    both = jc.Mechanism(
        dict(journal.bodies) | dict(geared.bodies),
        dict(journal.connections) | arm,
        couplings=gear,
        speeds=dict(journal.speeds) | running,
    )
    runs = [
        jc.simulate(rig, 5e-3, save=3, integrator=jc.integrator.ImplicitStep(STEP), verify=False)
        for rig in (both, journal, geared)
    ]
    together, left, right = runs
    assert together.extremes.indentation[0] > 0 and together.extremes.transmitted[0] > 0
    place = [run.body("journal").com for run in (together, left)]
    np.testing.assert_allclose(*place, rtol=1e-9, atol=1e-14)
    angle = [run.coordinate("A") for run in (together, right)]
    np.testing.assert_allclose(*angle, rtol=1e-12)


@pytest.mark.slow
def test_a_surface_worn_beneath_a_closed_contact_lets_the_journal_follow():
    """Steps hand on how deep contacts are, and saving times lower the surface: a journal that wears
    1.4 um off its bearing as it bounces was 6 % of its clearance elsewhere, however short the
    steps. Those of 2 us are within 3e-5 of it, by their order."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Hertz(stiffness=1e9),
        jc.friction.CoulombTanh(mu_kinetic=0.1, transition_speed=1e-2),
        bearing_wear=jc.Wearing(jc.wear.Archard(wear_coefficient=0.1), (24, 1)),
    )
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"load": jc.load.Force(jc.Marker("journal"), (30.0, -100.0))},
        speeds={"journal": (0.0, 0.0, 50.0)},
    )
    known, found = (
        jc.simulate(rig, 0.02, save=201, integrator=own).body("journal").com[-1]
        for own in (jc.integrator.FixedStep(1e-6), jc.integrator.ImplicitStep(2e-6, rebound=1.0))
    )
    np.testing.assert_allclose(found, known, atol=1e-3 * float(bearing.clearance))
