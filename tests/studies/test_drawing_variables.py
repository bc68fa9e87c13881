"""Variables that drawings have beside lengths: a condition such as temperature, an axis that is
askew, a bore that is not round."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from tests.rigs.refusals import refusals

ANGLES = [0.4, 2.0, 4.0]
STEEL, ALUMINIUM, RISE = 11.5e-6, 23e-6, 40.0


def rig(**more):
    return jc.scenes.four_bar("planar", 0.2e-3, friction=False, wear=False, **more)


def test_a_mechanism_heated_evenly_keeps_its_angles():
    """Heat that makes all parts larger alike makes a larger similar mechanism, play included."""
    cold = jc.positions(rig(), {"O": ANGLES})
    warm = jc.positions(jc.apply_thermal_expansion(rig(), 500.0, STEEL), {"O": ANGLES})
    np.testing.assert_allclose(warm.coordinate("D"), cold.coordinate("D"), atol=1e-12)
    np.testing.assert_allclose(
        warm.offset("B"), (1 + 500 * STEEL) * np.asarray(cold.offset("B")), atol=1e-12
    )


CLEARANCE, SIZE = 60e-6, 10e-3


HERTZ, INNER, OUTER = jc.contact.Hertz(), ALUMINIUM * RISE, STEEL * RISE
PLAY = {"clearance": CLEARANCE}
FLANGE = jc.clearance.Flange(HERTZ, radius=14e-3, clearance=1e-4)
CLOSED = CLEARANCE - (INNER - OUTER) * SIZE + INNER * CLEARANCE
# A bearing of steel with a journal of aluminium, and its gap by closed form.
JOINTS = {
    "planar": (jc.clearance.PlanarJournalBearing(HERTZ, bearing_radius=SIZE, **PLAY), CLOSED),
    "ball": (jc.clearance.BallSocket(HERTZ, socket_radius=SIZE, **PLAY), CLOSED),
    # Collars grow apart with their journal.
    "flange": (
        jc.clearance.JournalBearing(HERTZ, length=20e-3, flange=FLANGE),
        1e-4 * (1 + INNER) + 10e-3 * (INNER - OUTER),
    ),
    "guide": (
        jc.clearance.SliderGuide(HERTZ, width=20e-3, clearance=1e-4),
        1e-4 * (1 + OUTER) - 10e-3 * (INNER - OUTER),
    ),
}


@pytest.mark.parametrize("name", JOINTS)
def test_a_part_that_grows_more_than_what_it_runs_in_closes_the_gap(name):
    joint, gap = JOINTS[name]
    grown = joint.grown(1 + OUTER, 1 + INNER)
    grown = grown.flange if name == "flange" else grown
    assert float(grown.clearance) == pytest.approx(gap, rel=1e-12)


@pytest.mark.slow
def test_temperature_varies_as_a_condition_of_the_samples():
    """The follower's angle against rigs that are built warm."""
    materials = {"coupler": ALUMINIUM, "follower": STEEL}
    asked = jc.PositionProblem(
        rig(),
        lambda stands: stands.coordinate("D")[1],
        {
            "temperature": jc.Condition(
                lambda m, rise: jc.apply_thermal_expansion(m, rise, materials),
                0.0,
                jc.distribution.Uniform(30.0),
            ),
            "clearance": jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=2e-5),
        },
        positions={"O": ANGLES},
    )
    assert asked.variable_units == ("K", "m")
    study = jc.monte_carlo(asked, 4, seed=1)
    for (rise, clearance), found in zip(study.values, study.responses["response"], strict=True):
        own = eqx.tree_at(
            lambda m: m.connections["B"].joint.clearance, rig(), jnp.asarray(clearance)
        )
        alone = jc.positions(jc.apply_thermal_expansion(own, rise, materials), {"O": ANGLES})
        assert found == pytest.approx(float(alone.coordinate("D")[1]), abs=1e-11)


