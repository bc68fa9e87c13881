"""Mechanisms with ideal loops against published benchmarks: Andrews' squeezer, and the N-window
four-bar of IFToMM.

The four-bar's windows are parallelograms, so the whole of it obeys ((N+1)/3 + N) phi'' = g ((N+1)/2
+ N) sin phi with phi from the vertical (rods of 1 m and 1 kg): an oracle to rounding for any N,
derivatives included."""

import json
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxclear as jc
from jaxclear.multibody.assembly import assemble_arrays
from jaxclear.simulation.simulate import run

FOLDER = Path(__file__).parents[1] / "refdata"
SQUEEZER = json.loads((FOLDER / "andrews_squeezer.json").read_text())
IFTOMM = json.loads((FOLDER / "iftomm_benchmarks.json").read_text())
GRAVITY = 9.81


def squeezer(data):
    """Seven bodies; E is the pin where four of them meet. Names of points as in the test set."""
    n = data["length"]
    mass, inertia = data["mass"], data["inertia"]
    centres = (
        *((n["ra"], 0.0), (-n["da"], 0.0), (n["sb"], -n["sa"]), (0.0, n["ea"] - n["e"])),
        *((n["ta"], n["tb"]), (n["zf"] - n["fa"], 0.0), (n["ua"], -n["ub"])),
    )
    bodies = {f"K{i + 1}": jc.Body(mass[i], inertia[i], centres[i]) for i in range(7)}
    pin = jc.joint.Revolute()
    a, b, c = ((n[f"x{point}"], n[f"y{point}"]) for point in "abc")
    at_e = jc.Marker("K2", (-n["d"], 0.0))
    connections = {
        "O": jc.Connection(pin, "ground", "K1"),
        "F": jc.Connection(pin, "K1", "K2", at=(n["rr"], 0.0)),
        "B": jc.Connection(pin, "ground", "K3", at=b),
        "A": jc.Connection(pin, "ground", "K5", at=a),
        "G": jc.Connection(pin, "K5", "K4", at=(n["zt"], 0.0)),
        "A'": jc.Connection(pin, "ground", "K7", at=a),
        "H": jc.Connection(pin, "K7", "K6", at=(0.0, -n["u"])),
        "E3": jc.Connection(pin, at_e, jc.Marker("K3", (0.0, -n["ss"]))),
        "E4": jc.Connection(pin, at_e, jc.Marker("K4", (0.0, -n["e"]))),
        "E6": jc.Connection(pin, at_e, jc.Marker("K6", (n["zf"], 0.0))),
    }
    order, ends = (
        ("O", "F", "B", "G", "A", "H", "A'"),
        (jc.Marker("ground", c), jc.Marker("K3", (n["sd"], -n["sc"]))),
    )
    spring = jc.load.Spring(*ends, data["stiffness"], n["l0"])
    loads = {"drive": jc.load.Torque(jc.Marker("K1"), (data["torque"],)), "spring": spring}
    start = dict(zip(order, data["start"], strict=True))
    return jc.Mechanism(bodies, connections, loads, start=start), order


@pytest.fixture(scope="module")
def squeezed():
    rig, order = squeezer(SQUEEZER)
    precise = jc.integrator.Adaptive(solver=diffrax.Dopri8(), rtol=1e-12, atol=1e-13)
    return jc.simulate(rig, SQUEEZER["time"], save=2, integrator=precise), order


def test_andrews_squeezer_ends_where_the_test_set_says(squeezed):
    """Its loops are open by 1e-13 m beside lengths of 3e-2 m: with exact rows drift is the
    integrator's error only."""
    trajectory, order = squeezed
    for what, column in (("position", "coordinate"), ("velocity", "speed")):
        found = np.array([getattr(trajectory, column)(name)[-1] for name in order])
        np.testing.assert_allclose(found, SQUEEZER[what], rtol=SQUEEZER["tolerance"][what])
    drifts = {name: float(drift[-1]) for name, drift in trajectory.drift().items()}
    assert set(drifts) == {"E3", "E4", "E6"} and max(drifts.values()) < 1e-13, drifts


