"""Monte Carlo and sensitivity on a mechanism whose answer is known: a pendulum's period."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.studies.sensitivity.derivative import Estimate, confirmed
from tests.rigs.refusals import refusals

LENGTH, GRAVITY = 1.0, 9.81


def pendulum():
    return jc.Mechanism(
        {"rod": jc.Body(1.0, 1e-9, (LENGTH, 0.0))},
        {"pivot": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
        start={"pivot": -np.pi / 2 + 0.01},
    )


def swing(run):
    """Angle after the run: A cos(omega t) for a small swing."""
    return run.coordinate("pivot")[-1] + jnp.pi / 2


LENGTH_OF = lambda rig: rig.bodies["rod"].com[0]
MASS_OF = lambda rig: rig.bodies["rod"].mass
GRAVITY_OF = lambda rig: rig.loads["gravity"].acceleration[1]
Uniform = jc.distribution.Uniform
STEPS = jc.integrator.FixedStep(1e-2)


def problem(response=None, save=3, integrator=STEPS, duration=1.0, **variables):
    variables = variables or {"length": jc.Variable(LENGTH_OF, jc.distribution.Normal(0.01))}
    how = {"duration": duration, "integrator": integrator, "save": save}
    return jc.Problem(pendulum(), response or {"swing": swing}, variables, **how)


@pytest.fixture(scope="module")
def sample():
    return jc.monte_carlo(problem(), 128)


def small_swing(length):
    return 0.01 * np.cos(np.sqrt(GRAVITY / length))


def test_responses_are_those_of_the_closed_form(sample):
    # The swing of 0.01 rad is not quite small: the period is 6e-6 longer.
    swings = small_swing(sample.values[:, 0])
    np.testing.assert_allclose(sample.responses["swing"], swings, atol=2e-7)


def test_table_and_summary_tell_the_sample(sample):
    columns = ["length", "swing", "result", "warnings", "in doubt"]
    assert list(sample.table().columns) == columns and len(sample.table()) == 128
    row = sample.summary().iloc[0]
    assert row["failed"] == 0 and row["mean"] == pytest.approx(sample.responses["swing"].mean())


def test_order_of_variables_does_not_matter():
    """JAX sorts dictionaries; a value must reach the variable it was drawn for."""
    varied = {"z first": jc.Variable(LENGTH_OF, tolerance=0.01)}
    varied |= {"a second": jc.Variable(GRAVITY_OF, tolerance=0.5)}
    study = jc.monte_carlo(problem(**varied), 16)
    length, gravity = study.values.T
    swings = 0.01 * np.cos(np.sqrt(-gravity / length))
    np.testing.assert_allclose(study.responses["swing"], swings, atol=2e-7)


def test_all_chunks_share_one_compilation():
    traced = []

    def counted(run):
        traced.append(1)
        return swing(run)

    question = eqx.tree_at(lambda p: p.response["swing"], problem(), counted)
    first, again = (jc.monte_carlo(question, 50, chunk=8).responses["swing"] for _ in range(2))
    assert len(traced) == 1
    np.testing.assert_array_equal(first, again)


def test_runs_that_end_early_are_named_and_the_others_are_right():
    """The faster it swings, the more steps it takes: with few allowed, the fast ones fail."""
    few = jc.integrator.Adaptive(max_steps=10)
    study = jc.monte_carlo(
        problem(integrator=few, gravity=jc.Variable(GRAVITY_OF, Uniform(9.0))), 32
    )
    gravity, fine = -study.values[:, 0], np.setdiff1d(np.arange(32), study.failed)
    assert 8 <= len(fine) <= 24 and gravity[study.failed].min() > gravity[fine].max()
    swings = 0.01 * np.cos(np.sqrt(gravity[fine]))
    np.testing.assert_allclose(study.responses["swing"][fine], swings, atol=2e-7)
    sentences = study.failures()
    assert list(sentences) == list(study.failed)
    assert all("number of steps" in sentence for sentence in sentences.values())


def test_responses_that_are_no_numbers_are_failures_and_the_others_go_on():
    """So are samples outside a field's range: a tolerance wider than the number makes some masses
    negative."""
    broken = lambda run: jnp.where(MASS_OF(run.mechanism) > 1.0, jnp.nan, 1.0)
    question = problem(broken, mass=jc.Variable(MASS_OF, Uniform(1.5)))
    study = jc.monte_carlo(question, 32)
    masses, sentences = study.values[:, 0], study.failures()
    assert list(study.failed) == list(np.flatnonzero((masses > 1.0) | (masses <= 0)))
    assert np.any(masses > 1.0) and np.any(masses <= 0)
    for i, sentence in sentences.items():
        assert "mass = " in sentence
        assert ("outside its range" in sentence) == (masses[i] <= 0)
    assert np.isfinite(study.responses["response"]).sum() == 32 - len(study.failed)
    assert study.summary()["failed"][0] == len(study.failed)


def test_a_sample_that_cannot_be_assembled_is_counted():
    coupler = jc.Variable(lambda r: r.connections["B"].parent.at[0], Uniform(0.35))
    end = lambda run: run.body("follower").com[-1, 0]
    rig = jc.scenes.four_bar("ideal")
    study = jc.monte_carlo(jc.Problem(rig, end, {"coupler": coupler}, duration=0.01, save=2), 16)
    assert 0 < len(study.failed) < 16
    assert all("cannot be assembled" in sentence for sentence in study.failures().values())


def test_three_methods_find_the_derivative_of_the_closed_form(sample):
    """Of a sample of the same problem, built anew."""
    assert sample.problem is not problem()
    methods = ("regression", "differences", "pathwise")
    answers = jc.sensitivity(problem(), sample=sample, difference_samples=32, methods=methods)
    derivative = answers.derivatives["swing", "length"]
    step, lengths = 1e-4, sample.values[:, 0]
    exact = ((small_swing(lengths + step) - small_swing(lengths - step)) / (2 * step)).mean()
    assert derivative.trustworthy and derivative.value == pytest.approx(exact, rel=0.02)
    for estimate in derivative.estimates.values():
        assert abs(estimate.value - exact) < estimate.error + 0.02 * abs(exact)
    assert "confirmed by" in answers.table()["verdict"].iloc[0]
    assert answers.unit("swing", "length") == "1/m"


def test_pathwise_derivatives_of_adaptive_runs_alone_are_no_answer():
    adaptive = eqx.tree_at(lambda p: p.integrator, problem(), jc.integrator.Adaptive())
    answers = jc.sensitivity(adaptive, sample=8, difference_samples=8, methods=("pathwise",))
    derivative = answers.derivatives["swing", "length"]
    assert np.isnan(derivative.value)
    assert "no other method has an answer" in derivative.estimates["pathwise"].refusal


def test_methods_that_disagree_say_so():
    told = lambda **estimates: confirmed(
        "r", "v", {name: Estimate(*own) for name, own in estimates.items()}
    )
    apart = told(regression=(1.0, 0.1), differences=(2.0, 0.1))
    assert not apart.trustworthy and abs(apart.value - 1.5) < 1e-12 and apart.error >= 0.5
    sure = told(regression=(1.0, 0.01), differences=(2.0, 0.12))
    # Near the more certain one, by the squares of the errors, and an interval that holds both.
    assert not sure.trustworthy and abs(sure.value - 1.0) < 0.01
    assert sure.value - sure.error <= 0.99 and sure.value + sure.error >= 2.12 - 1e-12
    assert sure.error < 1.13
    # What the steps of a run leave open is no disagreement.
    exact = told(regression=(1.0, 1e-13), differences=(1.0 + 1e-8, 1e-13))
    assert exact.trustworthy and 5e-9 < exact.error < 2e-8 and "which agree" in exact.verdict
    vague = told(regression=(1.0, 0.1), pathwise=(5.0, 100.0))
    assert not vague.trustworthy and "the error of pathwise is too large" in vague.verdict
    # Paths miss what jumps, and are sure of it; the two that see it agree.
    seen = told(pathwise=(1.0, 0.05), differences=(8.8, 0.8), regression=(8.9, 3.5))
    assert seen.trustworthy and seen.value == 8.9 and seen.method == "regression"
    nought = told(regression=(-1e-3, 1e-2), differences=(0.0, 0.0))
    assert "From regression, confirmed by differences" in nought.verdict
    alone = told(regression=(1.0, 0.1), pathwise=(np.nan, np.nan, "no"))
    assert "Unconfirmed" in alone.verdict and alone.value == 1.0


test_mistakes_get_a_sentence = refusals(
    {
        "a distribution or a tolerance": lambda: jc.Variable(lambda r: r),
        '"x" must point at numbers': lambda: problem(
            x=jc.Variable(lambda r: r.bodies["rod"], tolerance=1.0)
        ),
        "number of samples is 0": lambda: jc.monte_carlo(problem(), 0),
        'no sampling "grid"; there are "sobol", "random"': lambda: jc.monte_carlo(
            problem(), 4, sampling="grid"
        ),
        'no variable "width"': lambda: jc.sensitivity(problem(), "width"),
        'no "tolerance of length" in .*; there is "standard deviation of l': lambda: jc.sensitivity(
            problem(), "tolerance of length"
        ),
        '"first" and "second" point at the same number': lambda: problem(
            first=jc.Variable(LENGTH_OF, tolerance=1e-3),
            second=jc.Variable(LENGTH_OF, tolerance=1e-3),
        ),
        'no method "magic" of sensitivity': lambda: jc.sensitivity(problem(), methods=("magic",)),
    }
)


@pytest.mark.slow
def test_saving_times_of_a_problem_may_be_given():
    question = jc.Problem(pendulum(), swing, {}, duration=1.0, save=[0.25, 0.5], integrator=STEPS)
    np.testing.assert_allclose(question.shares * question.duration, [0.0, 0.25, 0.5, 1.0])
    assert jnp.isfinite(question.evaluate(jnp.zeros(0)).responses["response"])


with_other = eqx.tree_at
LENGTH_WIDE, LENGTH_MASS = (
    jc.Variable(LENGTH_OF, tolerance=0.1),
    jc.Variable(MASS_OF, jc.distribution.Normal(0.01)),
)
OTHERS = {
    "duration is 1.0 there, 2.0 here": lambda p: with_other(lambda p: p.duration, p, 2.0),
    "step is 0.01 there, 0.005 here": lambda p: with_other(lambda p: p.integrator.step, p, 5e-3),
    "integrator is FixedStep there, ImplicitStep here": lambda p: with_other(
        lambda p: p.integrator, p, jc.integrator.ImplicitStep(1e-2)
    ),
    r'mechanism.bodies\["rod"\].mass is 1.0 there, 2.0 here': lambda p: with_other(
        lambda p: MASS_OF(p.mechanism), p, jnp.asarray(2.0)
    ),
    'its variables are "length", not "width"': lambda p: problem(width=p.variables["length"]),
    'distribution of "length" is Normal there, TruncatedNormal here': lambda p: problem(
        length=LENGTH_WIDE
    ),
    "points at": lambda p: problem(length=LENGTH_MASS),
    r'response\["swing"\] is another function': lambda p: with_other(
        lambda p: p.response["swing"], p, lambda run: run.states[-1, 0]
    ),
}


@pytest.mark.parametrize("difference", OTHERS)
def test_a_sample_of_another_problem_is_refused(sample, difference):
    other = OTHERS[difference](problem())
    with pytest.raises(ValueError, match=f"sample is of another problem.*({difference})"):
        jc.sensitivity(other, sample=sample, difference_samples=8)
