"""Replicas tell how far a study's numbers are off by its steps."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import jaxclear as jc
from jaxclear.ground.printing import with_error
from jaxclear.plot.canvas import as_warnings
from jaxclear.plot.studies import _warned_samples
from jaxclear.studies.experiment import Cost, Description, ResponseInfo, SampleResult
from jaxclear.studies.replicas import MOST_REPLICAS
from jaxclear.studies.store import workers
from jaxclear.studies.store.batch import evaluate_chunk
from jaxclear.studies.store.store import CHUNKS
from tests.rigs.cells import slow
from tests.rigs.loaded_bearing import loaded_bearing

GRAVITY, DURATION, STEP = 9.81, 0.5, 5e-3
# One program serves all that are run in chunks of this size.
CHUNK = 64
MOST_WORDS = 25


def falling(**how):
    """A mass on a slide that falls from rest, its gravity varying; by symplectic Euler steps of
    h its way after n of them is g h^2 n (n + 1) / 2: too long by g h T / 2."""
    slide = jc.Mechanism(
        {"mass": jc.Body(1.0, 1e-3)},
        {"slide": jc.Connection(jc.joint.Prismatic(), "ground", "mass", axis="x")},
        {"gravity": jc.load.Gravity((GRAVITY, 0.0))},
    )
    varied = jc.Variable(lambda r: r.loads["gravity"].acceleration[0], tolerance=0.5)
    asked = {
        "way": jc.response.FinalCoordinate("slide"),
        "saves": lambda run: jnp.asarray(float(len(run.time))),
    }
    how = {"integrator": jc.integrator.FixedStep(STEP, "semi_implicit"), "save": 6} | how
    return jc.Problem(slide, asked, {"gravity": varied}, duration=DURATION, **how)


@pytest.fixture(scope="module")
def study():
    return jc.monte_carlo(falling(), 256, chunk=CHUNK)


def test_experiments_beside_a_study_share_its_mechanism():
    """They were copies, of all its numbers at each question: a third of what a study cost beside
    its samples."""
    experiment = falling().experiment
    idle, finer = experiment.cost().idle, experiment.refine()
    assert idle.mechanism is experiment.mechanism is finer.mechanism
    assert float(idle.duration) == 0.0 and float(experiment.duration) == DURATION
    assert float(finer.integrator.step) == pytest.approx(STEP / 2)


def bias_of_euler(gravity, step=STEP):
    return np.asarray(gravity) * step * DURATION / 2


def test_the_bias_of_euler_steps_is_that_of_the_closed_form(study):
    """Of order 1 what is told of each sample is its error; of the mean that of the first 16."""
    gravity = study.values[:, 0]
    exact = gravity * DURATION**2 / 2 + bias_of_euler(gravity)
    np.testing.assert_allclose(study.responses["way"], exact, rtol=1e-9)
    first = bias_of_euler(gravity[:MOST_REPLICAS])
    np.testing.assert_allclose(study.replicas.errors("way"), first, rtol=1e-8)
    told = study.numerical_error("way")
    assert told.replicas == MOST_REPLICAS
    assert told.bias == pytest.approx(first.mean(), rel=1e-8)
    student = scipy.stats.t.ppf(0.975, 15) * first.std(ddof=1) / 4
    assert told.uncertainty == pytest.approx(student, rel=1e-6)
    # The mean over all samples lies within, and one interval holds what is exact.
    assert abs(told.bias - bias_of_euler(gravity).mean()) < told.uncertainty
    assert told.is_resolved and told.whole == told.sampling + abs(told.bias) + told.uncertainty
    assert abs(study.mean("way").value - GRAVITY * DURATION**2 / 2) < told.whole
    # Of a deviation: as much too large, in proportion.
    spread = study.numerical_error("way", lambda own: own.std(ddof=1))
    assert spread.bias == pytest.approx(STEP / DURATION * gravity[:16].std(ddof=1) / 8, rel=1e-6)


@pytest.mark.parametrize("share", [0.5, *slow(0.25)])
def test_a_replica_has_that_share_of_the_steps_that_were_taken(share):
    """Saving times 0.1 s apart shorten steps of 0.03 s to 0.025 s."""
    problem = falling(integrator=jc.integrator.FixedStep(0.03, "semi_implicit"))
    replica = problem.refine(share)
    assert float(replica.integrator.step) == pytest.approx(share * 0.025)
    at = jnp.tile(problem.nominal(), (CHUNK, 1))
    own, finer = (evaluate_chunk(each, at).responses["way"][0] for each in (problem, replica))
    assert (own - finer) / (1 - share) == pytest.approx(bias_of_euler(GRAVITY, 0.025), rel=1e-6)


@pytest.mark.parametrize(
    "integrator",
    [
        *slow(
            jc.integrator.FixedStep(STEP, "semi_implicit"),
            jc.integrator.FixedStep(STEP, "heun"),
            jc.integrator.FixedStep(5 * STEP),
        ),
        jc.integrator.ImplicitStep(STEP),
        jc.integrator.FixedStep(steps_per_save=10, method="semi_implicit"),
        *slow(jc.integrator.Adaptive(rtol=1e-5, atol=1e-7)),
    ],
    ids=["semi_implicit", "heun", "rk4", "implicit", "counted", "adaptive"],
)
def test_told_errors_are_true_ones_of_a_wide_swing(integrator):
    """A pendulum from 1 rad below the level, beside DOP853 at a tolerance of 1e-12."""
    rig = jc.Mechanism(
        {"rod": jc.Body(1.0, 1e-9, (1.0, 0.0))},
        {"pivot": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
        start={"pivot": -1.0},
    )
    length = {"length": jc.Variable(lambda r: r.bodies["rod"].com[0], tolerance=0.05)}
    angle = jc.response.FinalCoordinate("pivot")
    asked = jc.Problem(rig, angle, length, duration=1.0, save=11, integrator=integrator)
    found = jc.monte_carlo(asked, 8)

    def exact(length):
        inertia = length**2 + 1e-9
        fall = lambda t, y: (y[1], -GRAVITY * length * np.cos(y[0]) / inertia)
        tight = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-12}
        return scipy.integrate.solve_ivp(fall, (0.0, 1.0), (-1.0, 0.0), **tight).y[0, -1]

    true = np.abs(found.responses["response"] - [exact(own) for own in found.values[:, 0]])
    share = found.replicas.errors("response") / true
    assert np.all((share > 0.5) & (share < 10))


@pytest.mark.parametrize("how", [{"step": STEP}, {"steps_per_save": 10}])
def test_responses_see_finer_runs_at_the_times_that_were_asked_for(how):
    """Counted steps are halved by twice the saving times; what hangs on these does not see them."""
    problem = falling(integrator=jc.integrator.FixedStep(method="semi_implicit", **how))
    assert len(problem.refine().shares) == (6 if "step" in how else 11)
    told = jc.monte_carlo(problem, 4).numerical_error("saves")
    assert told.bias == 0 and told.uncertainty == 0 and told.is_resolved


def test_worn_surfaces_are_updated_twice_as_often_by_the_same_program():
    """As in a run with twice the saving times and half the steps."""
    rig, traced = jc.scenes.slider_crank(wear=True), []
    volume = jc.response.WornVolume("B")

    def counted(run):
        traced.append(1)
        return volume(run)

    clearance = {"c": jc.Variable(lambda r: r.connections["B"].joint.clearance, tolerance=1e-6)}
    asked = {"duration": 2e-3, "integrator": jc.integrator.FixedStep(1e-5), "save": 5}
    problem = jc.Problem(rig, counted, clearance, **asked)
    traced.clear()
    found = jc.monte_carlo(problem, 2, chunk=2)
    # In the program of samples and replicas, and to see whether it reads depths.
    assert len(traced) == 2
    often = asked | {"integrator": jc.integrator.FixedStep(5e-6), "save": 9}
    finer = jc.Problem(rig, volume, clearance, **often)
    told = evaluate_chunk(finer, jnp.asarray(found.values)).responses["response"]
    assert np.all(np.asarray(told) > 0)
    np.testing.assert_allclose(found.replicas.responses["response"], told, rtol=1e-6)
    assert np.all(found.replicas.errors("response") > 1e-6 * np.asarray(told))


def test_the_same_samples_have_replicas_whatever_the_chunks_and_growth(study):
    small = jc.monte_carlo(falling(), 256, chunk=5)
    grown = jc.monte_carlo(falling(), 512, accuracy=1e-12, chunk=CHUNK)
    assert grown.count == 512 and grown.unreached
    for one in (small, grown):
        np.testing.assert_array_equal(one.values[:16], study.values[:16])
        for name, told in study.replicas.responses.items():
            np.testing.assert_allclose(one.replicas.responses[name], told, rtol=1e-12)
    few = jc.monte_carlo(falling(), 5)
    assert few.replicas.count == 5
    np.testing.assert_array_equal(few.replicas.coarse["way"], few.responses["way"])


def test_a_study_that_is_not_verified_says_so(study):
    plain = jc.monte_carlo(falling(), 256, chunk=CHUNK, verify=False)
    np.testing.assert_array_equal(plain.responses["way"], study.responses["way"])
    assert plain.replicas is None and "Not verified" in plain.sentence()
    assert "Not verified" not in study.sentence()
    assert "numerical error" not in plain.summary().columns
    for sentence, ask in {
        "this study has no replicas": lambda: plain.numerical_error("way"),
        "verify of monte_carlo": lambda: jc.monte_carlo(falling(), 4, verify="no"),
        'no response "speed"': lambda: study.numerical_error("speed"),
    }.items():
        with pytest.raises(ValueError, match=sentence):
            ask()
    # What is not discretised needs none.
    exact = jc.FunctionProblem(lambda a: 2 * a, {"a": jc.Dimension(1.0, tolerance=0.1)})
    found = jc.monte_carlo(exact, 16)
    assert found.replicas is None
    assert found.sentence().endswith("(95 %). 16 samples, 0 failed, 0 with warnings.")


def test_summary_and_print_tell_it(study):
    row = study.summary().set_index("response").loc["way"]
    told = study.numerical_error("way")
    assert row["numerical error"] == told.error == abs(told.bias) + told.uncertainty
    assert row["bias"] == told.bias and row["bias error"] == told.uncertainty
    assert row["replicas"] == 16 and row["mean error"] == told.sampling
    assert str(told) == f"± {told.whole:.2g} (samples {told.sampling:.2g}, steps {told.error:.2g})"
    assert with_error(row["mean"], told.whole) in str(study)
    kept = study.to_dataset()["finer way"]
    np.testing.assert_array_equal(kept, study.replicas.responses["way"])


def long_steps():
    """The way is a fifth too long."""
    return falling(integrator=jc.integrator.FixedStep(0.1, "semi_implicit"))


def test_what_is_off_beyond_the_promise_is_said(study):
    """Also in the verdict of a derivative, and below the figure."""
    found = jc.monte_carlo(long_steps(), CHUNK, chunk=CHUNK)
    (said,) = found.accuracy_warnings
    assert said.startswith('"way": the steps change its mean by +0.25 m, more than the tolerance')
    assert said in found.sentence() and said in str(found)
    assert _warned_samples(found)[: len(found.accuracy_warnings)] == as_warnings(
        found.accuracy_warnings
    )
    assert max(len(part.split()) for part in re.split(r"[.;] ", said)) <= MOST_WORDS
    assert study.accuracy_warnings == ()
    answers = jc.sensitivity(found.problem, sample=found, difference_samples=8)
    assert said in answers.derivatives["way", "gravity"].verdict
    assert said not in answers.derivatives["saves", "gravity"].verdict
    how = {"sample": 8, "difference_samples": 8, "methods": ("regression",)}
    assert jc.sensitivity(found.problem, **how).sample.replicas.count == 8
    assert jc.sensitivity(found.problem, **how, verify=False).sample.replicas is None


def test_replicas_that_fail_say_so_and_leave_the_study_alone():
    """Tighter tolerances take more steps than are allowed."""
    allowed = falling(integrator=jc.integrator.Adaptive(rtol=1e-4, atol=1e-6, max_steps=12))
    found = jc.monte_carlo(allowed, 32)
    assert len(found.failed) == 0
    failing, few = np.arange(16) % 8 == 3, int(jc.integrator.Outcome.TOO_MANY_STEPS)
    way = np.where(failing, np.nan, found.replicas.responses["way"])
    where = lambda own: (own.replicas.outcome, own.replicas.responses["way"])
    broken = eqx.tree_at(where, found, (np.where(failing, few, 0), way))
    (said,) = broken.accuracy_warnings
    assert said.startswith("2 of 16 replicas failed and tell nothing; of that of sample 3, the run")
    assert broken.numerical_error("way").replicas == 14
    assert broken.mean("way") == found.mean("way") and len(broken.failed) == 0


class Parting(jc.AbstractExperiment):
    """What steps of h make of a number: x + a sin(w x / h), which parts wholly for another h; a
    stranger's experiment, which refines itself."""

    step: jnp.ndarray
    apart: jnp.ndarray
    refines: bool = eqx.field(static=True, default=True)
    response_names: tuple[str, ...] = eqx.field(static=True, default=("y",))

    def evaluate(self, setting, *, discrete_derivatives=False):
        x = setting(self.subject)["x"]
        failed = self.step < 0.3
        outcome = jnp.where(failed, jc.integrator.Outcome.TOO_MANY_STEPS, 0)
        own = x + self.apart * jnp.sin(1e5 * x / self.step)
        return SampleResult({"y": own}, outcome, jnp.zeros(()))

    def refine(self, share=0.5):
        return eqx.tree_at(lambda own: own.step, self, self.step * share) if self.refines else None

    def cost(self):
        return Cost(64, 32)

    def describe(self):
        many = {jc.integrator.Outcome.TOO_MANY_STEPS: "it took too many steps."}
        known = {"y": ResponseInfo("m", promise=(0.0, 0.01))}
        return Description("Parting", known, many, discretised=True)