test_what_cannot_be_is_refused_with_a_sentence = refusals(
    {
        'no body "crnk"': lambda: jc.apply_thermal_expansion(rig(), 10.0, {"crnk": STEEL}),
        "rise of apply_thermal_expansion": lambda: jc.apply_thermal_expansion(rig(), np.nan, STEEL),
        "acts of a Condition": lambda: jc.Condition(3.0, 0.0, tolerance=1.0),
        "expansion of a Heating is empty; it must hold": lambda: jc.Heating({}),
        'what condition "t" makes': lambda: jc.PositionProblem(
            rig(),
            lambda stands: stands.coordinate("D")[0],
            {"t": jc.Condition(lambda m, rise: rise, 0.0, tolerance=1.0)},
            positions={"O": ANGLES},
        ),
        r"What is not given there cannot vary.*axis=\(0, 0, 1\)": lambda: jc.PositionProblem(
            rig(),
            lambda stands: stands.coordinate("D")[0],
            {"axis": jc.Variable(lambda m: m.connections["B"].parent.axis, tolerance=1e-3)},
            positions={"O": ANGLES},
        ),
    }
)


def boom(angle, lobes=None, axis=(0.0, 0.0, 1.0)):
    """A boom of 2 m on a vertical journal whose marker's axis may lean, held at an angle."""
    joint = jc.clearance.JournalBearing(
        jc.contact.Hertz(), clearance=50e-6, length=0.1, journal_length=0.12, roundness=lobes
    )
    return jc.Mechanism(
        {"boom": jc.Body(10.0, (0.1, 13.0, 13.0), (1.0, 0.0, 0.0))},
        {"post": jc.Connection(joint, jc.Marker("ground", axis=axis), jc.Marker("boom"))},
        {"gravity": jc.load.Gravity((0.0, 0.0, -9.81))},
        start={"post": angle},
    )


@pytest.mark.slow
def test_an_axis_askew_lifts_the_tip_by_its_angle():
    """By closed form: in a round bore the boom's weight tips the journal by 2 c / L besides."""
    lean = 1e-3

    def height(axis):
        stands = jc.positions(boom(0.0, axis=axis), {"post": [0.0, np.pi / 2]})
        return np.asarray(stands.marker("boom", (2.0, 0.0, 0.0)).position)[:, 2]

    straight, askew = height((0.0, 0.0, 1.0)), height((-lean, 0.0, 1.0))
    np.testing.assert_allclose(straight, -2.0 * 2 * 50e-6 / 0.1, rtol=1e-5)
    # leant against x, the boom along x rises by the angle; along y it does not
    np.testing.assert_allclose(askew - straight, (2.0 * lean, 0.0), atol=4e-6)


@pytest.mark.slow
def test_a_boom_on_an_oval_bore_tips_most_across_its_wide_side():
    """Gaps of 50 + 4 um along x and 50 - 4 um along y, at either end."""
    oval = (jc.clearance.Lobes(2, cosine=4e-6),)
    stands = jc.positions(boom(0.0, oval), {"post": [0.0, np.pi / 2]})
    height = np.asarray(stands.marker("boom", (2.0, 0.0, 0.0)).position)[:, 2]
    np.testing.assert_allclose(height, -2.0 * 2 * np.array([54e-6, 46e-6]) / 0.1, rtol=1e-5)


def test_one_bearing_given_to_two_joints_has_numbers_of_its_own_in_each():
    law = jc.contact.LankaraniNikravesh(restitution=0.8)
    bearing = jc.clearance.PlanarJournalBearing(law, clearance=1e-4)
    link = jc.Body(0.1, 1e-4, com=(0.05, 0.0))
    joints = {
        "P": jc.Connection(bearing, "ground", "b"),
        "Q": jc.Connection(bearing, "b", "a", at=(0.1, 0.0)),
    }
    rig = jc.Mechanism({"b": link, "a": link}, joints, {"gravity": jc.load.Gravity((0.0, -9.81))})
    where = {name: lambda rig, n=name: rig.connections[n].joint.clearance for name in "PQ"}
    varied = {name: jc.Variable(own, tolerance=1e-5) for name, own in where.items()}
    problem = jc.Problem(rig, jc.response.MeanContactForce("Q"), varied, duration=0.01)
    moved = problem.with_values(jnp.array([2e-4, 3e-4]))
    assert [float(own(moved)) for own in where.values()] == [2e-4, 3e-4]
    told = problem.parts()
    assert "'P'" in told['what "P" points at'] and "'Q'" in told['what "Q" points at']
    assert list(rig.bodies) == ["b", "a"] and rig.bodies["a"].mass is not rig.bodies["b"].mass
