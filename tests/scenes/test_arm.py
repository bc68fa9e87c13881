"""The robot arm: its numbers beside those of the file and of another program, and its path."""

import importlib.metadata
import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.commands import arm as study
from jaxclear.scenes.arm import (
    ARCMIN,
    FASTEST,
    HINGES,
    JOINTS,
    PLAY,
    REDUCERS,
    SLIDING,
    TIP,
    arm,
    gravity_torques,
    pick_and_place,
)
from tests.rigs.refusals import refusals

REFERENCE = json.loads((Path(__file__).parents[1] / "refdata" / "xarm7.json").read_text())
TOLERANCE = REFERENCE["tolerance"]


def bare(drives):
    """The arm without tool, servos, damping and friction, a drive at each joint."""
    whole, connections = arm(), {}
    for name, drive in zip(JOINTS, drives, strict=True):
        _, *ends = vars(whole.connections[name]).values()
        connections[name] = jc.Connection(jc.joint.Revolute(drive=drive), *ends)
    bodies = {name: body for name, body in whole.bodies.items() if name != "tool"}
    return jc.Mechanism(bodies, connections, {"gravity": whole.loads["gravity"]})


class Parabola(eqx.Module):
    """An angle [rad] over time by its value, speed and acceleration at time 0."""

    angle: float
    speed: float
    acceleration: float

    def __call__(self, time):
        return self.angle + time * (self.speed + 0.5 * time * self.acceleration)


@pytest.mark.slow
def test_torques_along_motions_are_those_of_another_program():
    """Every mass, centre, inertia, place and axis takes part in them."""
    for told in REFERENCE["cases"]:
        told = {name: np.array(values) for name, values in told.items()}
        own = np.stack([told[name] for name in ("angle", "speed", "acceleration")], 1)
        rig = bare([jc.drive.Position(Parabola(*numbers)) for numbers in jnp.asarray(own)])
        step = jc.integrator.FixedStep(1e-3)
        run = jc.simulate(rig, 1e-3, save=2, integrator=step, verify=False)
        turns = [np.asarray(run.body(f"link{k}").rotation)[0] for k in range(1, 8)]
        axes = {name: turn[:, 2] for name, turn in zip(JOINTS, turns, strict=True)}
        torques = [np.asarray(run.reaction(name).torque)[0] @ axes[name] for name in JOINTS]
        np.testing.assert_allclose(torques, told["torque"], atol=TOLERANCE["torque"])
        at_rest = gravity_torques(told["angle"], tool_mass=0.0)
        np.testing.assert_allclose(at_rest, told["at rest"], atol=TOLERANCE["torque"])
        flange = run.body("link7")
        np.testing.assert_allclose(flange.origin[0], told["flange"], atol=TOLERANCE["flange"])
        np.testing.assert_allclose(axes["joint7"], told["axis"], atol=TOLERANCE["axis"])