def parting(apart, step=1.0, **how):
    spread = {"x": jc.Dimension(1.0, jc.distribution.Normal(0.01))}
    return jc.Problem.of(Parting(jnp.asarray(step), jnp.asarray(apart), **how), spread)


def test_where_paths_part_two_figures_stand_side_by_side():
    found = jc.monte_carlo(parting(0.1), 1024)
    told = found.numerical_error("y")
    assert not told.is_resolved and np.isnan(told.whole)
    assert told.uncertainty > max(told.sampling, abs(told.bias))
    assert told.wanted == np.ceil(16 * (told.uncertainty / told.sampling) ** 2) > 16
    # Nobody is accused by chance.
    assert found.accuracy_warnings == ()
    said = (
        f"The error by the steps, {told.bias:.2g} ± {told.uncertainty:.2g} from 16 companion runs, "
        f"is not resolved; about {told.wanted:.0f} would resolve it."
    )
    assert said in str(found)
    assert f"mean error {told.sampling:.2g}" not in str(found) and str(told) == (
        f"± {told.sampling:.2g} (samples). {said}"
    )
    alone = jc.monte_carlo(parting(0.1), 1).replicas.bias("y")
    assert np.isfinite(alone[0]) and np.isinf(alone[1])


def test_a_replica_that_fails_of_a_strangers_problem_is_named():
    found = jc.monte_carlo(parting(0.0, step=0.5), 4)
    assert found.accuracy_warnings == (
        "4 of 4 replicas failed and tell nothing; of that of sample 0, it took too many steps.",
    )
    assert np.isinf(found.numerical_error("y").uncertainty) and len(found.failed) == 0
    assert "numerical error" in found.summary().columns
    still = jc.monte_carlo(parting(0.0, refines=False), 4)
    assert still.replicas is None and "Not verified" in still.sentence()


