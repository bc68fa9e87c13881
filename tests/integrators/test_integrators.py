"""Every integrator on one bounce-and-slide: explicit and implicit adaptive solvers and fixed steps
must agree, with the order that each method promises."""

import diffrax
import numpy as np
import optimistix
import pytest

import jaxclear as jc
from jaxclear.simulation.simulate import saving_times
from tests.rigs.falling_journal import touching_journal

SLOW = pytest.mark.slow
NEWTON = optimistix.Newton(rtol=1e-6, atol=1e-8)


def simulate(integrator):
    return jc.simulate(
        touching_journal(), 0.05, save=26, integrator=integrator, state=jc.State(concentric=False)
    )


@pytest.fixture(scope="module")
def reference():
    return simulate(jc.integrator.Adaptive(diffrax.Dopri8(), rtol=1e-11, atol=1e-13))


@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.Adaptive(),
        pytest.param(
            jc.integrator.Adaptive(diffrax.Kvaerno5(root_finder=NEWTON), rtol=1e-6, atol=1e-9),
            marks=pytest.mark.slow,
        ),
        jc.integrator.FixedStep(2e-6),
        pytest.param(jc.integrator.FixedStep(2e-7, "heun"), marks=pytest.mark.slow),
        pytest.param(jc.integrator.FixedStep(steps_per_save=1000), marks=pytest.mark.slow),
    ],
    ids=["Tsit5", "Kvaerno5", "rk4", "heun", "steps per save"],
)
def test_integrators_agree(integrator, reference):
    run = simulate(integrator)
    com = [np.asarray(r.body("journal").com) for r in (run, reference)]
    # Each bounce passes on a share of the error of the one before; a thousandth of the clearance is
    # left room.
    np.testing.assert_allclose(*com, atol=1e-6)
    np.testing.assert_allclose(
        run.worn_volume("B", "bearing")[-1], reference.worn_volume("B", "bearing")[-1], rtol=1e-3
    )


def top():
    """A rod that turns on a ball joint: coordinates are a quaternion, and gyroscopic terms depend
    on the speeds.
    """
    return jc.Mechanism(
        {"rod": jc.Body(1.0, (0.1, 0.2, 0.15), (1.0, 0.1, 0.05))},
        {"pivot": jc.Connection(jc.joint.Spherical(), "ground", "rod")},
        {"gravity": jc.load.Gravity((0.0, -9.81, 0.0))},
        start={"pivot": (0.3, 0.2, 0.1)},
        speeds={"pivot": (0.5, 1.0, 2.0)},
    )


def four_bar():
    """An ideal four-bar that falls: one loop closed by multipliers."""
    revolute = jc.joint.Revolute()
    return jc.Mechanism(
        {name: jc.Body(0.5, 1e-3, (0.1, 0.01)) for name in ("crank", "coupler", "rocker")},
        {
            "O": jc.Connection(revolute, "ground", "crank"),
            "A": jc.Connection(revolute, "crank", "coupler", at=(0.1, 0.0)),
            "B": jc.Connection(revolute, "coupler", "rocker", at=(0.3, 0.0)),
            "D": jc.Connection(revolute, "ground", jc.Marker("rocker", (0.25, 0.0)), at=(0.3, 0.0)),
        },
        {"gravity": jc.load.Gravity()},
        guess={"A": -0.5, "D": 0.3},
    )


SMOOTH = {"top": (top(), 0.5), "four-bar": (four_bar(), 0.1)}
ORDERS = {
    "semi_implicit": (1, 200, lambda step: jc.integrator.FixedStep(step, "semi_implicit")),
    "heun": (2, 100, lambda step: jc.integrator.FixedStep(step, "heun")),
    "rk4": (4, 50, lambda step: jc.integrator.FixedStep(step, "rk4")),
    "implicit": (2, 50, lambda step: jc.integrator.ImplicitStep(step)),
}


@pytest.fixture(scope="module")
def ends():
    """Final states of the smooth motions."""
    fine = jc.integrator.Adaptive(diffrax.Dopri8(), rtol=1e-12, atol=1e-13)
    return {
        name: jc.simulate(rig, duration, save=2, integrator=fine).states[-1]
        for name, (rig, duration) in SMOOTH.items()
    }


