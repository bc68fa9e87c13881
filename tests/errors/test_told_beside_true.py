"""Told errors beside true ones, against solutions from outside: orders that are known, bounces
solved event by event, Archard's law, references in tight tolerances."""

import math

import equinox as eqx
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxclear as jc
from benchmarks.attacks.structures import structures
from jaxclear.errors import verification
from jaxclear.errors.estimates import HALF
from tests.extension.test_contact_law import Cushion
from tests.rigs.bouncing_journal import CLEARANCE, GRAVITY, MASS, falling
from tests.rigs.cells import slow
from tests.rigs.loaded_bearing import loaded_bearing
from tests.rigs.wearing_ring import RADIUS, SAVES, TURN, ClosedForm, wearing_ring

pytestmark = [pytest.mark.verified, pytest.mark.usefixtures("optimised_kernels")]
# Told beside true: steps of order 1 are told as they are, of higher order up to twice as large;
# several impacts may cancel or add.
LEAST, MOST = 0.5, 10.0
REFERENCE = jc.integrator.Adaptive(rtol=1e-12, atol=1e-14)


def within(told, true):
    return LEAST * true <= told <= MOST * true


LENGTH, INERTIA, ANGLE, END = 0.5, 0.1, 2.0, 2.0


def pendulum():
    rod = jc.Body(1.0, INERTIA, (0.0, -LENGTH))
    joint = jc.Connection(jc.joint.Revolute(), "ground", "rod")
    gravity = jc.load.Gravity((0.0, -GRAVITY))
    return jc.Mechanism({"rod": rod}, {"O": joint}, {"gravity": gravity}, start={"O": ANGLE})


def last(run):
    return run.coordinate("O")[-1]


STEPS = {
    "semi_implicit": (1, jc.integrator.FixedStep(5e-4, "semi_implicit")),
    "heun": (2, jc.integrator.FixedStep(2e-3, "heun")),
    "rk4": (4, jc.integrator.FixedStep(1e-2, "rk4")),
    "implicit": (2, jc.integrator.ImplicitStep(2e-3)),
}


@pytest.mark.parametrize(
    "name",
    [
        "rk4",
        "implicit",
        *slow("semi_implicit", "heun"),
    ],
)
def test_three_lengths_of_steps_show_the_known_order(name, monkeypatch):
    monkeypatch.setattr(verification, "DOUBT", 0.0)
    order, integrator = STEPS[name]
    run = jc.simulate(pendulum(), END, save=5, integrator=integrator)
    half, quarter = map(last, run.verification.replicas)
    observed = math.log2(abs(float((last(run) - half) / (half - quarter))))
    assert observed == pytest.approx(order, abs=0.2)

    def slope(t, y):
        return y[1], -LENGTH * GRAVITY * math.sin(y[0]) / (INERTIA + LENGTH**2)

    exact = solve_ivp(slope, (0, END), (ANGLE, 0.0), "DOP853", rtol=1e-13, atol=1e-13).y[0, -1]
    found = run.estimate(last)
    assert found.value == last(run) and within(found.error, abs(float(last(run)) - exact))


def bounces(force, clearance, times):
    """Way fallen [m] at these times, flight by flight and contact by contact."""
    time, y, inside, way = 0.0, np.zeros(2), True, np.zeros(len(times))
    while time < times[-1]:

        def slope(t, y, inside=inside):
            push = 0.0 if inside else force(max(y[0] - clearance, 0.0))
            return y[1], GRAVITY - push / MASS

        def event(t, y):
            return y[0] - clearance

        event.terminal, event.direction = True, 1 if inside else -1
        tight = {"rtol": 1e-12, "atol": 1e-15, "dense_output": True}
        found = solve_ivp(slope, (time, times[-1] + 1e-9), y, "DOP853", events=event, **tight)
        seen = (times >= time) & (times <= found.t[-1])
        way[seen] = found.sol(times[seen])[0] if seen.any() else 0.0
        time, y, inside = found.t[-1], found.y[:, -1], not inside
    return way