def test_a_campaign_keeps_its_replicas_and_adds_what_it_lacks(tmp_path, monkeypatch):
    """A larger one has those of the smaller, and eight more; nothing is run twice."""
    asked, counts, finer = long_steps(), [], workers.finer_runs
    counted = lambda *own: (counts.append(len(own[1])), finer(*own))[1]
    monkeypatch.setattr(workers, "finer_runs", counted)
    how = {"folder": tmp_path, "scramblings": 4}
    first = jc.campaign(asked, 8, **how)
    assert first.sample.replicas.count == 8
    whole = jc.campaign(asked, 32, **how)
    again = jc.campaign(asked, 32, **how)
    plain = jc.monte_carlo(asked, 32, scramblings=4)
    assert counts == [8, 8]
    for one in (whole, again, jc.open_campaign(tmp_path), jc.open_campaign(tmp_path, asked)):
        for name, told in plain.replicas.responses.items():
            np.testing.assert_allclose(one.sample.replicas.responses[name], told, rtol=1e-12)
        assert one.sentence() == plain.sentence()
        assert one.sample.accuracy_warnings == plain.accuracy_warnings
        np.testing.assert_allclose(one.numerical_error("way"), plain.numerical_error("way"))
        errors = (own.summary()["numerical error"][0] for own in (one, plain))
        assert next(errors) == pytest.approx(next(errors))
    finer = (own.to_dataset()["finer way"] for own in (whole, plain))
    np.testing.assert_allclose(*finer, rtol=1e-12)