@pytest.mark.parametrize(
    ("method", "scene"),
    [
        ("rk4", "top"),
        ("implicit", "four-bar"),
        *(pytest.param(method, "top", marks=SLOW) for method in ORDERS if method != "rk4"),
        pytest.param("semi_implicit", "four-bar", marks=SLOW),
    ],
)
def test_fixed_steps_converge_with_their_order(method, scene, ends):
    """No contact, so nothing but the method makes the error."""
    rig, duration = SMOOTH[scene]
    order, steps, integrator = ORDERS[method]
    go = lambda n: jc.simulate(rig, duration, save=2, integrator=integrator(duration / n))
    errors = [abs(go(n).states[-1] - ends[scene]).max() for n in (steps, 2 * steps)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.15)


def test_symplectic_steps_keep_the_energy_of_a_swing():
    """2000 steps of a tenth of a radian: explicit Euler gains without bound, symplectic Euler sways
    within the step's order.
    """
    rig = jc.Mechanism(
        {"rod": jc.Body(1.0, 0.1, (1.0, 0.0))},
        {"pivot": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"gravity": jc.load.Gravity((9.81, 0.0))},
        start={"pivot": 0.3},
    )
    steps = jc.integrator.FixedStep(0.03, "semi_implicit")
    run = jc.simulate(rig, 60.0, save=2001, integrator=steps)
    assert float(abs(run.states[-200:, 0]).max()) == pytest.approx(0.3, rel=0.1)


def test_a_run_that_ends_early_says_when_and_why():
    # Within one step it is at no update of what wears.
    few = jc.integrator.Adaptive(max_steps=1)
    with pytest.raises(
        jc.SimulationError, match=r"ended early, after 0 s\. The allowed number of steps"
    ) as caught:
        jc.simulate(touching_journal(), 0.05, save=3, integrator=few)
    assert caught.value.trajectory.states.shape[0] == 3
    assert not jc.simulate(touching_journal(), 0.05, save=3, integrator=few, throw=False).succeeded


def test_saving_times_may_be_given():
    np.testing.assert_allclose(saving_times(0.02, [0.005, 0.01]), [0.0, 0.005, 0.01, 0.02])


@pytest.mark.slow
def test_dataset_carries_units_and_names():
    """Each joint's forces have a dimension of contacts, which bears the joint's name where all
    fields lie in one flat data set."""
    run = jc.simulate(touching_journal(), 0.02, save=5, balance=True)
    data, flat = run.to_dataset(), run.to_dataset(flat=True)
    assert data["journal/com"].attrs["units"] == flat["journal.com"].attrs["units"] == "m"
    assert data["B/normal_force"].dims == ("time", "contact")
    assert flat["B.normal_force"].dims == ("time", "B.contact")
    for found, field in ((data, "energy/error"), (flat, "energy.error")):
        assert float(abs(found[field]).max()) < 1e-9
        assert found.attrs["result"].startswith("The run reached")


def test_outcomes_have_sentences_of_their_own_and_unknown_codes_none():
    sentences = [outcome.sentence for outcome in jc.integrator.Outcome]
    assert len(set(sentences)) == len(sentences) and all(s.endswith(".") for s in sentences)
    assert [int(outcome) for outcome in jc.integrator.Outcome] == list(range(len(sentences)))
    with pytest.raises(ValueError):
        jc.integrator.Outcome(-1)


def balance(step):
    integrator = jc.integrator.FixedStep(step, "semi_implicit")
    rig = jc.scenes.slider_crank()
    return jc.simulate(rig, 0.05, save=11, integrator=integrator, balance=True).energy_balance()


@pytest.fixture(scope="module")
def balances():
    return {step: balance(step) for step in (2e-5, 1e-5)}


def test_balance_of_semi_implicit_steps_closes_at_their_order(balances):
    """It was open by 0.0096 J of 0.58 J at 1e-5 s, all of it said to be stored in the contact."""
    errors = {step: float(np.abs(found.error).max()) for step, found in balances.items()}
    start = float(balances[1e-5].kinetic[0])
    assert errors[1e-5] < 1e-3 * start
    assert errors[2e-5] / errors[1e-5] == pytest.approx(2.0, abs=0.4)


def test_an_open_contact_stores_nothing(balances):
    """Spring energy is back when the journal has left its bearing."""
    for step, found in balances.items():
        assert float(np.abs(found.contact_stored).max()) < 1e-3 * float(found.kinetic[0]), step