# Laws with what they say of the force [N] at a depth [m].
HERTZ = jc.contact.Hertz(stiffness=1e10), lambda depth: 1e10 * depth**1.5
STRANGERS = (
    jc.contact.ContactForce(Cushion(stiffness=1e7)),
    lambda depth: 1e7 * depth * (1 + depth / 1e-3),
)
RUNGS = {
    "adaptive": jc.integrator.Adaptive(),
    "fixed": jc.integrator.FixedStep(1e-5),
    "implicit": jc.integrator.ImplicitStep(1e-5, rebound=1.0),
}


@pytest.mark.parametrize(
    ("law", "rung"),
    [
        *slow((HERTZ, "fixed"), (HERTZ, "adaptive")),
        (HERTZ, "implicit"),
        (STRANGERS, "adaptive"),
    ],
    ids=["fixed", "adaptive", "implicit", "a stranger's law"],
)
def test_a_chain_of_bounces_tells_how_far_off_it_is(law, rung):
    """And so does a law and a response that nobody here knows of."""
    law, force = law
    rig = falling(law)
    run = jc.simulate(rig, 0.12, save=61, integrator=RUNGS[rung])
    wanted = bounces(force, float(CLEARANCE(rig)), np.asarray(run.time))
    found = run.estimate(lambda own: own.body("journal").com[:, 1])
    true = float(np.max(np.abs(found.value + wanted)))
    assert within(float(np.max(found.error)), true)
    (gap,) = (each for each in run.verification.entries if each.part == "gaps")
    assert gap.error == pytest.approx(float(np.max(found.error)), rel=1e-3)


def test_archards_law_at_a_constant_load_is_within_its_told_error():
    """One turn of a ring: V = k F s / H, from a start at rest in the contact."""
    rig = wearing_ring(slope=0.0)
    integrator = jc.integrator.FixedStep(5e-5, "semi_implicit")
    run = jc.simulate(rig, TURN, save=SAVES, integrator=integrator)
    depth = ClosedForm(0.0).rate(0.0)
    width = 2 * math.pi * RADIUS * float(rig.connections["B"].joint.length)
    volume = run.estimate(jc.response.WornVolume("B"))
    # What the closed form leaves out: the radius grows as it wears, and the indentation with it.
    beside = 1e-5
    assert abs(float(volume.value) - depth * width) <= float(volume.error) + beside * volume.value
    deepest = run.estimate(jc.response.PeakWornDepth("B"))
    assert abs(float(deepest.value) - depth) <= float(deepest.error) + beside * depth


@pytest.mark.parametrize("rung", ["fixed", *slow("implicit")])
def test_what_a_loaded_bearing_loses_is_told_with_its_error(rung):
    rig = loaded_bearing(200.0, jc.friction.CoulombTanh(mu_kinetic=0.1), sliding=True)
    run = jc.simulate(rig, 0.02, save=21, integrator=RUNGS[rung])
    tight = jc.simulate(rig, 0.02, save=21, integrator=REFERENCE, verify=False)
    found = run.estimate(jc.response.WornVolume("B"))
    true = abs(float(found.value - jc.response.WornVolume("B")(tight)))
    assert true <= found.error <= MOST * true


@pytest.mark.parametrize("saves", [51, 101, 401])
def test_the_error_of_a_worn_depth_is_stated_however_many_saving_times(saves):
    """Few: parts between updates hold whole bounces, which half of them hold as well. Many: more
    than updates are usual in twice as fine a replica."""
    rig = loaded_bearing(200.0, jc.friction.CoulombTanh(mu_kinetic=0.1), sliding=True)
    depth = jc.response.PeakWornDepth("B")
    run = jc.simulate(rig, 0.02, save=saves)
    often = jc.simulate(rig, 0.02, save=3201, verify=False)
    found = run.estimate(depth)
    true = abs(found.value - depth(often))
    assert true <= found.error <= MOST * true
    (row,) = (each for each in run.verification.entries if each.answer == "worn depth")
    assert row.error == pytest.approx(float(found.error), rel=1e-6)
    # What a user draws may read depths; a volume follows the motion.
    drawn = run.estimate(lambda run: depth(run))
    assert float(drawn.error) == pytest.approx(float(found.error), rel=1e-6)