def test_a_campaign_may_go_without_and_have_them_later(tmp_path):
    asked = falling()
    found = jc.campaign(asked, 8, folder=tmp_path, verify=False)
    assert found.sample.replicas is None and "Not verified" in found.sentence()
    assert "Not verified" in jc.open_campaign(tmp_path).sentence()
    assert jc.campaign(asked, 8, folder=tmp_path).sample.replicas.count == 8


def test_a_kept_study_of_derivatives_keeps_replicas_beside_what_it_asked_before(tmp_path):
    asked = falling()
    how = {"sample": 8, "difference_samples": 8, "variables": "gravity"}
    plain = jc.sensitivity(asked, **how)
    found = jc.sensitivity(asked, store=tmp_path, **how)
    files = len(list((tmp_path / CHUNKS).iterdir()))
    without = tmp_path / "without"
    jc.sensitivity(asked, store=without, verify=False, **how)
    assert 0 < len(list((without / CHUNKS).iterdir())) < files
    for name, told in plain.sample.replicas.responses.items():
        np.testing.assert_array_equal(found.sample.replicas.responses[name], told)


def test_intervals_of_derivatives_hold_what_steps_do():
    """Of the way T^2 / 2 by gravity, of its deviation the same by that of gravity; symplectic
    Euler's steps are h T / 2 long. Chance alone leaves rounding."""
    exact = DURATION**2 / 2
    how = {"sample": 64, "difference_samples": 16, "of": {"way": ("mean", "standard deviation")}}
    asked = ("gravity", "tolerance of gravity")
    found = jc.sensitivity(falling(), asked, **how).derivatives
    mean = found["way", "gravity"]
    assert abs(mean.value - exact) == pytest.approx(STEP * DURATION / 2, rel=1e-6)
    assert mean.trustworthy and abs(mean.value - exact) <= mean.error < 0.02 * exact
    assert all(own.error < 1e-9 * exact for own in mean.estimates.values())
    plain = jc.sensitivity(falling(), asked[:1], verify=False, **how).derivatives["way", "gravity"]
    assert plain.value == mean.value and plain.error < 1e-9 * exact
    # The deviation of what is drawn, by the tolerance.
    deviation = found["standard deviation of way", "tolerance of gravity"]
    share = float(falling().inputs.deviations()[0]) / 0.5
    assert abs(deviation.value - share * exact) <= deviation.error


