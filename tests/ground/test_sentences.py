"""What `print` shows of a law, a joint, an integrator, a question: its numbers with their units; a
warning at the line that a user wrote; a nan that hands on its reason."""

from abc import abstractmethod

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.ground.argument_errors import _describe_incomplete
from jaxclear.ground.outcome import Unknown
from jaxclear.ground.quantity import AbstractQuantified
from jaxclear.native import by_columns, while_loop

STEEL = jc.Material(young_modulus=207e9, poisson_ratio=0.3)
RIG = jc.scenes.slider_crank("ideal")
LENGTH = jc.Variable(lambda rig: rig.connections["B"].parent.at[0], tolerance=3e-5)
SHOWN = {
    "friction.Ambrosio mu_kinetic 0.03, inner_speed 0.0001 m/s, outer_speed 0.001 m/s": (
        jc.friction.Ambrosio(mu_kinetic=0.03)
    ),
    "wear.Archard wear_coefficient 1e-05, hardness 2e+09 Pa": jc.wear.Archard(),
    "Material young_modulus 2.07e+11 Pa, poisson_ratio 0.3": STEEL,
    "integrator.FixedStep step 1e-05 s, method rk4": jc.integrator.FixedStep(1e-5),
    "joint.Revolute drive ConstantSpeed(speed 50 rad/s, start 0 rad)": jc.joint.Revolute(
        drive=jc.drive.ConstantSpeed(50.0)
    ),
    "Body mass 0.3 kg, inertia 0.0001 kg m^2, com (0.025, 0) m": jc.Body(0.3, 1e-4, (0.025, 0)),
    "load.JointTorque connection O, value the function exp N m": jc.load.JointTorque("O", jnp.exp),
    "State: the mechanism's own start, only ideal loops closed.": jc.State(concentric=False),
    "State: the mechanism's own start, journals in the middle; bearing of B worn by 2e-06 m at the "
    "most.": jc.State({"B": {"bearing": jnp.array([0.0, 2e-6])}}),
    "Scene: a rig\n  bodies crank, rod, slider\n  connections O, A, B, G\n  loads gravity\n"
    "  duration 0.2 s\n  integrator integrator.Adaptive solver Tsit5, rtol 1e-07, atol 1e-09, "
    "max_steps 200000": jc.Scene(RIG, 0.2, jc.integrator.Adaptive(), description="a rig"),
    "Problem over 0.2 s, 11 saved instants, by integrator.FixedStep step 0.001 s, method rk4\n"
    "responses\n  response [m]\nvariables\n  length 0.12 m, "
    "TruncatedNormal(standard_deviation 1e-05, bound 3e-05)": jc.Problem(
        RIG,
        jc.response.FinalCoordinate("G"),
        {"length": LENGTH},
        duration=0.2,
        save=11,
        integrator=jc.integrator.FixedStep(1e-3),
    ),
}


class Printer:
    """What IPython hands to an object that shows itself."""

    def text(self, shown):
        self.shown = shown


@pytest.mark.parametrize("words", SHOWN)
def test_numbers_are_shown_with_their_units(words):
    printer = Printer()
    assert str(SHOWN[words]) == words
    SHOWN[words]._repr_pretty_(printer, False)
    assert printer.shown == words


def test_what_is_long_has_a_line_for_each_part():
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.LankaraniNikravesh(stiffness=1e9, restitution=0.9),
        friction=jc.friction.Ambrosio(mu_kinetic=0.03),
        clearance=0.2e-3,
    )
    first, contact, friction = str(bearing).splitlines()
    assert first.startswith("clearance.PlanarJournalBearing bearing_radius ")
    assert "clearance 0.0002 m" in first
    assert "stiffness 1e+09 N/m^1.5" in contact and "restitution 0.9" in contact
    assert friction.strip().startswith("friction Ambrosio(mu_kinetic 0.03, ")


ARM = jc.Body(1.0, 1e-2)
LONG = jc.integrator.FixedStep(1e-2)


def arm(joint=None):
    pin = jc.Connection(joint or jc.joint.Revolute(), "ground", "arm")
    return jc.Mechanism({"arm": ARM}, {"pin": pin})


def asked(rig, **more):
    variables = {"mass": jc.Variable(lambda rig: rig.bodies["arm"].mass, tolerance=0.1)}
    how = {"duration": 1e-2, "integrator": LONG, "save": 3} | more
    return jc.Problem(rig, lambda run: run.ended, variables, **how)


CAUSES = {
    "a run": lambda: jc.simulate(arm(), 1e-2, save=3, integrator=LONG),
    "a problem": lambda: asked(arm()),
    "a problem by other steps": lambda: asked(arm()).with_integrator(jc.integrator.FixedStep(9e-3)),
    "a law, mapped": lambda: jax.vmap(lambda _: jc.contact.Flores(restitution=0.3).restitution)(
        jax.numpy.zeros(2)
    ),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_a_warning_stands_at_the_users_line(cause):
    with pytest.warns() as said:
        CAUSES[cause]()
    assert {each.filename for each in said} == {__file__}


@jax.custom_jvp
def lost(x):
    return x


lost.defjvp(lambda numbers, ways: (numbers[0], Unknown.GROWN.number * ways[0]))


def answer(x):
    """Of what is lost on the way, in a kernel."""
    turn = lambda carry: (carry[0] + 1, 1.5 * carry[1])
    end = while_loop(lambda carry: carry[0] < 5, turn, (jnp.zeros((), int), lost(x)))[1]
    return jnp.sum(jnp.stack([jnp.sin(end), x]) @ jnp.ones((2, 3)))


@pytest.mark.parametrize("way", [jax.jacfwd, jax.grad])
def test_a_reason_is_handed_on(way):
    found = jax.jit(way(lambda x: by_columns(answer, x)))(1.0)
    sentence = Unknown.GROWN.sentence
    assert jc.explain_nan({"slope": found}) == sentence[0].upper() + sentence[1:]


def test_each_reason_is_said_once_and_only_of_its_nan():
    both = [each.number for each in (Unknown.PARTED, Unknown.GROWN, Unknown.PARTED)]
    assert jc.explain_nan(np.array(both)).count("take") == 2
    assert jc.explain_nan([1.0, np.arange(3), np.inf]) == ""
    for nan in (np.nan, -np.nan):
        assert jc.explain_nan(np.array([1.0, nan])).startswith("It is not a number")


def test_a_class_that_lacks_parts_of_its_family_says_which():
    class AbstractStamp(AbstractQuantified):
        @abstractmethod
        def press(self):
            pass

    class Empty(AbstractStamp):
        pass

    with pytest.raises(
        TypeError, match='^Empty leaves "press" of .*AbstractStamp undefined: define'
    ):
        Empty()
    # Of a family of the package, with the attributes that it asks for.
    sentence = _describe_incomplete(jc.friction.AbstractSlipFriction)
    assert '"coefficient" of friction.AbstractForceFriction undefined' in sentence
