"""A warning stands at the line that a user wrote, however deep its cause is."""

import jax
import pytest

import jaxclear as jc

ARM = jc.Body(1.0, 1e-2)
LONG = jc.integrator.FixedStep(1e-2)


def arm(joint=None):
    pin = jc.Connection(joint or jc.joint.Revolute(), "ground", "arm")
    return jc.Mechanism({"arm": ARM}, {"pin": pin})


def asked(rig, **more):
    variables = {"mass": jc.Variable(lambda rig: rig.bodies["arm"].mass, tolerance=0.1)}
    return jc.Problem(
        rig, lambda run: run.ended, variables, duration=1e-2, integrator=LONG, save=3, **more
    )


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