def slider_crank(seed):
    """A slider-crank with one loose bearing, drawn: as the prototypes of this room."""
    rng = np.random.default_rng([5, seed])
    law = (jc.contact.CarvalhoMartins, jc.contact.Gonthier, jc.contact.Flores)[rng.integers(3)]
    clearance = 10 ** rng.uniform(-4.2, -3.3)
    bearing = jc.clearance.PlanarJournalBearing(
        law(restitution=rng.uniform(0.4, 0.88)),
        jc.friction.Ambrosio(mu_kinetic=rng.uniform(0.01, 0.1)),
        bearing_radius=rng.uniform(6e-3, 15e-3),
        clearance=clearance,
    )
    mass, speed = rng.uniform(0.1, 0.5), rng.uniform(30, 150)
    rig = jc.scenes.slider_crank(bearing, crank_speed=speed, gravity=None)
    return clearance, eqx.tree_at(lambda m: m.bodies["slider"].mass, rig, mass)


# Of one law, and so one program; the places of the last are off by 2.4 % of the clearance.
@pytest.mark.parametrize("seed", [8, *slow(10), 11])
def test_places_in_a_gap_are_told_as_far_off_as_they_are(seed):
    clearance, rig = slider_crank(seed)
    run = jc.simulate(rig, 0.15, save=301)
    tight = jc.simulate(rig, 0.15, save=301, integrator=REFERENCE, verify=False)
    off = np.abs(np.asarray(run.contact("B").offset) - np.asarray(tight.contact("B").offset))
    (gap,) = (each for each in run.verification.entries if each.part == "gaps")
    assert within(gap.share, float(off.max()) / clearance)
    said = any('Places in the gap, "B": error about' in each for each in run.warnings)
    # A place beyond its tolerance needs no quarter of the step to be beyond it.
    assert said == (seed == 11) and run.verification.step_ratios == (HALF,)


def test_paths_that_hang_on_the_tenth_digit_are_no_answer_but_means_are():
    """5000 rpm and half a millimetre: impacts part neighbouring paths by thousands in a turn."""
    rig = jc.scenes.slider_crank(clearance=0.5e-3, crank_speed=523.6)
    run = jc.simulate(rig, 0.08, save=501)
    [note] = run.notes
    assert note.startswith("From 0.0") and "chaotic (differences grow e-fold in 0.00" in note
    # Means over the run are right; of its path at most the places of bodies are beyond theirs.
    assert all(sentence.startswith("Places of bodies") for sentence in run.warnings)
    assert run.result.startswith("The run reached its end") and note in str(run)
    assert 0.01 < run.verification.path[0] < 0.08
    # Its second replica is the first from the other start: no step confirms another here.
    assert run.verification.step_ratios == (HALF, HALF)
    assert run.estimate(lambda run: run.time[-1]).why.endswith("half the step, from two starts")
    mean = jc.response.MeanContactForce("B")
    found = run.estimate(mean)
    tight = jc.simulate(rig, 0.08, save=501, integrator=REFERENCE, verify=False)
    assert abs(float(found.value - mean(tight))) < run.verification.tolerance(mean) * found.value
    assert "mean_force" not in run.verification.beyond


def test_a_gap_that_is_narrow_beside_the_arms_gets_finer_steps_too():
    """There tolerances count that are tighter than those given: the replica was the run itself."""
    run = jc.simulate(jc.scenes.slider_crank(clearance=1e-6), 0.01, save=21)
    (finer,) = run.verification.replicas
    assert finer.accepted_steps > 1.3 * run.accepted_steps


@pytest.mark.slow
def test_a_peak_is_no_surer_than_a_mean_that_is_beyond_its_promise():
    """A spinning ball in its socket by steps far longer than its impacts: in halves of them its
    peak is alike, and three times too large."""
    case = structures()[24].case(72)
    force, runs = jc.response.PeakContactForce("B"), []
    for integrator in (jc.integrator.ImplicitStep(6.314e-4), jc.integrator.Adaptive()):
        run = jc.simulate(
            case.mechanism,
            case.duration,
            save=201,
            integrator=integrator,
            state=jc.State(concentric=True),
            verify=isinstance(integrator, jc.integrator.ImplicitStep),
        )
        runs.append(run)
    coarse, right = (float(force(run)) for run in runs)
    assert coarse > 3 * right
    assert {"mean_force", "peak_force"} <= runs[0].verification.beyond
