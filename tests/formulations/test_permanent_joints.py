"""Joints that always touch: they start where the mechanism with clearance starts, and runs whose
laws are not met say so.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators.checks import Check

RIGID = jc.contact.Rigid(restitution=0.5)
HALF = 0.4
QUATERNION = (np.cos(HALF), 0.6 * np.sin(HALF), 0.0, 0.8 * np.sin(HALF))
UPRIGHT = (np.cos(HALF), 0.0, 0.0, np.sin(HALF))
PLANAR = jc.clearance.PlanarJournalBearing(RIGID, None, bearing_radius=10e-3, clearance=1e-4)
GUIDE = jc.clearance.SliderGuide(RIGID, clearance=1e-4)
SPATIAL = jc.clearance.JournalBearing(
    RIGID, None, bearing_radius=10e-3, clearance=1e-4, length=30e-3, journal_length=32e-3
)
BALL = jc.clearance.BallSocket(RIGID, clearance=1e-4)
CASES = {
    "planar": (PLANAR, 0.01, (0.0, 0.0, -1.0), (0.0, 0.0, 3.0), None),
    "guide": (GUIDE, 0.01, (0.3, 0.0, 0.0), (1.0, 0.0, 0.0), "x"),
    "spatial": (
        SPATIAL,
        (0.01, 0.02, 0.03),
        (0.0, 0.0, 0.0, *UPRIGHT),
        (0.0, 0.0, 0.0, 0.0, 0.0, 2.0),
        None,
    ),
    "ball": (
        BALL,
        (0.01, 0.02, 0.03),
        (0.0, 0.0, 0.0, *QUATERNION),
        (0.0, 0.0, 0.0, 0.3, 0.2, 2.0),
        None,
    ),
}


def arm(name, turned):
    joint, inertia, start, speeds, axis = CASES[name]
    centre = (0.1, 0.0) if np.size(inertia) == 1 else (0.1, 0.0, 0.0)
    ends = ("arm", "ground") if turned else ("ground", "arm")
    axes = {} if axis is None else {"axis": axis}
    return jc.Mechanism(
        {"arm": jc.Body(2.0, inertia, centre)},
        {"J": jc.Connection(joint, *ends, **axes)},
        start={"arm": start},
        speeds={"arm": speeds},
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "turned"),
    [("planar", False), ("planar", True), ("guide", True), ("spatial", True), ("ball", False)],
)
def test_a_floating_body_starts_where_it_was_put(name, turned):
    rig = arm(name, turned)
    fitted = jc.simulate(rig, 1e-3, save=2, integrator=jc.integrator.NonColliding(1e-3)).body("arm")
    rigid = jc.simulate(rig, 1e-3, save=2, integrator=jc.integrator.MoreauJean(1e-3)).body("arm")
    for part in ("com", "rotation", "velocity"):
        np.testing.assert_allclose(getattr(fitted, part)[0], getattr(rigid, part)[0], atol=1e-9)


def test_starts_vary_in_a_problem():
    variable = jc.Variable(lambda rig: rig.speeds["arm"][2], tolerance=0.1)
    end = jc.response.FinalCoordinate("J")
    settings = {"duration": 0.01, "integrator": jc.integrator.NonColliding(1e-3), "save": 3}
    problem = jc.Problem(arm("planar", False), {"angle": end}, {"spin": variable}, **settings)
    at = eqx.filter_jit(lambda v: problem.evaluate(v).responses["angle"])
    # Without a load the spin is kept.
    assert float(at(jnp.array([5.0])) - at(jnp.array([3.0]))) == pytest.approx(0.02, rel=1e-6)


def test_friction_at_rest_is_not_below_that_of_sliding():
    with pytest.raises(ValueError, match="mu_static 0.2 below mu_kinetic 0.4"):
        jc.friction.Coulomb(mu_kinetic=0.4, mu_static=0.2)


def slider(across, mu, sweeps):
    """A slider whose centre of mass lies aside of the guide: it locks itself at 2 mu across /
    length = 1.
    """
    guide = jc.clearance.SliderGuide(
        RIGID, jc.friction.Coulomb(mu_kinetic=mu), clearance=1e-5, length=0.04
    )
    rig = jc.Mechanism(
        {"slider": jc.Body(1.0, 1e-3, (0.0, across))},
        {"P": jc.Connection(guide, "ground", "slider", axis="x")},
        start={"slider": (0.0, 0.0, 0.0)},
        speeds={"slider": (5.0, 0.0, 0.0)},
        loads={"gravity": jc.load.Gravity((0.0, -9.81))},
    )
    integrator = jc.integrator.NonColliding(1e-3, max_sweeps=sweeps)
    return jc.simulate(rig, 5e-3, save=6, integrator=integrator, throw=False)


def test_a_search_that_ends_far_from_the_laws_ends_the_run_with_a_sentence():
    # 2 mu across / length = 0.975
    assert slider(0.195, 0.1, 1000.0).succeeded
    lost = slider(0.195, 0.1, 10.0)
    assert not lost.succeeded and "laws of contact or friction were not met" in lost.result


def rubbing(order, mu, law=jc.friction.Coulomb):
    """A slider-crank all of whose joints but the crank's have clearance and friction, one of which
    closes its loop.
    """
    planar = jc.clearance.PlanarJournalBearing(
        jc.contact.Rigid(restitution=0.0), law(mu_kinetic=mu), bearing_radius=10e-3, clearance=2e-5
    )
    guide = jc.clearance.SliderGuide(
        jc.contact.Rigid(restitution=0.0), law(mu_kinetic=mu), clearance=2e-5
    )
    base = jc.scenes.slider_crank(planar)
    connections = base.connections | {
        "A": jc.Connection(planar, "crank", "rod", at=(0.05, 0.0)),
        "G": jc.Connection(guide, jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")),
    }
    return jc.Mechanism(
        base.bodies,
        {name: connections[name] for name in order},
        base.loads,
        start={"slider": (0.17, 0.0, 0.0)},
    )


def means(run):
    return [float(jnp.mean(jnp.sum(run.contact(name).normal_force[1:], axis=-1))) for name in "ABG"]


@pytest.mark.slow
def test_friction_is_the_same_in_a_joint_of_the_tree_and_in_one_that_closes_a_loop():
    runs = [
        jc.simulate(
            rubbing(order, 0.1),
            0.126,
            save=127,
            integrator=jc.integrator.NonColliding(1e-4),
            balance=True,
        )
        for order in ("OABG", "OGBA")
    ]
    assert [run.mechanism.topology.loops for run in runs] == [("B",), ("A",)]
    np.testing.assert_allclose(means(runs[0]), means(runs[1]), rtol=1e-4)
    for name in "ABG":
        parts = [run.contact(name) for run in runs]
        np.testing.assert_allclose(parts[0].slip_speed[1:], parts[1].slip_speed[1:], atol=5e-4)
        assert float(parts[0].traction.sum() / parts[0].normal_force.sum()) == pytest.approx(
            0.1, rel=0.01
        )
    for run in runs:
        energy = run.energy_balance()
        assert float(jnp.max(jnp.abs(energy.error))) < 5e-4 * float(energy.friction_loss[-1])
    losses = [float(run.energy_balance().friction_loss[-1]) for run in runs]
    assert losses[0] == pytest.approx(losses[1], rel=1e-3)


@pytest.mark.slow
def test_friction_in_loops_agrees_with_rigid_contact():
    """Whose journals cross a gap and strike now and then: to some per cent."""
    rig = rubbing("OABG", 0.1)
    fitted = jc.simulate(
        rig, 0.126, save=127, integrator=jc.integrator.NonColliding(1e-4), balance=True
    )
    rigid = jc.simulate(
        rig, 0.126, save=127, integrator=jc.integrator.MoreauJean(2e-5), balance=True
    )
    np.testing.assert_allclose(means(fitted), means(rigid), rtol=0.05)
    losses = [float(run.energy_balance().friction_loss[-1]) for run in (fitted, rigid)]
    assert losses[0] == pytest.approx(losses[1], rel=0.05)


@pytest.mark.slow
def test_the_four_bar_runs_though_its_ball_holds_what_a_journal_holds_too():
    """Along its axes: no motion changes this, and the journal carries it. Without friction its
    reaction is the ideal joint's.
    """
    fitted = jc.simulate(
        jc.scenes.four_bar("spatial", wear=False, friction=False, follower_offset=1e-6),
        0.3,
        save=31,
        integrator=jc.integrator.NonColliding(1e-4),
    )
    ideal = jc.simulate(jc.scenes.four_bar("ideal"), 0.3, save=31)
    np.testing.assert_allclose(fitted.body("follower").com, ideal.body("follower").com, atol=2e-6)
    wanted = np.asarray(ideal.reaction("B").force)
    found = np.asarray(fitted.reaction("B").force)
    np.testing.assert_allclose(found[5:], wanted[5:], atol=0.01 * np.abs(wanted).max())


def held_arm():
    """An arm that turns about two upright axes: the shoulder swings, a spring holds the elbow,
    whose collars stop it along its axis."""
    law = jc.contact.LankaraniNikravesh(stiffness=1e10, restitution=0.5)
    flange = jc.clearance.Flange(law, radius=14e-3, clearance=0.2e-3)
    elbow = jc.clearance.JournalBearing(law, clearance=0.1e-3, length=40e-3, flange=flange)
    swing = jc.drive.Harmonic(amplitude=0.4, frequency=1.0, phase=-np.pi / 2)
    return jc.Mechanism(
        {
            "upper": jc.Body(2.0, (1e-3, 1.5e-2, 1.5e-2), (0.15, 0.0, 0.0)),
            "fore": jc.Body(1.0, (5e-4, 7.5e-3, 7.5e-3), (0.15, 0.0, 0.0)),
        },
        {
            "shoulder": jc.Connection(jc.joint.Revolute(drive=swing), "ground", "upper"),
            "elbow": jc.Connection(elbow, jc.Marker("upper", (0.3, 0.0, 0.0)), "fore"),
        },
        {
            "gravity": jc.load.Gravity((0.0, 0.0, -9.81)),
            "servo": jc.load.JointSpring("elbow", stiffness=500.0, rest=0.8, damping=1.0),
        },
        start={"elbow": 0.8},
    )


def test_an_upright_journal_comes_down_on_its_collar_and_is_judged_beside_the_way_of_its_arm():
    """By its axial play, less what the rim of the tilted collar takes, a thousandth of the play
    behind the face's middle: 1.001 c_a - 2 R c / L. A spring lets the joint move by a thousandth of
    a radian: a quarter of that is nothing beside the arm's swing."""
    run, finer = (
        jc.simulate(held_arm(), 0.5, save=251, integrator=jc.integrator.NonColliding(step))
        for step in (5e-4, 1e-4)
    )
    expected = -(1.001 * 0.2e-3 - 2 * 14e-3 * 0.1e-3 / 40e-3)
    # the journal's two ends lean on nearly opposite sides, by what swings
    np.testing.assert_allclose(run.contact("elbow").offset[1:, 2], expected, rtol=5e-3)
    assert {check for check, beyond in run.invariants.beyond().items() if beyond} == {
        Check.COLLAR_FORCE
    }
    away = 0.3 * np.asarray(run.body("fore").rotation - finer.body("fore").rotation)[:, :, 0]
    assert np.abs(away).max() < 1e-5


def test_a_bearing_without_a_gap_beside_one_with_a_gap():
    """What a part would need to follow its force through a gap is told of joints that have one."""
    rod = lambda: jc.Body(1.0, 2e-3, (0.1, 0.0))
    rubs = jc.joint.PlainBearing(jc.friction.Coulomb(mu_kinetic=0.1), radius=5e-3)
    rig = jc.Mechanism(
        {"arm": rod(), "forearm": rod()},
        {
            "J": jc.Connection(PLANAR, "ground", "arm"),
            "K": jc.Connection(rubs, "arm", "forearm", at=(0.2, 0.0)),
        },
        {"gravity": jc.load.Gravity()},
    )
    run = jc.simulate(rig, 0.01, save=3, integrator=jc.integrator.NonColliding(), verify=False)
    assert run.succeeded
    assert run.invariants.figures[Check.GAP_MOTION].places == ("J",)
