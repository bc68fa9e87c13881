"""Flanks of a play that wear: against closed forms of Archard's law, and what they refuse."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

SHARE, HARDNESS, SLIDE, AREA, RADIUS = 1e-4, 2e9, 0.2, 1e-4, 0.05
TORQUE, SPEED, DURATION = 3.0, 5.0, 2.0
TURN = jc.joint.Revolute()
GROUND = "ground"


def worn_play(play=1e-3, share=SHARE, **more):
    law = jc.wear.Archard(wear_coefficient=share, hardness=HARDNESS)
    more = {"slide": SLIDE, "area": AREA, "pitch_radius": RADIUS, "wear": law} | more
    return jc.clearance.Backlash(play, **more)


def one_way(play, sign=1.0, ends=None, **more):
    """A motor that turns against a brake, in balance: flank and speed stay."""
    ratio, wound = 10.0, 0.5e-3 + TORQUE / 2e3
    motor = jc.coupling.Motor(1e-3)
    gear = jc.coupling.Gear(motor, "B", ratio=ratio, stiffness=2e3, damping=20.0, play=play)
    return jc.Mechanism(
        {"wheel": jc.Body(1.0, 0.05)},
        {"B": jc.Connection(TURN, GROUND, "wheel")},
        {
            "drive": jc.load.JointTorque("g.motor", sign * TORQUE / ratio),
            "brake": jc.load.JointTorque("B", -sign * TORQUE),
        },
        couplings={"g": gear},
        speeds={"B": sign * SPEED, "g.motor": sign * ratio * SPEED},
        start={"B": 0.0, "g.motor": sign * ratio * wound},
        **more,
    )


def expected(time, share=SHARE):
    """k F s / (H A) of a constant torque and speed [m]."""
    return share * (TORQUE / RADIUS) * (SLIDE * RADIUS * SPEED * time) / (HARDNESS * AREA)


@pytest.mark.parametrize(
    ("law", "sign"),
    [(jc.flank.Stop(), 1.0), (jc.flank.Nordin(), -1.0), (jc.flank.ElastoBacklash(), 1.0)],
)
def test_depth_grows_in_proportion_to_force_and_way(law, sign):
    rig = one_way(worn_play(law=law), sign)
    run = jc.simulate(rig, DURATION, save=5, verify=False)
    pressed, free = ("lower", "upper") if sign > 0 else ("upper", "lower")
    volume = run.worn_volume("g", pressed)
    np.testing.assert_allclose(volume, AREA * expected(np.asarray(run.time)), rtol=1e-6, atol=1e-25)
    np.testing.assert_allclose(run.worn_depth("g", pressed), expected(DURATION), rtol=1e-6)
    assert float(run.worn_depth("g", free)[0, 0]) == 0.0
    assert jc.response.PeakWornDepth("g", pressed)(run) == run.worn_depth("g", pressed)[0, 0]
    assert jc.response.WornVolume("g", pressed)(run) == volume[-1]


@pytest.mark.parametrize(
    "integrator",
    [
        pytest.param(jc.integrator.FixedStep(), marks=pytest.mark.slow),
        jc.integrator.ImplicitStep(1e-4),
    ],
)
def test_other_integrators_wear_flanks_too(integrator):
    run = jc.simulate(one_way(worn_play()), 0.5, save=5, integrator=integrator, verify=False)
    np.testing.assert_allclose(run.worn_depth("g", "lower"), expected(0.5), rtol=2e-3)


def test_the_play_is_as_worn_at_the_last_update():
    """Of which a run has a hundred at least."""
    share = 0.1
    run = jc.simulate(one_way(worn_play(share=share)), DURATION, save=5, verify=False)
    seen = expected(DURATION * 99 / 100, share)
    # The spring follows the growing play with the lag of its damper.
    twist = -run.coupling("g").twist[-1]
    np.testing.assert_allclose(twist, 0.5e-3 + TORQUE / 2e3 + seen / RADIUS, atol=1e-7)


def test_a_run_begins_between_flanks_as_worn():
    worn = {"g": {"lower": jnp.full((1, 1), 5e-5), "upper": jnp.full((1, 1), 2e-5)}}
    run = jc.simulate(one_way(worn_play()), 3.0, save=5, state=jc.State(worn), verify=False)
    twist = -run.coupling("g").twist[-1]
    np.testing.assert_allclose(twist, 0.5e-3 + TORQUE / 2e3 + 5e-5 / RADIUS, atol=1e-6)


LAWS = [jc.flank.Nordin(), pytest.param(jc.flank.ElastoBacklash(), marks=pytest.mark.slow)]


@pytest.mark.parametrize("law", LAWS)
def test_a_run_that_goes_on_presses_the_flank_as_worn_at_once(law):
    """Motor and brake are in balance, so the torque goes on as it was."""
    how = {"save": 5, "integrator": jc.integrator.ImplicitStep(1e-4), "verify": False}
    run = jc.simulate(one_way(worn_play(share=0.1, law=law)), 0.5, **how)
    on = jc.simulate(run.mechanism, 1e-3, state=run.state(), **how)
    torque, before = (jnp.abs(each.coupling("g").torque) for each in (on, run))
    np.testing.assert_allclose(torque, before[-1], rtol=1e-3)


def test_the_slope_of_the_depth_is_depth_over_coefficient():
    def depth(share):
        rig, steps = one_way(worn_play(share=share, law=jc.flank.Stop())), jc.integrator.FixedStep()
        run = jc.simulate(rig, 0.2, save=3, integrator=steps, verify=False)
        return run.worn_depth("g", "lower")[0, 0]

    value, slope = jax.jvp(depth, (SHARE,), (1.0,))
    np.testing.assert_allclose(slope, value / SHARE, rtol=1e-6)


def swinging(play):
    gear = jc.coupling.Gear(
        jc.coupling.Motor(2e-5), "A", ratio=100, stiffness=2e3, damping=2.0, play=play
    )
    servo = jc.load.Servo("A", lambda t: 0.5 * jnp.sin(2 * jnp.pi * t), kp=400.0, kd=25.0)
    return jc.Mechanism(
        {"arm": jc.Body(2.0, 0.5)},
        {"A": jc.Connection(TURN, GROUND, "arm")},
        {"servo": servo},
        couplings={"gear": gear},
    )


def test_each_flank_has_what_it_carried():
    run = jc.simulate(swinging(worn_play()), 2.0, save=2001, verify=False)
    torque, speed = np.asarray(run.coupling("gear").torque), np.abs(np.asarray(run.speed("A")))
    for flank, sign in (("upper", 1.0), ("lower", -1.0)):
        work = np.trapezoid(np.maximum(sign * torque, 0) * speed, run.time)
        volume = run.worn_volume("gear", flank)[-1]
        np.testing.assert_allclose(volume, SHARE * SLIDE * work / HARDNESS, rtol=1e-3)


@pytest.mark.parametrize("law", LAWS)
def test_flanks_wear_alike_however_often_states_are_saved(law):
    """And so surfaces updated. A shaft that lay on its flank was off it behind each update, and
    pressed nothing for a step: a quarter of the depth was missing."""
    rig, steps = swinging(worn_play(law=law)), jc.integrator.ImplicitStep(1e-4)
    depths = [
        jc.simulate(rig, 0.5, save=save, integrator=steps, verify=False).worn_depth("gear", "upper")
        for save in (6, 1001)
    ]
    np.testing.assert_allclose(depths[1], depths[0], rtol=1e-3)


def test_wear_takes_no_energy_and_a_play_that_does_not_grow_moves_as_before():
    bare, worn = jc.clearance.Backlash(1e-3), worn_play(share=0.0)
    runs = [jc.simulate(swinging(own), 0.5, save=6, balance=True) for own in (bare, worn)]
    # Steps end where surfaces are updated: the two differ by what the tolerance allows.
    alike = {"rtol": 1e-6, "atol": 1e-8}
    np.testing.assert_allclose(runs[0].coordinate("A"), runs[1].coordinate("A"), **alike)
    energies = [own.energy_balance() for own in runs]
    np.testing.assert_allclose(energies[0].damping_loss, energies[1].damping_loss, **alike)


def test_a_life_under_a_torque_that_play_does_not_change_is_linear():
    amplitude, rate = 0.5, 2 * np.pi
    way = jc.drive.Position(lambda t: amplitude * jnp.sin(rate * t))
    gear = jc.coupling.Gear(
        jc.coupling.Motor(2e-4), "B", ratio=10.0, stiffness=2e3, damping=20.0, play=worn_play()
    )
    rig = jc.Mechanism(
        {"wheel": jc.Body(1.0, 0.05)},
        {"B": jc.Connection(jc.joint.Revolute(way), GROUND, "wheel")},
        {"push": jc.load.JointTorque("g.motor", TORQUE / 10.0)},
        couplings={"g": gear},
    )
    life = jc.wear_life(rig, 1.0, cycles=1e5)
    whole = SHARE * (TORQUE / RADIUS) * (SLIDE * RADIUS * 4 * amplitude) / (HARDNESS * AREA)
    np.testing.assert_allclose(life.worn()["g"]["lower"], 1e5 * whole, rtol=1e-3)
    np.testing.assert_allclose(life.worn(5e4)["g"]["lower"], 5e4 * whole, rtol=1e-3)
    assert life.over_life("depth g lower", [1e5])[0] == life.worn()["g"]["lower"][0, 0]


def held(play):
    key = jc.coupling.Latch("S", play=play, stiffness=1e5, damping=10.0)
    joints = {"S": jc.Connection(jc.joint.Prismatic(), GROUND, "key")}
    return jc.Mechanism({"key": jc.Body(1.0, 0.1)}, joints, couplings={"k": key})


def test_a_sliding_play_grows_by_its_depth():
    play = worn_play(pitch_radius=None)
    assert held(play).couplings["k"].play.lever == 1.0
    grown = play.grown({"upper": 3e-5, "lower": 1e-5})
    np.testing.assert_allclose([grown.play, grown.middle], [1e-3 + 4e-5, 1e-5])
    assert eqx.tree_equal(play.grown({"upper": 0.0, "lower": 0.0}).play, jnp.asarray(1e-3))


def test_wheels_slide_with_the_one_at_which_play_is_seen():
    wheels = {n: jc.Connection(TURN, GROUND, n, place) for n, place in PLACES.items()}
    gear = jc.coupling.Gear("a", "b", 2.0, play=worn_play(), stiffness=2e3, damping=2.0)
    rig = jc.Mechanism(
        {"a": jc.Body(1.0, 0.01), "b": jc.Body(1.0, 0.05)},
        wheels,
        {"push": jc.load.JointTorque("a", 1.5), "brake": jc.load.JointTorque("b", 3.0)},
        couplings={"g": gear},
        speeds={"a": 2 * SPEED, "b": -SPEED},
    )
    run = jc.simulate(rig, 1.0, save=1001, verify=False)
    torque, speed = np.asarray(run.coupling("g").torque), np.abs(np.asarray(run.speed("b")))
    work = np.trapezoid(np.abs(torque) * speed, run.time)
    volume = sum(run.worn_volume("g", flank)[-1] for flank in ("upper", "lower"))
    np.testing.assert_allclose(volume, SHARE * SLIDE * work / HARDNESS, rtol=1e-2)


PLACES = {"a": (0.0, 0.0), "b": (0.15, 0.0)}
