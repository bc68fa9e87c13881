"""Flexible beams beside closed forms of elastic rods, and what a mechanism makes of them."""

import importlib.util
import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import plot
from tests.rigs.cells import slow

LENGTH, DIAMETER, MODULUS, DENSITY = 1.0, 0.02, 200e9, 7850.0
STEEL = jc.Material(MODULUS, 0.3)
SECOND = np.pi * DIAMETER**4 / 64
MASS = DENSITY * np.pi * DIAMETER**2 / 4
PINNED = (np.pi / LENGTH) ** 2 * np.sqrt(MODULUS * SECOND / MASS)  # its first frequency [rad/s]
SETTLED = 80 / PINNED


def beam(segments=8, damping=1.5, **more):
    return jc.Beam(LENGTH, jc.section.Circle(DIAMETER), STEEL, DENSITY, segments, damping, **more)


def clamped(rod, force):
    """A cantilever under a force at its tip."""
    wall = jc.Connection(jc.joint.Fixed(), "ground", "rod")
    tip = jc.load.Force(jc.Marker("rod", (rod.length, 0.0)), force)
    return jc.Mechanism({"rod": rod}, {"wall": wall}, {"tip": tip})


def on_pins(rod, loads=None, start=None):
    """A beam on a pin at its start, and one that slides along x at its end."""
    end = jc.Marker("rod", (rod.length, 0.0))
    connections = {
        "left": jc.Connection(jc.joint.Revolute(), "ground", "rod"),
        "right": jc.Connection(jc.joint.Revolute(), end, "shoe"),
        "rail": jc.Connection(
            jc.joint.Prismatic(), jc.Marker("ground", axis="x"), jc.Marker("shoe", axis="x")
        ),
    }
    bodies = {"rod": rod, "shoe": jc.Body(1e-3, 1e-6)}
    return jc.Mechanism(bodies, connections, loads, start=start, guess={"rail": rod.length})


def at_rest(mechanism, periods=1.0):
    """The mechanism as heavy damping leaves it."""
    return jc.simulate(
        mechanism,
        periods * SETTLED,
        save=3,
        integrator=jc.integrator.ImplicitStep(SETTLED / 400),
        verify=False,
    )


def test_tip_of_a_cantilever_its_stress_and_its_derivative():
    force, segments = 1.0, 2
    # The middles of elements carry the curvature: 1 - 1 / (4 n^2).
    exact = force * LENGTH**3 / (3 * MODULUS * SECOND) * (1 - 1 / (4 * segments**2))

    def tip(diameter):
        rig = clamped(beam(segments), (0.0, force))
        rig = eqx.tree_at(lambda own: own.bodies["rod"].section.diameter, rig, diameter)
        run = at_rest(rig)
        return run.deflection("rod", "start")[-1, -1, 1], run

    there, run = tip(jnp.asarray(DIAMETER))
    assert there == pytest.approx(exact, rel=1e-5)
    middle = force * (LENGTH - 0.5 * LENGTH / segments)
    assert run.stress("rod")[-1, 0] == pytest.approx(middle * 0.5 * DIAMETER / SECOND, rel=1e-4)
    # Its tip turns by the sum of curvatures, beside one that no force bends.
    straight = at_rest(clamped(beam(segments), (0.0, 0.0)))
    end = jc.Marker("rod", (LENGTH, 0.0), axis="x")
    boresights = [each.marker(end).rotation[-1, :, 2] for each in (run, straight)]
    turned = jnp.linalg.norm(jnp.cross(*boresights))
    assert turned == pytest.approx(force * LENGTH**2 / (2 * MODULUS * SECOND), rel=1e-4)
    slope = jax.jacfwd(lambda diameter: tip(diameter)[0])(jnp.asarray(DIAMETER))
    assert slope == pytest.approx(-4 * exact / DIAMETER, rel=1e-3)


