"""What a record tells: the regression where the answer is known, what is asked wrongly, and one
small machine with a hidden clearance."""

import dataclasses
import functools
import types

import equinox as eqx
import jax
import numpy as np
import pandas
import pytest

import jaxclear as jc
from jaxclear.studies.identification import identify, laws, regression, result
from jaxclear.studies.identification.result import ends_in_words, unknown_of
from jaxclear.studies.identification.sample import check_identifiable, check_window, window_end
from tests.plot.identified import identified
from tests.rigs.refusals import refusals

LOSS = jc.contact.dissipation
B = lambda rig: rig.connections["B"].joint


def statistics(shares, rng, noise=0.02):
    """Ten numbers of the first unknown, of the sum of the second and third, and of noise."""
    first, both = shares[:, 0], shares[:, 1] + shares[:, 2]
    found = [np.sin(2 * first), first**2, both, both**2]
    found = np.stack(found, axis=1) + noise * rng.standard_normal((len(shares), 4))
    return np.column_stack([found, rng.standard_normal((len(shares), 6))])


@pytest.fixture(scope="module")
def fitted():
    rng = np.random.default_rng(4)
    shares = rng.random((256, 3))
    return regression.regression(statistics(shares, rng), shares)


def test_intervals_hold_what_they_promise_and_no_more(fitted):
    rng = np.random.default_rng(5)
    shares = rng.random((400, 3))
    told = [regression.predict(fitted, own) for own in statistics(shares, rng)]
    low, high = (
        np.array([[getattr(x, end) for x in own] for own in told]) for end in ("low", "high")
    )
    inside = (low <= shares) & (shares <= high)
    # One sample serves all: its own scatter beside that of 400 trials.
    assert np.all(np.abs(inside.mean(0) - 0.95) < 0.03)
    assert np.median((high - low)[:, 0]) < 0.2
    assert np.all(np.abs(regression.calibration(fitted).mean(0) - 0.95) < 0.02)


@pytest.mark.parametrize("runs", [64, 98, 99])
def test_few_runs_cannot_call_a_record_strange_and_say_so(runs):
    """Of so many runs the strangest record is one in runs + 1."""
    rng = np.random.default_rng(7)
    shares = rng.random((runs, 3))
    small = regression.regression(statistics(shares, rng), shares)
    strange = small.distance(np.full(10, 1e6)) <= result.STRANGE
    said = identify._too_few(runs)
    assert strange == (runs >= 99) == (not said)
    assert all("takes 100 runs or more" in own for own in said)


def test_what_is_told_together_is_named(fitted):
    names = "first", "second", "third"
    verdicts = result.IDENTIFIED, result.PARTLY, result.NOT
    (sentence,) = result.together(names, fitted, verdicts)
    assert sentence.startswith("second and third are identified only together")
    assert " + 1 x third" in sentence or " + 0.9" in sentence


@pytest.mark.parametrize("together", [1, 4])
def test_residuals_are_those_of_runs_that_were_not_seen(together):
    rng = np.random.default_rng(6)
    parts, unknowns = rng.standard_normal((24, 3)), rng.random((24, 2))
    groups = np.arange(24) // together
    kernel, ridge = regression._kernel(parts, parts, 1.0), 0.1
    values, vectors = np.linalg.eigh(kernel)
    inverse = 1 / (values + ridge)
    mean = unknowns.mean(0)
    weights = vectors @ (inverse[:, None] * (vectors.T @ (unknowns - mean)))
    given = None if together == 1 else groups
    found = regression._leave_out_residuals(vectors, inverse, weights, given)
    for group in np.unique(groups):
        out = groups == group
        seen = np.linalg.solve(
            kernel[np.ix_(~out, ~out)] + ridge * np.eye((~out).sum()), (unknowns - mean)[~out]
        )
        expected = (unknowns - mean)[out] - kernel[np.ix_(out, ~out)] @ seen
        np.testing.assert_allclose(found[out], expected, atol=1e-9)


@pytest.mark.parametrize("count", [39, 60, 256])
def test_the_order_statistics_are_those_of_one_more(count):
    """Of count + 1 exchangeable numbers the last is beyond either end in 2.5 % at the most."""
    low, high = regression.conformal(np.arange(count, dtype=float), 0.95)
    beyond = (count - high) / (count + 1)
    assert beyond <= 0.025 < beyond + 1 / (count + 1)
    assert low == count - 1 - high


