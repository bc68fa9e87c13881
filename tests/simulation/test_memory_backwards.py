"""What a derivative in reverse mode keeps: of counted steps what each is handed, within one saving
interval at a time; of others nothing that grows with their number."""

import jax
import pytest

import jaxclear as jc
from jaxclear.multibody.state import lay_out
from jaxclear.multibody.system import prepare

STEP, EVERY, SAVES = 2e-5, 250, 5
# The states that a step more may cost.
STATES = 8
BOUND = 64 * 2**20


def question(integrator, steps, saves):
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.CarvalhoMartins(stiffness=1e9, restitution=0.8), clearance=1e-3
    )
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
    )
    clearance = jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=2e-5)
    height = lambda run: run.body("journal").com[-1, 1]
    return jc.Problem(
        rig, height, {"c": clearance}, duration=steps * STEP, integrator=integrator, save=saves
    )


def kept(integrator, steps, saves):
    """Bytes beside what is given and told, as XLA plans them."""
    asked = question(integrator, steps, saves)
    height = lambda v: asked.evaluate(v, discrete_derivatives=True).responses["response"]
    program = jax.jit(jax.grad(height)).lower(asked.nominal()).compile()
    return program.memory_analysis().temp_size_in_bytes


def counted(every, saves):
    steps = every * (saves - 1)
    return kept(jc.integrator.FixedStep(steps_per_save=every), steps, saves)


@pytest.mark.slow
def test_counted_steps_keep_few_states():
    asked = question(jc.integrator.FixedStep(), 10, 2)
    state = 8 * lay_out(prepare(asked.mechanism)).size
    few = counted(EVERY, SAVES)
    assert counted(2 * EVERY, SAVES) - few <= STATES * state * EVERY
    # Of the intervals that are not being gone through only what they begin with.
    assert counted(EVERY, 2 * SAVES - 1) - few <= STATES * state * (SAVES - 1)
    assert counted(50_000, 21) <= BOUND


@pytest.mark.slow
def test_other_steps_keep_nothing():
    assert kept(jc.integrator.FixedStep(STEP), 1_000_000, 21) <= BOUND / 64