@pytest.mark.slow(sample=False)
@pytest.mark.parametrize(("across", "tolerance"), [(False, 1e-3), (True, 3e-3)])
def test_large_deflection_beside_elliptic_integrals(across, tolerance):
    # Bisshopp & Drucker 1945, Q. Appl. Math. 3, 272: P L^2 / (E I) = 10.
    force = 10 * MODULUS * SECOND / LENGTH**2
    at = []
    for segments in (4, 8) if across else (8, 16):
        if across:
            rod, load, axis = beam(segments, space=True), (0.0, 0.0, force), 2
        else:
            rod, load, axis = beam(segments), (0.0, force), 1
        seen = at_rest(clamped(rod, load)).deflection("rod", "start")[-1, -1]
        at.append((seen[axis], -seen[0]))
    found = np.asarray(at[1]) + (np.asarray(at[1]) - np.asarray(at[0])) / 3
    if across:  # hinges of several kinds lie beside the middles of elements
        found = np.asarray(at[1])
    np.testing.assert_allclose(found, (0.8106, 0.5550), rtol=tolerance)


@pytest.mark.slow
def test_a_column_under_half_of_its_buckling_load():
    # Timoshenko & Gere 1961, Theory of Elastic Stability, 2nd ed., art. 1.11.
    buckling = np.pi**2 * MODULUS * SECOND / LENGTH**2
    side = 1e-4 * buckling
    half_angle = 0.5 * np.pi * np.sqrt(0.5)
    amplified = 3 * (np.tan(half_angle) - half_angle) / half_angle**3
    exact = side * LENGTH**3 / (48 * MODULUS * SECOND) * amplified
    loads = {
        "side": jc.load.Force(jc.Marker("rod", (0.5 * LENGTH, 0.0)), (0.0, side)),
        "thrust": jc.load.Force(jc.Marker("shoe"), (-0.5 * buckling, 0.0)),
    }
    away = [
        np.abs(at_rest(on_pins(beam(n), loads)).deflection("rod")[-1, :, 1]).max() for n in (8, 16)
    ]
    assert away[1] + (away[1] - away[0]) / 3 == pytest.approx(exact, rel=3e-3)


@pytest.mark.parametrize("held", ["clamped", *slow("pinned", "free")])
def test_first_frequency(held):
    # Roots of cos(x) cosh(x) = -1, sin(x) = 0 and cos(x) cosh(x) = 1: Euler-Bernoulli beams.
    root = {"clamped": 1.8751040687, "pinned": np.pi, "free": 4.7300407449}[held]
    exact = (root / LENGTH) ** 2 * np.sqrt(MODULUS * SECOND / MASS)

    def frequency(segments):
        rod = beam(segments, None)
        places = (np.arange(segments) + 0.5) / segments
        if held == "pinned":
            curvature = np.sin(np.pi * places)
        else:
            sign = 1 if held == "clamped" else -1
            ratio = (np.cosh(root) + sign * np.cos(root)) / (np.sinh(root) + sign * np.sin(root))
            x = root * places
            curvature = np.cosh(x) + sign * np.cos(x) - ratio * (np.sinh(x) + sign * np.sin(x))
        start = {f"rod bend {i + 1}": 1e-3 * c for i, c in enumerate(curvature)}
        if held == "pinned":
            start["left"] = -0.5 * 1e-3 * curvature.sum()
            rig = on_pins(rod, start=start)
        else:
            joint = jc.joint.Fixed() if held == "clamped" else jc.joint.Planar()
            wall = jc.Connection(joint, "ground", "rod")
            rig = jc.Mechanism({"rod": rod}, {"wall": wall}, start=start)
        how = jc.integrator.ImplicitStep(2 * np.pi / exact / 400)
        run = jc.simulate(rig, 3 * 2 * np.pi / exact, save=1201, integrator=how, verify=False)
        way = np.asarray(run.coordinate(f"rod bend {segments // 2}"))
        falls = np.flatnonzero((way[:-1] > 0) & (way[1:] <= 0))
        instants = [float(np.interp(0, -way[i : i + 2], run.time[i : i + 2])) for i in falls]
        return 2 * np.pi * (len(instants) - 1) / (instants[-1] - instants[0])

    # Extrapolated, a remainder of fourth order is left: of 3 and 6 segments 3e-3 for the free beam.
    few = 3 if held == "clamped" else 4
    coarse, fine = frequency(few), frequency(2 * few)
    assert abs(fine / exact - 1) < 0.02
    assert fine + (fine - coarse) / 3 == pytest.approx(exact, rel=1e-3)