def test_point_pendulum_of_iftomm():
    """Benchmark A01; a small inertia stands for none, its effect 1e-9 of m L^2."""
    data = IFTOMM["A01"]
    rig = jc.Mechanism(
        {"bob": jc.Body(1.0, 1e-9, (1.0, 0.0))},
        {"pin": jc.Connection(jc.joint.Revolute(), "ground", "bob")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
        start={"pin": np.pi},
    )
    trajectory = jc.simulate(
        rig, data["time"][-1], save=data["time"], integrator=jc.integrator.Adaptive(rtol=1e-10)
    )
    error = np.abs(trajectory.body("bob").com[1:, :2] - np.array(data["place"])).max()
    assert error < IFTOMM["tolerance"]["A01"]


def windows(count, speed=1.0, gravity=GRAVITY):
    """count + 1 rods on the ground, upright, their tops joined by count rods."""
    pin, rod, bodies, connections = (
        jc.joint.Revolute(),
        jc.Body(1.0, 1.0 / 12.0, (0.5, 0.0)),
        {},
        {},
    )
    for i in range(count + 1):
        bodies[f"wall {i}"] = rod
        connections[f"foot {i}"] = jc.Connection(pin, "ground", f"wall {i}", at=(float(i), 0.0))
    for i in range(count):
        bodies[f"beam {i}"] = rod
        ends = jc.Marker(f"beam {i}", (1.0, 0.0)), jc.Marker(f"wall {i + 1}", (1.0, 0.0))
        connections[f"left {i}"] = jc.Connection(pin, f"wall {i}", f"beam {i}", at=(1.0, 0.0))
        connections[f"right {i}"] = jc.Connection(pin, *ends)
    feet, tops = (
        [f"{kind} {i}" for i in range(count + more)] for kind, more in (("foot", 1), ("left", 0))
    )
    begins = {
        name: dict.fromkeys(feet, own) | dict.fromkeys(tops, -own)
        for name, own in (("start", np.pi / 2), ("speeds", -speed))
    }
    weight = {"gravity": jc.load.Gravity((0.0, -gravity))}
    return jc.Mechanism(bodies, connections, weight, **begins)


def angle_of_windows(count, times, speed=1.0, gravity=GRAVITY):
    """phi, its rate and the derivatives of phi by speed and gravity at the times, from the
    one-freedom equation."""
    rate = ((count + 1) / 2 + count) / ((count + 1) / 3 + count)

    def field(_, y):
        phi, omega, by_speed, speed_rate, by_gravity, gravity_rate = y
        slope, pull = gravity * rate * np.cos(phi), rate * np.sin(phi)
        bent = slope * by_gravity + pull
        return [omega, gravity * pull, speed_rate, slope * by_speed, gravity_rate, bent]

    start = [0.0, speed, 0.0, 1.0, 0.0, 0.0]
    return solve_ivp(field, (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-12).y


def tip_error(count, times, integrator, place=None):
    trajectory = jc.simulate(windows(count), times[-1], save=times, integrator=integrator)
    phi = angle_of_windows(count, times)[0]
    place = np.stack([np.sin(phi), np.cos(phi)], axis=1) if place is None else np.array(place)
    drift = max(float(d.max()) for d in trajectory.drift().values())
    return np.abs(trajectory.marker("wall 0", (1.0, 0.0)).position[1:, :2] - place).max(), drift


@pytest.mark.slow
def test_windows_pass_their_singular_position():
    """All rods in one line every half turn; 1e-6 m over 10 s at N = 2."""
    times = np.array(IFTOMM["A02"]["time"][:5])
    error, drift = tip_error(2, times, jc.integrator.Adaptive(rtol=1e-10, atol=1e-12))
    assert error < 1e-6 and drift < 1e-9


@pytest.mark.slow
@pytest.mark.usefixtures("optimised_kernels")
def test_a_linkage_that_folds_the_other_way_is_not_trusted():
    """At a loose tolerance some runs leave a singular position on another branch, by chance, which
    roundings decide: the repeated run differs. Of nineteen starting speeds until two have."""
    times, wrong = np.linspace(0.0, 10.0, 6), 0
    loose = jc.integrator.Adaptive(rtol=1e-5, atol=1e-7)
    for speed in 1 + 0.003 * np.arange(5, 100, 5):
        rig = windows(5, speed)
        run = jc.simulate(rig, times[-1], save=times, integrator=loose, verify=True)
        phi = angle_of_windows(5, times[1:], speed)[0]
        place = run.marker("wall 0", (1.0, 0.0)).position[1:, :2]
        if np.abs(place - np.stack([np.sin(phi), np.cos(phi)], axis=1)).max() > 1e-2:
            wrong += 1
            assert any("error about" in warning for warning in run.warnings)
        if wrong == 2:
            break
    assert wrong == 2


@pytest.mark.slow(sample=False)
@pytest.mark.xfail(
    strict=False,
    reason="a step that comes near a singular position enlarges what loops are open by, and steps "
    "shrink until the run ends there: 16 % of runs of five windows at rtol 1e-10, most of forty",
)
@pytest.mark.filterwarnings("ignore:jaxclear runs a time loop through XLA")
def test_forty_windows_of_iftomm():
    """Benchmark A02: 81 rods, 80 closure rows, 20 s. So many rows are factorised as arrays, for
    which there is no machine code."""
    data, integrator = IFTOMM["A02"], jc.integrator.Adaptive(rtol=1e-9, atol=1e-11)
    error, _ = tip_error(40, np.array(data["time"]), integrator, data["place"])
    assert error < IFTOMM["tolerance"]["A02"]


@pytest.mark.slow
def test_derivative_through_closed_loops_is_that_of_the_single_freedom():
    """phi(1 s) by starting speed and by gravity, forward through 500 Runge-Kutta steps: 1e-8
    relative."""
    times, fixed = jnp.array([0.0, 1.0]), jc.integrator.FixedStep(step=2e-3)

    def turned(numbers):
        rig = windows(2, *numbers)
        start = assemble_arrays(rig)
        found = run(rig, start.coordinates, start.speeds, times, fixed)
        return np.pi / 2 - found.coordinate("foot 0")[-1]

    found = jax.jit(jax.jacfwd(turned))(jnp.array([1.0, GRAVITY]))
    wanted = angle_of_windows(2, np.array([1.0]))
    np.testing.assert_allclose(found, wanted[[2, 4], -1], rtol=1e-8)