def test_a_record_unlike_any_run_is_noticed(fitted):
    rng = np.random.default_rng(7)
    like = statistics(rng.random((50, 3)), rng)
    assert np.mean([fitted.distance(own) < 0.01 for own in like]) < 0.1
    assert fitted.distance(like[0] + 3.0 * np.eye(10)[0]) < 0.01


def test_a_run_of_the_sample_is_not_strange_though_its_statistics_outnumber_the_runs():
    """Three records of four were."""
    rng = np.random.default_rng(0)
    shares = rng.random((256, 1))
    shown = lambda at: np.append(at, 3 * at + rng.standard_normal(299))
    fitted = regression.regression(np.array([shown(own) for own in shares[:, 0]]), shares)
    like = [fitted.distance(shown(own)) for own in rng.random(40)]
    assert np.mean(np.array(like) < 0.05) < 0.2 and np.mean(like) == pytest.approx(0.5, abs=0.15)
    assert fitted.distance(shown(0.5) * 3) < 0.01


def test_a_number_chooses_the_law():
    rig = jc.scenes.slider_crank()
    found = laws.ensemble(rig)
    assert found.names[laws.DISSIPATION] == ("LankaraniNikravesh", "Flores", "HuntCrossley")
    assert found.names[laws.FRICTION] == ("Ambrosio", "CoulombTanh")

    def chosen(kind, number):
        return B(found.variables[kind].put("law", found.mechanism, float(number)))

    for number, name in enumerate(found.names[laws.DISSIPATION]):
        own = chosen(laws.DISSIPATION, number).contact
        damping = lambda law: float(law.relative_damping(0.1, 0.2))
        law = getattr(LOSS, name)(restitution=own.restitution)
        assert damping(own.dissipation) == pytest.approx(damping(law), rel=1e-12)
    for number, name in enumerate(found.names[laws.FRICTION]):
        own = chosen(laws.FRICTION, number).friction
        law = getattr(jc.friction, name)(mu_kinetic=0.03)
        assert float(own.coefficient(1.0)) == pytest.approx(float(law.coefficient(1.0)))
    # Where an unknown stood it still stands.
    moved = eqx.tree_at(lambda rig: B(rig).friction.mu_kinetic, found.mechanism, 0.2)
    assert float(B(moved).friction.coefficient(1.0)) == pytest.approx(0.2)
    assert B(found.mechanism).contact.restitution == B(rig).contact.restitution
    alone = laws.ensemble(rig, ())
    assert not alone.variables
    assert jax.tree.structure(alone.mechanism) == jax.tree.structure(rig)
    assert laws.ensemble(rig, (LOSS.Gonthier, LOSS.HuGuo)).names == {
        laws.DISSIPATION: ("LankaraniNikravesh", "Gonthier", "HuGuo")
    }


def test_a_sample_is_a_distribution():
    own = np.random.default_rng(8).normal(2.0, 0.5, 400)
    found = jc.distribution.Empirical(own, low=0.0)
    shares = np.linspace(0.01, 0.99, 50)
    np.testing.assert_allclose(found.quantile(shares), np.quantile(own, shares), atol=0.05)
    at = np.array([1.5, 2.0, 2.6])
    np.testing.assert_allclose(found.of_score(found.score(at)), at, atol=1e-9)
    assert float(found.quantile(np.array(0.0))) >= 0.0
    with pytest.raises(ValueError, match="two different"):
        jc.distribution.Empirical([1.0, 1.0])


TURNS, SPEED, PER = 8, 150.0, 128


def machine(clearance, contact=None, friction=True, integrator=None):
    rig = jc.scenes.slider_crank(
        clearance=clearance, crank_speed=SPEED, contact=contact, friction=friction
    )
    unknowns = {
        "clearance B": jc.Variable(lambda rig: B(rig).clearance, jc.distribution.Uniform(0.15e-3)),
        "restitution B": jc.Variable(
            lambda rig: B(rig).contact.restitution, jc.distribution.Uniform(0.09)
        ),
    }
    return jc.Problem(
        rig,
        jc.response.FinalCoordinate("O"),
        unknowns,
        duration=2 * np.pi / SPEED * TURNS,
        integrator=integrator or jc.integrator.FixedStep(4e-6),
    )


def sensors():
    gain = jc.Dimension(1.0, jc.distribution.Normal(0.03), unit="1")
    slider = jc.sensor.Accelerometer("slider", "x", noise=20.0, gain=gain)
    return {"a": slider, "angle": jc.sensor.Encoder("O")}