@pytest.mark.slow
def test_a_spun_rod_stretches():
    # By its weight in the rotating frame: rho w^2 L^3 / (3 E).
    rate = 50.0
    exact = DENSITY * rate**2 * LENGTH**3 / (3 * MODULUS)
    hub = jc.Connection(jc.joint.Revolute(drive=jc.drive.ConstantSpeed(rate)), "ground", "rod")

    def longer(segments):
        rig = jc.Mechanism({"rod": beam(segments, stretches=True)}, {"hub": hub})
        return float(at_rest(rig).deflection("rod", "start")[-1, -1, 0])

    coarse, fine = longer(4), longer(8)
    assert fine == pytest.approx(exact, rel=2e-3)
    assert fine + (fine - coarse) / 3 == pytest.approx(exact, rel=1e-3)


def test_a_beam_rests_as_its_loads_bend_it():
    force = 1.0
    bent = force * LENGTH**3 / (3 * MODULUS * SECOND) * (1 - 1 / 16)
    rod = beam(2, None)
    tip = jc.Marker("rod", (LENGTH, 0.0))
    rig = jc.Mechanism(
        {"rod": rod},
        {"hub": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"tip": jc.load.Force(tip, (0.0, force))},
    )
    turned = 0.5 * np.pi
    found = jc.positions(rig, {"hub": [0.0, turned]})
    np.testing.assert_allclose(found.marker(tip).position[0], (LENGTH, bent, 0.0), rtol=1e-5)
    # Upright it is pulled along itself.
    np.testing.assert_allclose(found.marker(tip).position[1], (0.0, LENGTH, 0.0), atol=1e-9)


@pytest.mark.slow
def test_spun_up_cantilever():
    # Kane, Ryan & Banerjee 1987, J. Guid. Control Dyn. 10, 139; numbers of Simo & Vu-Quoc 1986,
    # J. Appl. Mech. 53, 855: the tip lags by about 0.575 m at most (read off a figure).
    rate, duration = 6.0, 15.0

    class SpinUp(jc.drive.AbstractDrive):
        def motion(self, time):
            turn = 2 * jnp.pi / duration
            share = rate / duration
            return (
                share * (0.5 * time**2 + (jnp.cos(turn * time) - 1) / turn**2),
                share * (time - jnp.sin(turn * time) / turn),
                share * (1 - jnp.cos(turn * time)),
            )

    def lag(segments):
        rod = jc.Beam(10.0, jc.section.Properties(1.4e4, 1.2), segments=segments)
        hub = jc.Connection(jc.joint.Revolute(drive=SpinUp()), "ground", "rod")
        rig = jc.Mechanism({"rod": rod}, {"hub": hub})
        how = jc.integrator.ImplicitStep(5e-3)
        run = jc.simulate(rig, duration, save=601, integrator=how, verify=False)
        return float(run.deflection("rod", "start")[:, -1, 1].min())

    coarse, fine = lag(8), lag(16)
    assert fine + (fine - coarse) / 3 == pytest.approx(-0.575, abs=3e-3)