def urdf():
    """The file where example-robot-data is installed."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    found = [file.locate() for file in files if file.name == "xarm7.urdf"]
    return found[0] if found else None


@pytest.mark.skipif(urdf() is None, reason="example-robot-data is not installed")
@pytest.mark.filterwarnings("ignore")
def test_numbers_are_those_of_the_file():
    read, ours = jc.read_urdf(urdf()), arm()
    for k, (name, hinge) in enumerate(zip(JOINTS, HINGES, strict=True), 1):
        for field in ("mass", "com", "inertia"):
            own, told = (getattr(one.bodies[f"link{k}"], field) for one in (ours, read))
            np.testing.assert_allclose(own, told, rtol=1e-9, atol=1e-18)
        own, told = (one.connections[name].parent.pose() for one in (ours, read))
        np.testing.assert_allclose(jnp.array(own.rotation), jnp.array(told.rotation), atol=4e-6)
        np.testing.assert_allclose(own.translation, told.translation, atol=1e-12)
        stop, loads = read.loads[f"{name} limits"], (ours.loads, read.loads)
        np.testing.assert_allclose((stop.lower, stop.upper), (hinge.lower, hinge.upper))
        assert loads[0][f"{name} damping"].damping == loads[1][f"{name} spring"].damping
        assert loads[0][f"{name} friction"].torque == loads[1][f"{name} friction"].torque


def test_the_way_keeps_to_limits_of_angle_and_speed():
    way = pick_and_place()
    speeds = np.gradient(way.angles, way.times, axis=0)
    for k, hinge in enumerate(HINGES):
        assert hinge.lower < way.angles[:, k].min() and way.angles[:, k].max() < hinge.upper
    assert np.abs(speeds).max() < FASTEST


@pytest.mark.slow
def test_servos_follow_the_way_and_come_to_rest_at_its_end():
    run = jc.simulate(arm(), pick_and_place().times[-1], save=136)
    for k, name in enumerate(JOINTS):
        away = np.abs(np.asarray(run.coordinate(name)) - pick_and_place().angles[:, k])
        assert away.max() < 5e-3 and away[-1] < 1e-4
    commanded = jc.simulate(arm(driven=True), pick_and_place().times[-1], save=136, verify=False)
    last = np.asarray(run.marker(TIP).position - commanded.marker(TIP).position)[-1]
    assert np.linalg.norm(last) < 2e-5


@pytest.fixture(scope="module")
def held():
    """Runs without play and with 1 arcmin of it in all reducers."""
    return {play: study.simulated(arm("play", play), verify=False) for play in (0.0, PLAY)}


def test_where_weight_presses_a_flank_play_adds_half_of_itself(held):
    at = study.ends(pick_and_place().times)
    for name in ("joint2", "joint4", "joint6"):
        plain, loose = (study.twist(run, name)[at] for run in held.values())
        np.testing.assert_allclose(loose - plain, 0.5 * PLAY * np.sign(plain), rtol=0.02)
        # what the elastic reducer carries
        torque = np.asarray(held[0.0].transmitted(name))[at]
        np.testing.assert_allclose(
            np.abs(plain), np.abs(torque) / REDUCERS[name].stiffness, rtol=1e-2
        )


test_play_that_no_scene_can_have_is_refused = refusals(
    {
        "play of arm has shape .3,.; it must be one number or": lambda: arm("play", (1e-4,) * 3),
        "play of arm": lambda: arm("play", -1e-4),
        'no joint "joint8" in kind of arm': lambda: arm(("joint8",)),
    }
)


@pytest.mark.slow(sample=False)
def test_a_reversal_loses_play_and_twice_the_twist():
    way = study.to_and_fro()
    lost = study.lost_motion(study.simulated(arm("play", PLAY, path=way), way), PLAY)
    closed = lost["2 t/k, and the play if crossed [arcmin]"]
    # by the acceleration that is left at the middle of the way
    np.testing.assert_allclose(lost["loses [arcmin]"], closed, rtol=2e-3)
    # friction and damping alone, where no weight presses
    first = 2 * lost["rubs with [N m]"][0] / REDUCERS["joint1"].stiffness + PLAY
    np.testing.assert_allclose(lost["loses [arcmin]"][0] * ARCMIN, first, rtol=2e-2)


@pytest.mark.slow(sample=False)
def test_slopes_by_all_plays_are_those_of_narrower_differences_and_derivatives(held):
    problem = study.tip_problem(study.STANDARD, held[0.0])
    error = jax.jit(jax.vmap(lambda plays: problem.evaluate(plays).responses["tip error"]))
    step = 0.02 * ARCMIN * np.eye(len(JOINTS))
    nominal = np.asarray(problem.nominal())
    above, below = np.split(np.asarray(error(np.concatenate([nominal + step, nominal - step]))), 2)
    found = study.slopes(problem)["slope [mm/arcmin]"]
    narrow = 1e3 * (above - below) / 0.04
    # tenths of a play beside hundredths: the error bends by less
    np.testing.assert_allclose(found, narrow, rtol=0.02)
    derived = jax.jit(jax.jacfwd(lambda plays: problem.evaluate(plays).responses["tip error"]))
    np.testing.assert_allclose(1e3 * ARCMIN * derived(nominal), narrow, rtol=0.02)


@pytest.mark.slow(sample=False)
def test_flanks_of_a_reducer_wear_by_archards_law():
    """k F s / H of the torque that the teeth carry along the way of the joint."""
    law = jc.wear.Archard(wear_coefficient=1e-4, hardness=2e9)
    run = jc.simulate(jc.scenes.arm(["joint2"], wear=law), 0.5, save=501, verify=False)
    power = np.abs(np.asarray(run.coupling("joint2").torque) * np.asarray(run.speed("joint2")))
    way = np.trapezoid(power, np.asarray(run.time))
    volume = sum(float(run.worn_volume("joint2", flank)[-1]) for flank in ("upper", "lower"))
    # Between saving times; damping of the teeth is in both.
    np.testing.assert_allclose(volume, 1e-4 / 2e9 * SLIDING * way, rtol=0.02)
    depth = sum(float(run.worn_depth("joint2", flank)[0, 0]) for flank in ("upper", "lower"))
    assert depth == pytest.approx(volume / 0.0254**2, rel=1e-9)