def record(clearance):
    """The last six turns of a machine with other laws and another integrator than the fit's."""
    steel = jc.Material(young_modulus=207e9, poisson_ratio=0.3)
    law = jc.contact.Gonthier(stiffness=jc.stiffness.HertzStiffness(steel, steel), restitution=0.85)
    rub = jc.friction.CoulombTanh(mu_kinetic=0.03, transition_speed=1e-2)
    own = machine(clearance, law, rub)
    run = jc.simulate(own.mechanism, float(own.duration), save=TURNS * PER + 1, verify=False)
    rng, rate = np.random.default_rng(9), PER * SPEED / (2 * np.pi)
    shown = {name: one.sensed(one(run), rate, rng)[0] for name, one in sensors().items()}
    first = 2 * PER
    return jc.Measurement(
        np.asarray(run.time)[first:],
        {name: own[first:] for name, own in shown.items()},
        sensors(),
        turn="angle",
    )


@pytest.mark.slow
def test_a_hidden_clearance_is_found_and_restitution_is_not(tmp_path):
    data, problem = record(0.25e-3), machine(0.2e-3)
    found = jc.identify(problem, data, runs=128, store=tmp_path)
    gap, loss = found["clearance B"], found["restitution B"]
    assert gap.low < 0.25e-3 < gap.high
    assert gap.verdict == "identified" and loss.verdict == "not identified"
    assert (loss.low, loss.high) == (loss.prior_low, loss.prior_high)
    assert found.explains
    assert "clearance B is 0.0002" in found.sentence()
    assert "restitution B is not identified: its interval is the prior's" in found.sentence()
    tree = found.to_dataset()
    assert tree["posterior clearance B"].dims == ("draw",)
    posterior = found.posterior()
    assert float(posterior.nominal()[0]) == pytest.approx(gap.estimate, rel=0.02)
    drawn = posterior.inputs.values(np.random.default_rng(0).standard_normal((500, 2)))[:, 0]
    assert np.mean((np.asarray(drawn) > gap.low) & (np.asarray(drawn) < gap.high)) > 0.9
    # The same sample, which need not run again, with another noise.
    pieces = sorted(tmp_path.rglob("*.chunk"))
    noisier = {"a": jc.sensor.Accelerometer("slider", "x", noise=40.0), "angle": sensors()["angle"]}
    again = jc.Measurement(data.time, data.signals, noisier, turn="angle")
    assert jc.identify(problem, again, runs=128, store=tmp_path)["clearance B"].verdict
    assert sorted(tmp_path.rglob("*.chunk")) == pieces
    # What no law of the sample explains identifies nothing, however narrow an interval is.
    louder = {"a": 3 * data.signals["a"], "angle": data.signals["angle"]}
    strange = jc.identify(
        problem,
        jc.Measurement(data.time, louder, sensors(), turn="angle"),
        runs=128,
        store=tmp_path,
    )
    assert strange.explains is False and "No law of the sample explains" in str(strange.warned)
    assert {own.verdict for own in strange.unknowns} <= {"not explained", "not identified"}
    assert strange["clearance B"].verdict == "not explained"
    assert ", not explained." in strange.sentence()
    assert "Intervals suppose the restitution" in found.sentence()


def test_an_interval_that_ends_where_its_prior_does_is_not_identified():
    problem = machine(0.2e-3)
    inside = unknown_of(problem, "clearance B", (0.8, 0.7, 0.95))
    touching = unknown_of(problem, "clearance B", (0.9, 0.7, 1.0))
    assert (inside.verdict, touching.verdict) == ("identified", "partly identified")
    assert ends_in_words(problem, [inside]) == []
    assert ends_in_words(problem, [touching]) == [
        'The interval of "clearance B" ends where its distribution does, at 0.00035: it may lie '
        "beyond."
    ]


def test_a_part_of_a_record_is_compared_with_that_part_of_a_run():
    """Turns of 0.1 s at 100 Hz, ten in a run: parts that end within a turn have their place."""
    time = np.linspace(0.0, 1.0, 101)
    whole = measured(time, np.sin(time), turn=0.1)
    run = types.SimpleNamespace(duration=1.0)
    assert window_end(run, whole) == 101
    assert window_end(run, whole.part(0.2, 0.65)) == 66
    assert window_end(run, whole.part(0.1, 0.9).part(0.2, 0.65)) == 66
    # Of a shorter run a place as far within a turn, or none.
    shorter, shortest = (types.SimpleNamespace(duration=lasts) for lasts in (0.6, 0.45))
    assert window_end(shorter, whole.part(0.2, 0.65)) == 56
    assert window_end(shortest, whole.part(0.2, 0.65)) is None
    assert window_end(shortest, whole.part(0.2, 0.6)) == 46
    with pytest.raises(ValueError, match=r"ends 0.35 s before .* whole turn, such as 0.7 s"):
        check_window(shortest, whole.part(0.2, 0.65))


