"""What `print` and a notebook show of a law, a joint, an integrator, a question: its numbers with
their units, where there were hundreds of characters of `f64[]`."""

import jax.numpy as jnp
import pytest

import jaxclear as jc

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
    "most_steps 200000": jc.Scene(RIG, 0.2, jc.integrator.Adaptive(), description="a rig"),
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
    assert "stiffness 1e+09 N/m^exponent" in contact and "restitution 0.9" in contact
    assert friction.strip().startswith("friction Ambrosio(mu_kinetic 0.03, ")
