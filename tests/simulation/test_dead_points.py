"""Drives that lead closed loops to places they cannot reach, and linkages that are stretched flat
on their way."""

import re

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators.checks import Outcome
from tests.rigs import four_bars
from tests.rigs.cells import slow, slow_but

RUNGS = {
    "adaptive": jc.integrator.Adaptive(),
    "fixed": jc.integrator.FixedStep(1e-4),
    "implicit": jc.integrator.ImplicitStep(1e-4),
}


def driven_slider(amplitude):
    """A slider-crank pushed at its slider, about x = 0.15 m; crank and rod reach 0.17 m."""
    scene = jc.scenes.slider_crank("ideal")
    ends = jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
    push = jc.drive.Harmonic(amplitude, 5.0, offset=0.15)
    own = {
        "O": jc.Connection(jc.joint.Revolute(), "ground", "crank"),
        "G": jc.Connection(jc.joint.Prismatic(drive=push), *ends),
    }
    rough = {"O": 0.8, "A": -1.1}
    return jc.Mechanism(scene.bodies, scene.connections | own, scene.loads, guess=rough)


def four_bar(crank):
    """A four-bar driven at its crank, which turns round if it is the shortest link."""
    links = {"crank": crank, "coupler": 0.3, "rocker": 0.25}
    drive, guess = jc.drive.ConstantSpeed(20.0, 1.0), {"A": 0.8, "D": 1.3}
    return four_bars.four_bar(links, 0.3, jc.Body(1.0, 1e-2), drive=drive, guess=guess)


@pytest.mark.parametrize("rung", slow_but(["fixed"], RUNGS))
@pytest.mark.parametrize("kind", ["slider", *slow("four-bar")])
def test_a_drive_beyond_a_dead_point_ends_the_run_and_says_so(kind, rung):
    rig = driven_slider(0.03) if kind == "slider" else four_bar(0.28)
    run = jc.simulate(rig, 0.3, save=61, integrator=RUNGS[rung], throw=False)
    assert "A drive leads a closed loop beyond a dead point" in run.result
    assert 0.0 < float(run.ended) < 0.3


@pytest.mark.slow
def test_what_is_no_dead_point_is_not_called_one():
    """Drives within reach, and a loop that long steps tear."""
    for rig in (driven_slider(0.015), four_bar(0.1)):
        assert jc.simulate(rig, 0.1, save=11, integrator=RUNGS["fixed"]).succeeded
    scene = jc.scenes.slider_crank("ideal", crank_speed=2000.0)
    steps = jc.integrator.FixedStep(2e-3, "semi_implicit")
    run = jc.simulate(scene, 0.05, save=26, integrator=steps, throw=False)
    assert not run.succeeded and "dead point" not in run.result and "singular" not in run.result


@pytest.mark.slow
def test_a_sample_beyond_a_dead_point_says_so():
    offset = jc.Variable(
        lambda rig: rig.connections["G"].joint.drive.offset, jc.distribution.Uniform(0.01)
    )
    end = jc.response.FinalCoordinate("O")
    rig, step = driven_slider(0.015), RUNGS["fixed"]
    asked = jc.Problem(rig, end, {"offset": offset}, duration=0.1, save=21, integrator=step)
    study = jc.monte_carlo(asked, 16, chunk=16)
    beyond = study.values[:, 0] + 0.015 > 0.17
    told = study.outcome == Outcome.DEAD_POINT
    assert 0 < beyond.sum() < 16
    # Close to the dead point forces are large enough to end a run that could go on.
    assert told[study.values[:, 0] + 0.015 > 0.1701].all() and not told[~beyond].any()
    assert "beyond a dead point" in study.rerun(int(told.argmax())).result


def change_point(coupler=0.25, stabilisation="default"):
    """A four-bar whose shortest and longest links are together as long as the others: it is flat
    whenever its crank points along the ground."""
    links = {"crank": 0.1, "coupler": coupler, "rocker": 0.2}
    begins = {"start": {"O": 0.6}, "guess": {"A": 0.2, "D": 1.4}, "stabilisation": stabilisation}
    gravity = {"gravity": jc.load.Gravity((0.0, -9.81))}
    return four_bars.four_bar(links, 0.15, four_bars.link, gravity, **begins)


@pytest.mark.slow
def test_a_run_that_ends_at_a_singular_position_says_so():
    """With the loop, and the time at which the crank points along the ground."""
    rig = change_point(stabilisation=jc.Baumgarte())
    run = jc.simulate(rig, 1.0, save=101, integrator=RUNGS["implicit"], throw=False)
    assert run.outcome == Outcome.SINGULAR_POSITION
    assert "is at a singular position" in run.result and 'through joint "B"' in run.result
    told = float(re.search(r"about ([0-9.]+) s", run.result)[1])
    before = round(float(run.ended) / 0.01) - 1
    crank, speed, time = run.coordinate("O")[before], run.speed("O")[before], run.time[before]
    turns = float(crank + speed * (told - time)) / np.pi
    assert abs(told - float(run.ended)) < 0.01 and abs(turns - round(turns)) < 0.01


