"""Monte Carlo and sensitivity on a mechanism whose answer is known: a pendulum's period, and a
spring's static stretch.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxclear as jc

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


def problem(**variables):
    variables = variables or {
        "length": jc.Variable(lambda r: r.bodies["rod"].com[0], jc.distribution.Normal(0.01))
    }
    return jc.Problem(
        pendulum(),
        {"swing": swing},
        variables,
        duration=1.0,
        integrator=jc.integrator.FixedStep(1e-2),
        save=3,
    )


@pytest.fixture(scope="module")
def sample():
    return jc.monte_carlo(problem(), 128)


def small_swing(length):
    return 0.01 * np.cos(np.sqrt(GRAVITY / length))


def test_responses_are_those_of_the_closed_form(sample):
    # The swing of 0.01 rad is not quite small: the period is 6e-6 longer.
    np.testing.assert_allclose(
        sample.responses["swing"], small_swing(sample.values[:, 0]), atol=2e-7
    )


def test_table_and_summary_tell_the_sample(sample):
    columns = ["length", "swing", "result", "warnings", "in doubt"]
    assert list(sample.table().columns) == columns and len(sample.table()) == 128
    row = sample.summary().iloc[0]
    assert row["failed"] == 0 and row["mean"] == pytest.approx(sample.responses["swing"].mean())


@pytest.mark.parametrize(
    ("distribution", "reference"),
    [
        (jc.distribution.Normal(2.0), stats.norm(0, 2)),
        (jc.distribution.Uniform(3.0), stats.uniform(-3, 6)),
        (jc.distribution.TruncatedNormal(1.0, bound=1.5), stats.truncnorm(-1.5, 1.5)),
    ],
)
def test_distributions_are_scipys(distribution, reference):
    shares = np.linspace(0.01, 0.99, 33)
    np.testing.assert_allclose(
        distribution.quantile(jnp.asarray(shares)), reference.ppf(shares), atol=1e-12
    )
    np.testing.assert_allclose(distribution.deviation(), reference.std(), rtol=1e-12)


def test_order_of_variables_does_not_matter():
    """JAX sorts dictionaries; a value must reach the variable it was drawn for."""
    zed = {
        "z first": jc.Variable(lambda r: r.bodies["rod"].com[0], tolerance=0.01),
        "a second": jc.Variable(lambda r: r.loads["gravity"].acceleration[1], tolerance=0.5),
    }
    study = jc.monte_carlo(problem(**zed), 16)
    length, gravity = study.values.T
    np.testing.assert_allclose(
        study.responses["swing"], 0.01 * np.cos(np.sqrt(-gravity / length)), atol=2e-7
    )


def test_all_chunks_share_one_compilation():
    traced = []

    def counted(run):
        traced.append(1)
        return swing(run)

    question = eqx.tree_at(lambda p: p.response["swing"], problem(), counted)
    many = jc.monte_carlo(question, 50, chunk=8)
    assert len(traced) == 1
    np.testing.assert_array_equal(
        many.responses["swing"], jc.monte_carlo(question, 50, chunk=8).responses["swing"]
    )
    assert len(traced) == 1


def test_runs_that_end_early_are_named_and_the_others_are_right():
    """The faster it swings, the more steps it takes: with few allowed, the fast ones fail."""
    wide = jc.Variable(lambda r: r.loads["gravity"].acceleration[1], jc.distribution.Uniform(9.0))
    question = jc.Problem(
        pendulum(),
        {"swing": swing},
        {"gravity": wide},
        duration=1.0,
        integrator=jc.integrator.Adaptive(max_steps=10),
        save=3,
    )
    study = jc.monte_carlo(question, 32)
    gravity, fine = -study.values[:, 0], np.setdiff1d(np.arange(32), study.failed)
    assert 8 <= len(fine) <= 24 and gravity[study.failed].min() > gravity[fine].max()
    np.testing.assert_allclose(
        study.responses["swing"][fine], 0.01 * np.cos(np.sqrt(gravity[fine])), atol=2e-7
    )
    sentences = study.failures()
    assert list(sentences) == list(study.failed)
    assert all("number of steps" in sentence for sentence in sentences.values())


def test_responses_that_are_no_numbers_are_failures_and_the_others_go_on():
    broken = {
        "mass": jc.Variable(lambda r: r.bodies["rod"].mass, jc.distribution.Uniform(1.0 + 1e-9))
    }
    question = jc.Problem(
        pendulum(),
        lambda run: jnp.where(run.mechanism.bodies["rod"].mass > 1.0, jnp.nan, 1.0),
        broken,
        duration=0.1,
        save=3,
    )
    study = jc.monte_carlo(question, 16)
    assert len(study.failed) == np.count_nonzero(study.values[:, 0] > 1.0) > 0
    assert all("mass = " in sentence for sentence in study.failures().values())
    assert np.isfinite(study.responses["response"]).sum() == 16 - len(study.failed)
    assert study.summary()["failed"][0] == len(study.failed)


def test_a_sample_that_cannot_be_assembled_is_counted():
    rig = jc.scenes.four_bar("ideal")
    lengths = {
        "coupler": jc.Variable(
            lambda r: r.connections["B"].parent.at[0], jc.distribution.Uniform(0.35)
        )
    }
    question = jc.Problem(
        rig, lambda run: run.body("follower").com[-1, 0], lengths, duration=0.01, save=2
    )
    study = jc.monte_carlo(question, 16)
    assert 0 < len(study.failed) < 16
    assert all("cannot be assembled" in sentence for sentence in study.failures().values())


def test_three_methods_find_the_derivative_of_the_closed_form(sample):
    answers = jc.sensitivity(
        problem(),
        sample=sample,
        difference_samples=32,
        methods=("regression", "differences", "pathwise"),
    )
    derivative = answers.derivatives["swing", "length"]
    step = 1e-4
    lengths = sample.values[:, 0]
    exact = ((small_swing(lengths + step) - small_swing(lengths - step)) / (2 * step)).mean()
    assert derivative.trustworthy and derivative.value == pytest.approx(exact, rel=0.02)
    for estimate in derivative.estimates.values():
        assert abs(estimate.value - exact) < estimate.error + 0.02 * abs(exact)
    assert "confirmed by" in answers.table()["verdict"].iloc[0]


def test_pathwise_derivatives_of_adaptive_runs_alone_are_no_answer():
    adaptive = eqx.tree_at(lambda p: p.integrator, problem(), jc.integrator.Adaptive())
    answers = jc.sensitivity(adaptive, sample=8, difference_samples=8, methods=("pathwise",))
    derivative = answers.derivatives["swing", "length"]
    assert np.isnan(derivative.value)
    assert "no other method has an answer" in derivative.estimates["pathwise"].refusal


def test_methods_that_disagree_say_so():
    from jaxclear.studies.sensitivity.derivative import Estimate, confirmed

    apart = confirmed(
        "r", "v", {"regression": Estimate(1.0, 0.1), "differences": Estimate(2.0, 0.1)}
    )
    assert not apart.trustworthy and abs(apart.value - 1.5) < 1e-12 and apart.error >= 0.5
    sharp = {"regression": Estimate(1.0, 0.01), "differences": Estimate(2.0, 0.12)}
    sure = confirmed("r", "v", sharp)
    # Near the more certain one, by the squares of the errors, and an interval that holds both.
    assert not sure.trustworthy and abs(sure.value - 1.0) < 0.01
    assert sure.value - sure.error <= 0.99 and sure.value + sure.error >= 2.12 - 1e-12
    assert sure.error < 1.13
    # What the steps of a run leave open is no disagreement.
    steps = {"regression": Estimate(1.0, 1e-13), "differences": Estimate(1.0 + 1e-8, 1e-13)}
    exact = confirmed("r", "v", steps)
    assert exact.trustworthy and 5e-9 < exact.error < 2e-8 and "which agree" in exact.verdict
    vague = confirmed(
        "r", "v", {"regression": Estimate(1.0, 0.1), "pathwise": Estimate(5.0, 100.0)}
    )
    assert not vague.trustworthy and "the error of pathwise is too large" in vague.verdict
    # Paths miss what jumps, and are sure of it; the two that see it agree.
    jumps = {"pathwise": Estimate(1.0, 0.05), "differences": Estimate(8.8, 0.8)}
    seen = confirmed("r", "v", jumps | {"regression": Estimate(8.9, 3.5)})
    assert seen.trustworthy and seen.value == 8.9 and seen.method == "regression"
    nought = confirmed(
        "r", "v", {"regression": Estimate(-1e-3, 1e-2), "differences": Estimate(0.0, 0.0)}
    )
    assert "From regression, confirmed by differences" in nought.verdict
    alone = confirmed(
        "r", "v", {"regression": Estimate(1.0, 0.1), "pathwise": Estimate(np.nan, np.nan, "no")}
    )
    assert "Unconfirmed" in alone.verdict and alone.value == 1.0


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: jc.Variable(lambda r: r), "a distribution or a tolerance"),
        (
            lambda: problem(x=jc.Variable(lambda r: r.bodies["rod"], tolerance=1.0)),
            '"x" must point at numbers',
        ),
        (lambda: jc.monte_carlo(problem(), 0), "number of samples is 0"),
        (
            lambda: jc.monte_carlo(problem(), 4, sampling="grid"),
            'no sampling "grid"; there are "sobol", "random"',
        ),
        (lambda: jc.sensitivity(problem(), "width"), 'no variable "width"'),
        (
            lambda: jc.sensitivity(problem(), "tolerance of length"),
            'no "tolerance of length" in this problem; there is "standard deviation of length"',
        ),
        (lambda: jc.sensitivity(problem(), methods=("magic",)), 'no method "magic" of sensitivity'),
    ],
)
def test_mistakes_get_a_sentence(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call()


def test_samples_outside_a_fields_range_are_failures():
    """A tolerance wider than the number makes some masses negative: those samples must not
    count."""
    wide = {"mass": jc.Variable(lambda r: r.bodies["rod"].mass, jc.distribution.Uniform(1.5))}
    study = jc.monte_carlo(problem(**wide), 32)
    assert len(study.failed) == np.count_nonzero(study.values[:, 0] <= 0) > 0
    assert all("outside its range" in sentence for sentence in study.failures().values())


@pytest.mark.slow
def test_saving_times_of_a_problem_may_be_given():
    question = jc.Problem(
        pendulum(),
        swing,
        {},
        duration=1.0,
        save=[0.25, 0.5],
        integrator=jc.integrator.FixedStep(1e-2),
    )
    np.testing.assert_allclose(question.shares * question.duration, [0.0, 0.25, 0.5, 1.0])
    assert jnp.isfinite(question.evaluate(jnp.zeros(0)).responses["response"])


def test_derivatives_have_units(sample):
    answers = jc.sensitivity(problem(), sample=sample, difference_samples=8)
    assert answers.unit("swing", "length") == "1/m"


def test_one_number_under_two_variables_is_refused():
    length = lambda rig: rig.bodies["rod"].com[0]
    with pytest.raises(ValueError, match='"first" and "second" point at the same number'):
        problem(
            first=jc.Variable(length, tolerance=1e-3), second=jc.Variable(length, tolerance=1e-3)
        )


@pytest.mark.parametrize(
    ("other", "difference"),
    [
        (lambda p: eqx.tree_at(lambda p: p.duration, p, 2.0), "duration is 1.0 there, 2.0 here"),
        (
            lambda p: eqx.tree_at(lambda p: p.integrator.step, p, 5e-3),
            "step is 0.01 there, 0.005 here",
        ),
        (
            lambda p: eqx.tree_at(lambda p: p.integrator, p, jc.integrator.ImplicitStep(1e-2)),
            "integrator is FixedStep there, ImplicitStep here",
        ),
        (
            lambda p: eqx.tree_at(lambda p: p.mechanism.bodies["rod"].mass, p, jnp.asarray(2.0)),
            r'mechanism.bodies\["rod"\].mass is 1.0 there, 2.0 here',
        ),
        (
            lambda p: problem(width=p.variables["length"]),
            'its variables are "length", not "width"',
        ),
        (
            lambda p: problem(length=jc.Variable(lambda r: r.bodies["rod"].com[0], tolerance=0.1)),
            'distribution of "length" is Normal there, TruncatedNormal here',
        ),
        (
            lambda p: problem(
                length=jc.Variable(lambda r: r.bodies["rod"].mass, jc.distribution.Normal(0.01))
            ),
            "points at",
        ),
        (
            lambda p: eqx.tree_at(lambda p: p.response["swing"], p, lambda run: run.states[-1, 0]),
            r'response\["swing"\] is another function',
        ),
    ],
)
def test_a_sample_of_another_problem_is_refused(sample, other, difference):
    with pytest.raises(ValueError, match=f"sample is of another problem.*({difference})"):
        jc.sensitivity(other(problem()), sample=sample, difference_samples=8)


def test_a_sample_of_the_same_problem_built_anew_is_taken(sample):
    assert sample.problem is not problem()
    answers = jc.sensitivity(problem(), sample=sample, methods=("regression",))
    assert np.isfinite(answers.derivatives["swing", "length"].value)