def test_a_bias_of_a_derivative_that_replicas_do_not_tell_is_said():
    how = {"sample": 256, "difference_samples": 16, "methods": ("regression",)}
    found = jc.sensitivity(parting(0.1), **how).derivatives["y", "x"]
    assert "The error by the steps" in found.verdict and "16 companion runs" in found.verdict
    assert found.error == found.estimates["regression"].error
    few = jc.sensitivity(falling(), sample=2, methods=("differences",), difference_samples=16)
    assert "± inf" in few.derivatives["way", "gravity"].verdict


@pytest.mark.parametrize(
    ("response", "reads"),
    [
        (jc.response.PeakWornDepth("B"), True),
        (jc.response.WornVolume("B"), False),
        (lambda run: jnp.max(run.worn["B"]["bearing"]), True),
        (lambda run: jnp.max(run.contact("B").force), False),
    ],
)
def test_what_reads_worn_depths_has_replicas_on_wider_cells(response, reads):
    rig = loaded_bearing(200.0, jc.friction.CoulombTanh(mu_kinetic=0.1))
    varied = {"load": jc.Variable(lambda rig: rig.loads["load"].force, tolerance=20.0)}
    steps = jc.integrator.FixedStep(1e-5)
    problem = jc.Problem(rig, {"worn": response}, varied, duration=0.02, save=11, integrator=steps)
    wider = problem.experiment.on_wider_cells()
    assert (wider is not None) == reads
    if reads:
        forms = [jax.tree.structure(each) for each in (wider, problem.experiment)]
        assert forms[0] == forms[1]


@pytest.mark.slow
def test_the_bias_of_a_worn_depth_contains_what_cells_leave():
    """The reference has cells an eighth as wide. Volumes hang on steps alone."""
    rig = jc.scenes.four_bar("planar", cells=(144, 1))
    asked = {"depth": jc.response.PeakWornDepth("B"), "volume": jc.response.WornVolume("B")}
    mass = {"m": jc.Variable(lambda r: r.bodies["coupler"].mass, jc.distribution.Uniform(0.05))}
    how = {"duration": 0.2, "save": 51, "integrator": jc.integrator.FixedStep(2e-5)}
    found = jc.monte_carlo(jc.Problem(rig, asked, mass, **how), 16)
    finer = jc.scenes.four_bar("planar", cells=(1152, 1))
    right = jc.monte_carlo(jc.Problem(finer, asked, mass, **how), 16, verify=False)
    off = {name: found.mean(name).value - right.mean(name).value for name in asked}
    size = {name: right.mean(name).value for name in asked}
    assert off["depth"] < -0.05 * size["depth"]
    stated = found.numerical_error("depth")
    assert stated.bias < 0 and abs(off["depth"]) < abs(stated.bias) + stated.uncertainty
    assert abs(found.numerical_error("volume").bias) < 1e-3 * size["volume"]
