"""How deep a reader of a traceback is below `simulate` where a step asks a contact law."""

import traceback
from pathlib import Path

import equinox as eqx

import jaxclear as jc

PACKAGE = Path(jc.__file__).parent


class Witness(jc.contact.AbstractContactLaw):
    """A linear spring that notes through which functions of the package it was reached."""

    frames: list = eqx.field(static=True)
    remembers_impact_speed, restitution = False, 1.0

    def normal_force(self, indentation, rate, impact_speed):
        stack = traceback.extract_stack()[:-1]
        self.frames.append(
            [f"{f.filename}:{f.name}" for f in stack if f.filename.startswith(f"{PACKAGE}/")]
        )
        return self.elastic_force(indentation)

    def elastic_force(self, indentation):
        return 1e6 * (indentation + abs(indentation)) / 2


def test_from_simulate_to_the_law_in_a_step_are_few_functions_of_the_package():
    """Counted where the law is reached while a step of a slider-crank is traced; native's are
    among them."""
    reached = []
    rig = jc.scenes.slider_crank(contact=Witness(frames=reached))
    jc.simulate(rig, 1e-3, save=2, integrator=jc.integrator.FixedStep(1e-4), verify=False)
    in_steps = [way for way in reached if any("/integrators/" in frame for frame in way)]
    shortest = min(in_steps, key=len)
    start = [frame.endswith("simulate.py:simulate") for frame in shortest].index(True)
    assert len(shortest[start:]) <= 18, shortest