def test_a_rod_that_bends_stands_in_the_place_of_a_rigid_one():
    base = jc.scenes.slider_crank("planar", 2e-4, crank_speed=150.0)
    rod = jc.Beam(0.12, jc.section.Circle(6e-3), STEEL, DENSITY, 2, 0.02)
    rig = jc.Mechanism(
        base.bodies | {"rod": rod}, base.connections, base.loads, **base.start_arguments
    )
    assert rig.topology.loops == ()
    assert [rig.connections[n].parent.body for n in ("B", "rod bend 2")] == ["rod 3", "rod 2"]
    printed = str(rig)
    assert "rod bend" not in printed and "3 bodies, 4 connections, 1 load\n" in printed
    run = jc.simulate(rig, 5e-3, save=26, integrator=jc.integrator.ImplicitStep(2e-5), verify=False)
    away = float(jc.response.LargestDeflection("rod")(run))
    assert 1e-6 < away < 2e-3
    pin = jc.Marker("rod", (0.12, 0.0))
    page = (
        plot.animate(run, trace=[pin]).html if importlib.util.find_spec("k3d") else '"name": "rod"'
    )
    assert '"name": "rod"' in page and '"name": "rod 2"' not in page
    end = run.marker("rod", (0.12, 0.0)).position
    np.testing.assert_allclose(end, run.marker("rod 3", (0.03, 0.0)).position, atol=1e-15)
    # Its numbers are leaves, and parts can be exchanged.
    assert 'bodies["rod"].section.diameter' in str(rig.parameters())
    stiff = rig.with_body("rod", eqx.tree_at(lambda own: own.section.diameter, rod, 12e-3))
    assert stiff.bodies["rod 3"].mass == pytest.approx(4 * rig.bodies["rod 3"].mass)
    pulled = rig.with_load("pull", jc.load.Force(jc.Marker("rod", (0.06, 0.0)), (0.0, 1.0)))
    assert pulled.loads["pull"].marker.body == "rod 2"
    again = pickle.loads(pickle.dumps(rig))
    assert again.bodies["rod 2"].mass == rig.bodies["rod 2"].mass