@pytest.mark.slow
def test_loops_closed_after_every_step_pass_a_singular_position():
    """As inertia has it: energy stays, and shorter steps have the same motion."""
    runs = [
        jc.simulate(change_point(), 0.5, save=11, integrator=step, balance=True)
        for step in (jc.integrator.ImplicitStep(1e-4), jc.integrator.MoreauJean(2e-5))
    ]
    cranks = [np.asarray(run.coordinate("O")) for run in runs]
    assert np.ptp(cranks[0]) > np.pi
    # Order 2: error of a step's square.
    np.testing.assert_allclose(*cranks, atol=1e-5)
    assert all(float(abs(run.energy_balance().error).max()) < 1e-5 for run in runs)


def full_stroke(amplitude=0.05):
    """A slider-crank whose piston is driven over exactly its full stroke, or a share of it."""
    push = jc.drive.Harmonic(amplitude, 2.0, offset=0.12)
    hinge, rod = jc.joint.Revolute(), jc.Body(0.3, 4e-4, com=(0.06, 0.0))
    return jc.Mechanism(
        {"crank": jc.Body(1.0, 5e-3), "rod": rod, "piston": jc.Body(0.4, 1e-4)},
        {
            "O": jc.Connection(hinge, "ground", "crank"),
            "A": jc.Connection(hinge, "crank", "rod", at=(0.05, 0.0)),
            "B": jc.Connection(hinge, "rod", "piston", at=(0.12, 0.0)),
            "G": jc.Connection(jc.joint.Prismatic(drive=push), "ground", "piston", axis="x"),
        },
        guess={"O": 1.2},
    )


def cranks_through(times):
    """The crank's angle [rad] of `full_stroke` at these times [s], where it goes through both dead
    centres: at 0.125 s it is 0, at 0.375 s minus half a turn, and so on."""
    piston = 0.12 + 0.05 * np.sin(4 * np.pi * times)
    # Law of cosines between crank, rod and the piston's place.
    inner = (0.05**2 + piston**2 - 0.12**2) / (2 * 0.05 * piston)
    angle, half = np.arccos(np.clip(inner, -1.0, 1.0)), np.floor((times - 0.125) / 0.25) + 1
    turned = np.where(half % 2 == 0, angle, -angle)
    return turned - 2 * np.pi * (half // 2)


THROUGH = {
    "implicit": jc.integrator.ImplicitStep(1e-3),
    # Here a step's middle is the dead centre itself.
    "middle": jc.integrator.ImplicitStep(2e-3),
    "non-colliding": jc.integrator.NonColliding(7e-4),
    "rigid": jc.integrator.MoreauJean(1e-3),
}


@pytest.mark.parametrize("rung", slow_but(["middle"], THROUGH))
def test_inertia_carries_a_crank_through_its_dead_centres(rung):
    """Beside the closed form, on steps that meet the dead centres exactly and on others."""
    run = jc.simulate(full_stroke(), 1.0, save=101, integrator=THROUGH[rung])
    angle = np.asarray(run.coordinate("O"))
    # Crank and piston are off by the square of a step near the ends of the stroke.
    np.testing.assert_allclose(angle, cranks_through(np.asarray(run.time)), atol=1e-3)


def thread_between_guides():
    """A driven spindle and a nut on a guide, whose cylindrical joint adds no equation."""
    return jc.Mechanism(
        {"spindle": jc.Body(2.0, (1e-2,) * 3), "nut": jc.Body(1.0, (1e-2,) * 3)},
        {
            "A": jc.Connection(jc.joint.Revolute(jc.drive.ConstantSpeed(3.0)), "ground", "spindle"),
            "S": jc.Connection(jc.joint.Cylindrical(), "spindle", "nut"),
            "N": jc.Connection(jc.joint.Prismatic(), "ground", "nut"),
        },
        {"push": jc.load.JointTorque("N", 2.0)},
    )


def test_a_loop_of_redundant_rows_alone_has_no_dead_point_in_a_study():
    """The nut of 2 kg that 2 N push is 0.5 m away after 1 s."""
    mass = jc.Variable(lambda rig: rig.bodies["nut"].mass, tolerance=0.1)
    far = {"far": jc.response.FinalCoordinate("N")}
    problem = jc.Problem(thread_between_guides(), far, {"mass": mass}, duration=1.0, save=3)
    found = problem.evaluate([2.0])
    assert found.outcome == Outcome.REACHED
    assert float(found.responses["far"]) == pytest.approx(0.5, rel=1e-9)


def test_drives_that_contradict_a_coupling_are_named():
    turn = lambda speed: jc.joint.Revolute(jc.drive.ConstantSpeed(speed))
    rig = lambda fast: jc.Mechanism(
        {"a": jc.Body(1.0, 0.01), "b": jc.Body(1.0, 0.02)},
        {
            "A": jc.Connection(turn(2.0), "ground", "a"),
            "B": jc.Connection(turn(fast), jc.Marker("ground", (0.1, 0.0)), jc.Marker("b")),
        },
        couplings={"mesh": jc.coupling.Gear("A", "B", 2.0)},
    )
    with pytest.raises(ValueError, match="drives of 'A', 'B' contradict the coupling \"mesh\""):
        jc.simulate(rig(5.0), 0.05, save=3)
    assert jc.simulate(rig(-1.0), 0.05, save=3).succeeded
