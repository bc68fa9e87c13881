"""Contact laws that see the radii as worn: against the law's own closed form with these radii."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.wear_map import Wearing
from jaxclear.ground.pose import REST
from jaxclear.laws.stiffness import HERTZ_SPHERE
from jaxclear.multibody import contact_point
from jaxclear.multibody.loops import Relative
from jaxclear.multibody.system import prepare, readings

MODULUS, RADIUS, CLEARANCE, WORN, SUNK = 1e11, 15e-3, 0.5e-3, 0.3e-3, 5e-6
STEEL = jc.material.Material(210e9, 0.3)


def ball(follows):
    wearing = Wearing(jc.wear.Archard(), (12, 12), worn_radius=follows)
    law = jc.contact.ModifiedFlores(modulus=MODULUS, restitution=0.9)
    return jc.clearance.BallSocket(
        law, socket_radius=RADIUS, clearance=CLEARANCE, socket_wear=wearing
    )


def journal(bearing, shaft):
    law = jc.contact.HuntCrossley(
        stiffness=jc.stiffness.HertzStiffness(STEEL, STEEL), restitution=0.9
    )
    wear = lambda follows: Wearing(jc.wear.Archard(), (12, 2), worn_radius=follows)
    return jc.clearance.JournalBearing(
        law,
        bearing_radius=RADIUS,
        clearance=CLEARANCE,
        bearing_wear=wear(bearing),
        journal_wear=wear(shaft),
    )


def rig(joint, load=0.0):
    return jc.Mechanism(
        {"ball": jc.Body(1.0, (1e-3, 1e-3, 1e-3))},
        {"S": jc.Connection(joint, "ground", "ball")},
        {"load": jc.load.Force(jc.Marker("ball"), (load, 0.0, 0.0))},
    )


def forces(joint, depths, along):
    """Normal force [N] of each contact of a joint at rest, its surfaces worn evenly, its inner part
    so far along x [m]."""
    system = prepare(rig(joint))
    maps = {name: jnp.full(m.cells, depths[name]) for name, (m, _) in joint.maps().items()}
    read = readings(system, {"S": maps})["S"]
    laws = system.bearings["S"].contact_laws
    still = Relative(REST._replace(translation=(along, 0.0, 0.0)), (0.0,) * 3, (0.0,) * 3)
    memory = tuple(contact_point.PointState(0.1, ()) for _ in laws)
    found = contact_point.evaluate(joint, laws, still, memory, read)
    return np.array([float(point.normal_force) for point in found.points])


def closed_form(radius, clearance):
    """`BallInSocket` at the indentation SUNK."""
    return HERTZ_SPHERE * MODULUS * radius * SUNK**1.5 / np.sqrt(clearance + SUNK)


def test_a_ball_presses_as_the_worn_radius_says():
    along = CLEARANCE + WORN + SUNK
    for follows, worn in ((True, WORN), (False, 0.0)):
        found = forces(ball(follows), {"socket": WORN}, along)
        np.testing.assert_allclose(found, closed_form(RADIUS + worn, CLEARANCE + worn), rtol=1e-9)


@pytest.mark.parametrize("bearing, shaft", [(True, True), (True, False), (False, True)])
def test_a_journal_presses_as_the_worn_radii_of_both_say(bearing, shaft):
    depths = {"bearing": WORN, "journal": 0.5 * WORN}
    outer, inner = RADIUS + bearing * WORN, RADIUS - CLEARANCE - shaft * 0.5 * WORN
    stiff = jc.stiffness.HertzStiffness(STEEL, STEEL)
    expected = stiff.value(jc.stiffness.Shape(inner, outer, None)) * SUNK**1.5
    found = forces(journal(bearing, shaft), depths, CLEARANCE + 1.5 * WORN + SUNK)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_without_the_option_laws_are_fitted_once_and_nothing_is_kept_of_them():
    for joint in (ball(False), journal(False, False)):
        laws = prepare(rig(joint)).bearings["S"].contact_laws
        assert all(own.unfitted is None for own in laws)


INTEGRATORS = {
    "ImplicitStep": jc.integrator.ImplicitStep(1e-6),
    "FixedStep": jc.integrator.FixedStep(1e-6),
    "Adaptive": jc.integrator.Adaptive(),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_ball_rests_where_the_worn_radius_carries_its_load(name):
    """Seated on the worn surface it lies as deep as the closed form says, and stays there."""
    load, worn = (
        closed_form(RADIUS + WORN, CLEARANCE + WORN),
        {"S": {"socket": np.full((12, 12), WORN)}},
    )
    mechanism = rig(ball(True), load)
    state = jc.resting_state(mechanism, worn)
    run = jc.simulate(mechanism, 2e-4, save=21, integrator=INTEGRATORS[name], state=state)
    depth = np.asarray(run.contact("S").indentation).ravel()
    np.testing.assert_allclose(depth, SUNK, rtol=1e-4)
    # By the law as made the same place is none to rest at.
    other = jc.simulate(
        rig(ball(False), load), 2e-4, save=21, integrator=INTEGRATORS[name], state=state
    )
    assert np.abs(np.asarray(other.contact("S").indentation) / SUNK - 1).max() > 0.01


@pytest.mark.parametrize(
    "stiffness",
    [1e9, jc.stiffness.CombinedModulus(STEEL, STEEL), jc.stiffness.LengthOf()],
    ids=["number", "of the materials", "of the length"],
)
def test_a_law_that_nothing_fits_to_the_worn_radius_is_refused(stiffness):
    wearing = Wearing(jc.wear.Archard(), (12, 2), worn_radius=True)
    law = jc.contact.HuntCrossley(stiffness=stiffness, restitution=0.9)
    joint = jc.clearance.JournalBearing(
        law, bearing_radius=RADIUS, clearance=CLEARANCE, bearing_wear=wearing
    )
    with pytest.raises(ValueError, match='joint "S": the wear of its bearing .*HertzStiffness'):
        rig(joint)


@pytest.mark.parametrize("name", ["PlainBearing", "Slideway", "BallJoint"])
def test_an_ideal_joint_has_no_worn_radius(name):
    kind = getattr(jc.joint, name)
    sizes = {"PlainBearing": ["length"], "Slideway": ["length", "width"], "BallJoint": []}[name]
    make = lambda follows: kind(
        wear=Wearing(jc.wear.Archard(), worn_radius=follows), **dict.fromkeys(sizes, 0.1)
    )
    make(False)
    with pytest.raises(ValueError, match=f"the wear of a {name} has worn_radius=True"):
        make(True)


@pytest.mark.slow
def test_peaks_of_a_ball_are_those_of_the_law_as_worn():
    """A ball at rest whose load grows by a thirtieth: by the law as made it would press a third
    harder."""
    worn = {"S": {"socket": np.full((12, 12), CLEARANCE)}}
    state = jc.resting_state(rig(ball(True), 600.0), worn)
    run = jc.simulate(
        rig(ball(True), 620.0),
        2e-4,
        save=201,
        integrator=jc.integrator.FixedStep(1e-6),
        state=state,
    )
    largest = float(run.contact("S").normal_force.max())
    assert largest > 600
    assert float(jc.response.PeakContactForce("S")(run)) == pytest.approx(largest, rel=1e-9)