def test_parts_are_exchanged_around_a_beam_and_it_itself():
    rig = clamped(beam(4), (0.0, 1.0))
    assert set(rig.with_loads({}).loads) == {"rod elasticity"}
    finer = rig.with_body("rod", beam(5))
    assert (len(finer.bodies), finer.loads["tip"].marker.body) == (6, "rod 6")
    assert len(finer.connections) == 1 + 5
    assert finer.loads["tip"].marker.at[0] == pytest.approx(0.1, rel=1e-14)
    rigid = finer.with_body("rod", jc.Body(1.0, 1.0))
    assert (list(rigid.bodies), list(rigid.connections)) == (["rod"], ["wall"])
    assert list(rigid.loads) == ["tip"]
    assert rigid.loads["tip"].marker.body == "rod"
    assert rigid.loads["tip"].marker.at[0] == pytest.approx(LENGTH, rel=1e-15)
    # Every length along the beam grows with it, by its name.
    warm = jc.apply_thermal_expansion(rig, 100.0, {"rod": 1e-5})
    along = [float(warm.connections[f"rod bend {i + 1}"].parent.at[0]) for i in range(4)]
    assert sum(along) + warm.loads["tip"].marker.at[0] == pytest.approx(1.001 * LENGTH, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("loose", [False, *slow(True)])
def test_beams_start_straight_where_loops_let_them(loose):
    base = jc.scenes.slider_crank("planar", 2e-4, crank_speed=150.0)
    turned, crank, rod = 1.0, 0.05, 0.12
    given = {"O": jc.joint.Revolute(drive=jc.drive.ConstantSpeed(150.0, start=turned))}
    if not loose:
        given["B"] = jc.joint.Revolute()
    connections = {
        n: jc.Connection(given.get(n, own.joint), own.parent, own.child)
        for n, own in base.connections.items()
    }
    bends = jc.Beam(rod, jc.section.Circle(6e-3), STEEL, DENSITY, 2)
    rig = jc.Mechanism(base.bodies | {"rod": bends}, connections, guess={"G": 0.17})
    start = jc.assemble(rig)
    branches = {b.name: b for b in rig.topology.branches}
    for i in range(2):
        hinge = branches[f"rod bend {i + 1}"]
        assert abs(start.coordinates[hinge.coordinates]) < 1e-15
        assert abs(start.speeds[hinge.speeds]) < 1e-12
    # The slider-crank with a rigid rod, whose slider stands apart and not on the crank's line.
    slope = np.arcsin(crank * np.sin(turned) / rod)
    if "A" in branches:
        angle = start.coordinates[branches["A"].coordinates][0]
        assert angle == pytest.approx(-turned - slope, abs=1e-12)


def test_what_a_beam_is_refused_for():
    with pytest.raises(ValueError, match="length = -1.0; it must be a number above 0"):
        jc.Beam(-1.0, jc.section.Circle(0.1), STEEL, DENSITY)
    with pytest.raises(ValueError, match="needs a material and a density"):
        jc.Beam(1.0, jc.section.Circle(0.1))
    with pytest.raises(ValueError, match="needs GJ and turning_inertia"):
        jc.Beam(1.0, jc.section.Properties(1.0, 1.0), space=True)
    with pytest.raises(ValueError, match='beam "rod" lies at x = 2'):
        clamped(beam(), (0.0, 1.0)).with_load(
            "pull", jc.load.Force(jc.Marker("rod", (2.0, 0.0)), (0.0, 1.0))
        )
    rig = clamped(beam(4), (0.0, 1.0))
    for build in (
        lambda: rig.with_joint("rod bend 1", jc.joint.Fixed()),
        lambda: rig.with_body("rod 2", jc.Body(1.0, 1.0)),
        lambda: rig.with_load("rod elasticity", jc.load.Gravity()),
        # What is read of a piece is a body.
        lambda: jc.Mechanism({**dict(rig.bodies.items())}, rig.connections, rig.loads),
    ):
        with pytest.raises(ValueError, match='a part of the beam "rod", which makes it itself'):
            build()
    with pytest.raises(ValueError, match='no load "rod elasticity"'):
        rig.with_load("rod elasticity", None)
    thin = jc.Beam(1.0, jc.section.Properties(100.0, 1.0), segments=2, damping=1.5)
    run = at_rest(clamped(thin, (0.0, 1.0)))
    with pytest.raises(ValueError, match="without an outer fibre"):
        run.stress("rod")
    with pytest.raises(ValueError, match='no beam "wall"'):
        run.deflection("wall")


def test_a_load_that_settles_by_its_inertia_acts_beside_a_beam():
    # Its numbers follow in a traced mechanism, which is built anew.
    rod = jc.Beam(0.12, jc.section.Circle(6e-3), STEEL, DENSITY, 2, 0.02)
    scene = jc.scenes.slider_crank("ideal", crank_speed=20.0)
    rubs = scene.loads | {"rub": jc.load.JointFriction("G", torque=5.0)}
    rig = jc.Mechanism(
        scene.bodies | {"rod": rod}, scene.connections, rubs, **scene.start_arguments
    )
    how = jc.integrator.ImplicitStep(1e-5)
    run = jc.simulate(rig, 2e-3, save=3, integrator=how, verify=False)
    assert abs(run.transmitted("rub")[-1]) == pytest.approx(5.0, rel=1e-2)


def test_sections():
    width, height = 0.01, 0.03
    area, about_y, about_z, torsion = jc.section.Rectangle(width, height).areas()
    assert (area, about_y, about_z) == pytest.approx(
        (width * height, height * width**3 / 12, width * height**3 / 12)
    )
    assert torsion == pytest.approx(0.263 * height * width**3, rel=3e-3)  # Timoshenko: 3 to 1
    ring = jc.section.Tube(0.02, 0.03).areas()
    whole, hole = jc.section.Circle(0.03).areas(), jc.section.Circle(0.02).areas()
    np.testing.assert_allclose(ring, np.subtract(whole, hole), rtol=1e-12)