def bare(**changed):
    time = np.linspace(0, 0.3, 301)
    given = {"signals": {"a": np.sin(time)}, "sensors": {"a": sensors()["a"]}, "turn": 0.0419}
    return jc.Measurement(time, **(given | changed))


def measured(time, values, **more):
    return jc.Measurement(time, {"a": values}, {"a": sensors()["a"]}, **more)


def identify_machine(record=None, integrator=None, **how):
    return jc.identify(machine(0.2e-3, integrator=integrator), record or bare(), **how)


test_what_is_no_record_or_question_is_named = refusals(
    {
        r"sensors none|each signal needs its sensor": lambda: bare(sensors={}),
        "must rise": lambda: measured([0.0, 0.0], [1, 2]),
        "has 2 samples": lambda: bare(signals={"a": [1.0, 2.0]}),
        "finite numbers in a row": lambda: bare(signals={"a": [[1.0]] * 301}),
        "nan at sample 3 of 301, and not finite at 2 in all": lambda: bare(
            signals={"a": [1.0, 2.0, np.nan, np.inf] + [0.0] * 297}
        ),
        "turn of a Measurement": lambda: bare(turn=-1.0),
        "give the problem a longer duration": lambda: check_identifiable(
            machine(0.2e-3), measured(np.linspace(0, 3, 301), np.zeros(301))
        ),
        "piston": lambda: check_identifiable(
            machine(0.2e-3), bare(sensors={"a": jc.sensor.Gyroscope("piston")})
        ),
        "runs of identify": lambda: identify_machine(runs=10),
        "NonColliding moves bodies as ideal joints do": lambda: identify_machine(
            integrator=jc.integrator.NonColliding()
        ),
    }
)


@pytest.mark.parametrize("between, decimal", [(";", ","), (";", "."), ("\t", ","), (",", ".")])
def test_a_record_is_read_from_files(tmp_path, between, decimal):
    """With columns between several marks, and times in milliseconds."""
    data, file = bare(turn=None), tmp_path / "record.csv"
    table = pandas.DataFrame({"t": 1e3 * data.time, "a": data.signals["a"]})
    table.to_csv(file, index=False, sep=between, decimal=decimal)
    read = functools.partial(
        jc.Measurement.read_csv, file, time="t", signals={"a": sensors()["a"]}, time_unit="ms"
    )
    found = read()
    np.testing.assert_allclose(found.time, data.time, atol=1e-12)
    np.testing.assert_allclose(found.signals["a"], data.signals["a"])
    assert found.rate == pytest.approx(1000.0) and len(data.part(0.1, 0.2).time) == 101
    assert read(time_unit="s").rate == pytest.approx(1.0)
    with pytest.raises(ValueError, match='column "b"'):
        read(signals={"b": sensors()["a"]})
    with pytest.raises(ValueError, match='no unit "h" of time'):
        read(time_unit="h")


def test_unknowns_keep_their_order_where_jax_sorts_their_names():
    made = machine(0.2e-3)
    backwards = dict(reversed(made.variables.items()))
    told = made.response, backwards
    own = jc.Problem(made.mechanism, *told, duration=0.1, integrator=made.integrator)
    sorted_ = jax.tree.map(lambda leaf: leaf, own)
    assert tuple(sorted_.variables) != sorted_.names
    values = np.array([[0.9, 2e-4], [0.85, 2.2e-4], [0.86, 2.4e-4]])
    found = result.posterior_of(sorted_, values)
    assert found.names == own.names
    np.testing.assert_allclose(found.nominal(), [0.86, 2.2e-4], rtol=1e-6)


def test_a_record_that_is_like_the_runs_is_said_to_be_so():
    parts = jc.Dimension(0.0, tolerance=1e-3)
    like = identified(jc.FunctionProblem(lambda a, b: a + b, dict.fromkeys("ab", parts)))
    assert "The record is like the runs: 40 % of them lie as far off as it." in like.sentence()
    assert not like.warned
    unlike = dataclasses.replace(like, explained=1e-3)
    assert "like the runs" not in unlike.sentence() and "No law" in unlike.warned[0]
    few = dataclasses.replace(like, runs=64)
    assert few.explains is None and "like the runs" not in few.sentence()
