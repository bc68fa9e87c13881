"""Advice on integrators: what is recommended keeps its word, and what cannot be promised is
said."""

import dataclasses
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.studies import verdict
from jaxclear.studies.advice import advice as advice_module
from jaxclear.studies.advice import confirmation, shortcomings
from jaxclear.studies.advice.choice import piloted
from jaxclear.studies.advice.comparison import Comparison
from jaxclear.studies.advice.curve import REFERENCE, Choice, Curve
from jaxclear.studies.advice.pilot import Trial, describe, evaluate_one, measure, pilot_of
from jaxclear.studies.advice.trials import NO_FINER, TOO_DEAR
from jaxclear.studies.work_precision import default_candidates, loosened, steps, tight_reference

STEPS = (5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)


def falling():
    """A journal that falls in its bearing and bounces."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Flores(stiffness=1e8, restitution=0.5), clearance=1e-3
    )
    connections = {"B": jc.Connection(bearing, "ground", "journal")}
    return jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)}, connections, {"gravity": jc.load.Gravity()}
    )


def rattling():
    """A bouncing journal in a bearing that is shaken: chaotic, neighbouring runs part within tenths
    of a second.
    """
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Flores(stiffness=1e7, restitution=0.95), clearance=1e-3
    )
    return jc.Mechanism(
        {"ring": jc.Body(1.0, 1e-3), "journal": jc.Body(1.0, 1e-4)},
        {
            "G": jc.Connection(
                jc.joint.Prismatic(drive=jc.drive.Harmonic(5e-4, 100.0)), "ground", "ring", axis="x"
            ),
            "B": jc.Connection(bearing, "ring", "journal"),
        },
        {"gravity": jc.load.Gravity()},
    )


def pendulum(damping):
    """A pendulum with a damper."""
    return jc.Mechanism(
        {"rod": jc.Body(1.0, 1.0, (1.0, 0.0))},
        {"pivot": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"gravity": jc.load.Gravity(), "brake": jc.load.JointSpring("pivot", damping=damping)},
    )


def last_angle(run):
    return run.coordinate("pivot")[-1, 0]


def swings(response=last_angle, variables=(), *, damping=0.1, duration=1.0):
    return jc.Problem(pendulum(damping), response, dict(variables), duration=duration, save=11)


MASS = {"mass": jc.Variable(lambda rig: rig.bodies["rod"].mass, jc.distribution.Uniform(1.5))}


CLEARANCE = {
    "clearance": jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=2e-5)
}


def seen_force(run):
    """Mean of the force at the saved instants, which hangs on the steps more than the impulse
    does."""
    return jnp.mean(run.contact("B").normal_force)


FALL = {
    "force": seen_force,
    "place": jc.response.FinalCoordinate("journal", 1, unit="m"),
}


def falls(response=FALL, **kwargs):
    return jc.Problem(falling(), response, CLEARANCE, **({"duration": 0.05, "save": 26} | kwargs))


def explicit(*methods, scale=1.0):
    return {
        method: [jc.integrator.FixedStep(scale * step, method) for step in STEPS]
        for method in methods
    }


CANDIDATES = explicit("rk4") | {
    "Adaptive": [loosened(tight_reference(), 10.0**decade) for decade in (6, 5, 4, 3, 2, 1)]
}


@pytest.fixture(scope="module")
def advice():
    return jc.advise(
        falls(),
        1e-3,
        pilot=jc.PilotSettings(copies=3, duration=0.05, shorter=0),
        candidates=CANDIDATES,
    )


FINE = jc.integrator.FixedStep(1e-6)


def truth(problem, values):
    """Steps far below those of any candidate: the same equations, none of the reference's error
    control."""
    fine = eqx.tree_at(lambda p: p.integrator, problem, FINE)
    return evaluate_one(fine, jnp.asarray(values)).responses


@pytest.mark.parametrize("accuracy", [0.05, 0.01, 1e-3])
def test_the_recommended_setting_keeps_its_word(advice, accuracy):
    found = advice.at(accuracy)
    assert found.met and f"meets {100 * accuracy:g} %" in found.sentence()
    assert str(found).startswith(found.sentence()) and "f64[" not in str(found)
    for values in advice.comparison.pilot.values:
        exact = truth(advice.asked, values)
        answer = evaluate_one(found.problem, jnp.asarray(values)).responses
        for name, value in answer.items():
            assert abs(value / exact[name] - 1) < accuracy


def test_errors_told_are_errors_made(advice):
    """The table's errors against runs that know nothing of the reference."""
    exact = [truth(advice.asked, values) for values in advice.comparison.pilot.values]
    table = advice.table()
    for row, trial in zip(
        table[table["method"] == "rk4"].itertuples(),
        advice.comparison.curves["rk4"].trials,
        strict=True,
    ):
        if not trial.failure:
            gaps = [
                max(abs(trial.responses[name] - [float(e[name]) for e in exact]))
                / np.sqrt(np.mean([float(e[name]) ** 2 for e in exact]))
                for name in FALL
            ]
            assert row.error == pytest.approx(max(gaps), rel=0.05, abs=1e-4)


def test_less_accuracy_is_never_dearer(advice):
    costs = [advice.at(accuracy).cost for accuracy in (1e-1, 1e-2, 1e-3, 1e-4)]
    assert costs == sorted(costs)


def test_the_problem_comes_back_with_the_recommended_integrator(advice):
    assert describe(advice.problem.integrator) == describe(advice.recommended)
    assert describe(advice.asked.integrator) == "FixedStep(step=2e-05)" in advice.sentence()
    assert set(advice.why_not()) == {"rk4", "Adaptive"} - {advice.comparison.choice.method}


def test_steps_too_long_are_too_inaccurate(advice):
    first = advice.comparison.curves["rk4"].trials[0]
    table = advice.table()
    remark = table["remark"][table["setting"] == describe(first.integrator)].item()
    assert remark == "too inaccurate"


@pytest.mark.slow
def test_an_unstable_rung_is_reported():
    """A damper that stops the rod within a microsecond: steps of a hundred are refused by the
    numbers themselves.
    """
    candidates = {"long": [jc.integrator.FixedStep(step) for step in (1e-4, 5e-5)]}
    found = jc.advise(
        swings(damping=2e6, duration=1e-2),
        0.01,
        pilot=jc.PilotSettings(duration=1e-2),
        candidates=candidates,
    )
    assert "gained energy" in found.table()["remark"].tolist()[-1]
    assert "gained energy" in found.why_not()["long"]
    assert found.comparison.choice.method == REFERENCE and found.met


@pytest.mark.slow
def test_chaos_is_said():
    response = {
        "force": jc.response.MeanContactForce("B"),
        "place": jc.response.FinalCoordinate("journal", unit="m"),
    }
    question = jc.Problem(rattling(), response, CLEARANCE, duration=0.8, save=81)
    candidates = {"rk4": [jc.integrator.FixedStep(step) for step in (5e-5, 2e-5)]}
    found = jc.advise(
        question, 0.01, pilot=jc.PilotSettings(copies=4, duration=0.8), candidates=candidates
    )
    assert not found.met and found.comparison.criteria["place"].by_means
    sentence = found.sentence()
    assert (
        "Single runs do not converge" in sentence
        and "No setting can be shown to meet 1 %" in sentence
    )
    assert "copies" in sentence and found.comparison.criteria["place"].limit > 0.01
    alone = jc.advise(
        question,
        0.01,
        pilot=jc.PilotSettings(copies=1, duration=0.8, shorter=0),
        candidates=candidates,
    )
    assert not alone.met and "at least 3 copies" in alone.sentence()


def test_each_kind_of_integrator_compiles_once():
    traced = []

    def counted(run):
        traced.append(1)
        return last_angle(run)

    question = swings(counted, MASS)
    found = jc.advise(
        question,
        1e-7,
        pilot=jc.PilotSettings(copies=2, whole=False),
        candidates=explicit("rk4", scale=200.0),
    )
    assert len(found.comparison.curves["rk4"].trials) > 1
    # One program for both references, one for the method and the problem's own.
    assert len(traced) == 2
    jc.advise(
        question,
        1e-3,
        pilot=jc.PilotSettings(copies=3, seed=1, whole=False),
        candidates=explicit("rk4", scale=100.0),
    )
    assert len(traced) == 2


@pytest.mark.slow
def test_in_batches_the_cheapest_there_is_taken(advice):
    found = jc.advise(
        advice.asked,
        0.05,
        pilot=jc.PilotSettings(copies=2, duration=0.05),
        batch=4,
        candidates=explicit("rk4"),
    )
    assert np.isfinite(
        found.comparison.trial(found.comparison.choice).cost_in_batch
    ) and found.cost == pytest.approx(found.comparison.trial(found.comparison.choice).cost_in_batch)
    assert "in batches of 4" in found.sentence()


def test_a_pilot_is_the_start_of_the_problem():
    path = jnp.linspace(0, 1, 26)[:, None] * jnp.ones(3)
    question = falls({"stray": jc.response.PositionError("journal", path)})
    piece = pilot_of(question, jc.PilotSettings(copies=1, duration=0.019))
    assert piece.duration == pytest.approx(0.02) and piece.whole == 0.05
    np.testing.assert_allclose(
        piece.problem.shares * piece.duration, (question.shares * 0.05)[:11], atol=1e-15
    )
    np.testing.assert_array_equal(piece.problem.response["stray"].reference, path[:11])


@pytest.mark.slow
def test_what_holds_for_the_pilot_alone_is_found_out():
    """The pilot ends before the first touch: any step is right in it."""
    place = {"place": jc.response.FinalCoordinate("journal", 1, unit="m")}
    accuracy = 3e-4
    found = jc.advise(
        falls(place, duration=0.025),
        accuracy,
        pilot=jc.PilotSettings(copies=1, shorter=0),
        candidates=explicit("rk4"),
    )
    first = found.first
    assert verdict.coarsest(first.curves["rk4"].trials, first.criteria) == 0
    assert found.met
    exact, long, chosen = (
        float(evaluate_one(problem, jnp.asarray(first.pilot.values[0])).responses["place"])
        for problem in (
            eqx.tree_at(lambda p: p.integrator, found.asked, integrator)
            for integrator in (FINE, first.curves["rk4"].trials[0].integrator, found.recommended)
        )
    )
    assert abs(chosen / exact - 1) < accuracy < abs(long / exact - 1)
    assert "one run over the first 0.007 s and on one run over all of 0.025 s" in found.sentence()
    told = found.table()
    assert sorted(set(told["simulated [s]"])) == pytest.approx([0.007, 0.025])
    assert sum(told["recommended"]) == 1


@pytest.mark.slow
def test_a_pilot_in_which_nothing_touches_is_made_longer():
    """The journal falls for 0.0143 s."""
    question = falls({"force": FALL["force"]}, save=51)
    pilot, _ = piloted(question, jc.PilotSettings(copies=1), {})
    assert 0.0143 < pilot.duration < 0.05


@pytest.mark.slow
def test_advice_that_cannot_be_confirmed_is_not_sure():
    """The reference itself has no answer over the whole."""
    late = lambda run: jnp.where(run.time[-1] > 0.5, jnp.nan, last_angle(run))
    found = jc.advise(swings(late), 0.01, candidates=explicit("rk4", scale=200.0))
    assert found.comparison.met and not found.met
    assert "Over the whole 1 s nothing is shown" in found.sentence()


def test_the_worst_of_a_few_copies_leaves_something_to_those_not_seen():
    answers = np.linspace(1.0, 2.0, 9)
    limits = [verdict.criterion(answers[:n], answers[:n], 0.01).limit for n in (1, 3, 9)]
    assert limits == pytest.approx([0.01, 0.005, 0.0075])


def test_an_error_told_is_not_that_of_one_lucky_run():
    """Where in a step the journal touches decides what that step is off by: a run a little shorter
    is off several times as much, and the error told knows it."""
    short = pilot_of(falls(), jc.PilotSettings(copies=1, duration=0.05))
    others = dataclasses.replace(short, shares=np.linspace(0.971, 0.999, 12))
    step = jc.integrator.FixedStep(1e-4)
    told, made = (
        np.abs(1 - measure(pilot, step).responses["force"] / exact.responses["force"])
        for pilot, exact in ((one, measure(one, tight_reference())) for one in (short, others))
    )
    assert told.shape == (4,) and 3 * told[0] < made.max() < 2 * told.max()
    assert not len(pilot_of(swings(), jc.PilotSettings(copies=1)).shares)


@pytest.mark.slow
def test_copies_that_no_integrator_can_run_are_left_out():
    found = jc.advise(
        swings(variables=MASS),
        0.01,
        pilot=jc.PilotSettings(copies=8),
        candidates=explicit("rk4", scale=100.0),
    )
    assert 1 < len(found.comparison.pilot.values) < 8 and np.all(found.comparison.pilot.values > 0)


def trial(error, cost=1.0):
    return Trial(
        jc.integrator.FixedStep(),
        {"r": np.array([1.0, 2.0, 3.0]) * (1 + error)},
        np.zeros(3, int),
        cost,
        0.0,
        "",
    )


@pytest.mark.parametrize(
    ("integrator", "errors", "said"),
    [
        (jc.integrator.NonColliding(), (0.4, 0.42), True),
        (jc.integrator.NonColliding(), (0.4, 0.2), False),
        (jc.integrator.ImplicitStep(), (0.4, 0.42), False),
    ],
)
def test_an_error_that_shorter_steps_leave_as_it_is_is_said_to_be_the_models(
    integrator, errors, said
):
    """Of joints that always touch; of compliant contact it may be that all steps are too long."""
    answers = np.array([1.0, 2.0, 3.0])
    criteria = {"r": verdict.criterion(answers, answers, 0.01)}
    trials = [dataclasses.replace(trial(error), integrator=integrator) for error in errors]
    assert (shortcomings.OF_ITS_MODEL in shortcomings.shortcoming(trials, criteria)) == said


def test_a_setting_that_passes_by_luck_is_not_taken():
    criteria = {"r": verdict.criterion(np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0]), 0.01)}
    assert (
        verdict.coarsest(
            (trial(0.5), trial(0.001), trial(0.1), trial(0.003), trial(0.001)), criteria
        )
        == 3
    )
    assert verdict.coarsest((trial(0.5), trial(0.001)), criteria) is None


@pytest.mark.parametrize(
    ("integrator", "times"),
    [
        (jc.integrator.Adaptive(), 300.0),
        (jc.integrator.ImplicitStep(1e-5), 1.0),
        (jc.integrator.FixedStep(1e-5), 1.0),
        (jc.integrator.FixedStep(1e-5, contact_steps=20), 20.0),
        (jc.integrator.FixedStep(steps_per_save=3), 1.0),
    ],
    ids=["Adaptive", "ImplicitStep", "FixedStep", "contact_steps", "steps_per_save"],
)
def test_steps_of_one_length_are_not_taken_for_dearer_where_the_reference_is(integrator, times):
    """The flap's dampers made `Adaptive` 360 times as dear behind the pilot, and implicit steps,
    81 times cheaper there, were not tried for that."""
    known = SimpleNamespace(
        trial=lambda choice: SimpleNamespace(integrator=integrator), cost_of=lambda choice: 0.2
    )
    assert confirmation._cost_over_whole(known, None, 300.0) == pytest.approx(0.2 * times)


@pytest.mark.parametrize("dearer", [400.0, 1.0])
def test_a_method_that_the_pilot_gave_up_is_tried_where_the_whole_is_much_dearer(dearer):
    """Implicit steps, too inaccurate and dearer than the reference in the pilot of a flap, were the
    cheapest over the whole, where explicit ones took 400 times as long."""
    exact = np.array([1.0, 2.0, 3.0])
    one = lambda step, off: Trial(step, {"r": exact + off}, np.ones(3), 1.0, 0.0, "")
    adaptive = jc.integrator.Adaptive()
    curves = {
        REFERENCE: Curve((one(adaptive, 0.0), one(adaptive, 0.0)), ""),
        "Adaptive": Curve((one(adaptive, 0.0), one(adaptive, 0.0)), ""),
        "ImplicitStep": Curve(
            tuple(one(jc.integrator.ImplicitStep(step), 1.0) for step in (1e-4, 1e-5)), TOO_DEAR
        ),
        "FixedStep": Curve((one(jc.integrator.FixedStep(), 1.0),), NO_FINER),
    }
    short = SimpleNamespace(values=np.zeros((3, 1)))
    found = Comparison(0.01, short, curves, {}, ("r",), False, None)
    tried = confirmation._promising(found, dearer)
    given_up = [("ImplicitStep", 1, 1)] if dearer > 1 else []
    assert tried == [*given_up, ("Adaptive", 0, 0)]


@pytest.mark.parametrize(
    ("whole", "times", "said"),
    [
        (False, 0.5, "expected to be dearer later on: "),
        (False, 2.0, "dearer: "),
        (True, 0.5, "dearer: "),
    ],
)
def test_what_a_method_costs_in_the_first_part_alone_is_said_to_be_that(advice, whole, times, said):
    known = advice.comparison
    wanted = ("curves", "criteria", "shown", "cost_of", "trial")
    found = SimpleNamespace(**{name: getattr(known, name) for name in wanted}, is_whole=whole)
    told = advice_module._reason(found, known.choice.method, known.cost / times)
    assert told.startswith(said) and f"at {times:.2g} times the cost" in told


def test_nothing_dearer_than_the_reference_is_taken():
    """Whose looser run shows how far it is right: fixed steps of 14 times its cost were taken."""
    exact = np.array([1.0, 2.0, 3.0])
    runs = lambda off: {"r": exact + off}
    one = lambda off, cost: Trial(jc.integrator.FixedStep(), runs(off), np.ones(3), cost, 0.0, "")
    curves = {
        REFERENCE: Curve((one(9e-3, 1.0), one(0.0, 1.3)), ""),
        "FixedStep": Curve((one(1e-4, 15.0), one(0.0, 30.0)), ""),
    }
    short = SimpleNamespace(values=np.zeros((3, 1)))
    found = Comparison(0.01, short, curves, {}, ("r",), False, None)
    assert found.choice == Choice(REFERENCE, 1) and found.met


def test_means_are_compared_where_runs_do_not_repeat():
    noise = np.random.default_rng(0).normal(1.0, 0.1, (3, 40_000))
    criterion = verdict.criterion(noise[0], noise[1], 0.01)
    error, uncertainty = verdict.error_of(noise[2], criterion)
    # The difference from a mean of two: 0.1 sqrt(1 + 1/2) / 200, times 1.96, as a share of 1.005.
    assert (
        criterion.by_means
        and criterion.limit == 0.01
        and uncertainty == pytest.approx(0.1 * 1.5**0.5 / 200 * 1.96, rel=0.05)
    )
    assert error < 2 * uncertainty
    assert sum(verdict.error_of(noise[2] * 1.02, criterion)) > 0.01
    # Runs that repeat are compared by means where that is asked for.
    assert verdict.criterion(noise[0], noise[0], 0.01, means=True).by_means
    assert not verdict.criterion(noise[0], noise[0], 0.01).by_means
    few = verdict.criterion(noise[0, :8], noise[1, :8], 0.01)
    assert few.by_means and few.limit > 0.01


def test_an_undecided_setting_asks_for_copies():
    one, other = np.random.default_rng(1).normal(1.0, 0.1, (2, 16))
    criteria = {"r": verdict.criterion(one, one + 1e-9, 0.01, means=True)}
    vague = eqx.tree_at(
        lambda t: (t.responses, t.outcome), trial(0.0), ({"r": other}, np.zeros(16, int))
    )
    assert verdict.undecided(vague, criteria) and not verdict.passes(vague, criteria)
    # 95 % of 0.1 sqrt(2) within 0.01 takes (1.96 x 0.14 / 0.01)^2 = 770 copies, give or take the
    # chance of 16.
    assert 200 < verdict.copies_to_decide(vague, criteria) < 4000
    wrong = eqx.tree_at(lambda t: t.responses, trial(0.0), {"r": other + 1.0})
    assert not verdict.undecided(wrong, criteria)


def test_means_are_judged_where_they_are_asked_for(advice):
    means = advice.of_means()
    assert all(criterion.by_means for criterion in means.comparison.criteria.values())
    assert "Judged are means" in means.sentence() and "Judged are means" not in advice.sentence()


def test_the_default_candidates_go_from_the_saving_interval_down():
    candidates = default_candidates(falls(), tight_reference())
    assert (
        float(candidates["FixedStep rk4"][0].step) == 2e-3
        and "FixedStep contact_steps" in candidates
    )
    assert "FixedStep contact_steps" not in default_candidates(swings(), tight_reference())
    assert list(steps(3e-8)) == [2e-8, 1e-8]
    assert eqx.tree_equal(candidates["Adaptive"][-1], loosened(tight_reference(), 10.0))
    tolerances = [float(i.rtol) for i in candidates["Adaptive"]]
    assert tolerances == sorted(tolerances, reverse=True) and tolerances[0] == pytest.approx(1e-3)


def test_what_the_runs_of_the_choice_warn_of_is_said(advice):
    """One copy of three warns of its mean forces: in the sentence, the table and the figure."""
    told = "1 of 3 runs warn (halved steps: mean force in 1)."
    choice = advice.comparison.choice
    curve = advice.comparison.curves[choice.method]
    trials = list(curve.trials)
    trials[choice.place] = dataclasses.replace(trials[choice.place], warnings=told)
    curves = advice.comparison.curves | {choice.method: curve._replace(trials=tuple(trials))}
    warns = dataclasses.replace(
        advice, comparison=dataclasses.replace(advice.comparison, curves=curves)
    )
    said = f"With the recommended setting {told}"
    assert warns.warnings() == [said] and said in warns.sentence()
    table = warns.table()
    assert list(table["remark"][table["recommended"]]) == [told]
    assert said in " ".join(plot.work_precision(warns).texts[-1].get_text().split())


def test_the_figure_shows_every_rung(advice):
    axis = plot.work_precision(advice).axes[0]
    labels = [line.get_label() for line in axis.get_lines()]
    assert (
        labels[:2] == ["rk4", "Adaptive"]
        and "recommended" in labels
        and "accuracy asked, 0.1 %" in labels
    )


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda: jc.advise(falling()),
            "what advice is given on is a Mechanism; it must be a jaxclear.Problem",
        ),
        (lambda: jc.advise(falls(), 1.0), "the accuracy .* is 1.0; it must be"),
        (lambda: jc.advise(falls(), "high"), "the accuracy .* is 'high'; it must be"),
        (lambda: jc.advise(falls(), 0.0), "above 0 and below 1"),
        (lambda: jc.PilotSettings(copies=0), "copies = 0; it must be"),
        (lambda: jc.advise(falls(), batch=1.5), "batch of advise is 1.5"),
        (
            lambda: jc.advise(falls(), pilot=jc.PilotSettings(duration=1.0)),
            "the pilot's duration is 1.0 s",
        ),
        (
            lambda: jc.PilotSettings(reference=jc.integrator.FixedStep()),
            "must be a jaxclear.integrator.Adaptive",
        ),
        (lambda: jc.advise(falls(), scales={"speed": 1.0}), 'no response "speed"'),
        (lambda: jc.advise(falls(), scales={"force": 0.0}), 'the scale of response "force"'),
        (lambda: jc.advise(falls(), candidates={}), "candidates is"),
        (
            lambda: jc.advise(falls(), pilot=jc.PilotSettings(copies=2), means=True),
            "means need at least 3 copies",
        ),
        (
            lambda: jc.advise(falls(), candidates={"reference": [jc.integrator.FixedStep()]}),
            'no method may be called "reference"',
        ),
        (lambda: jc.advise(falls(), candidates={"steps": [1e-4]}), r'candidates\["steps"\]'),
        (lambda: jc.advise(swings(lambda run: run.time)), "it must be one number"),
        (lambda: jc.advise(swings(lambda run: run.time[-1] * jnp.nan)), "not finite"),
        (
            lambda: jc.advise(swings(lambda run: 0.0 * run.time[-1])),
            "is 0 in every copy of the pilot",
        ),
        (
            lambda: jc.advise(swings(lambda run: (run.time - np.linspace(0, 1, 11)).sum())),
            r"give pilot=jaxclear.PilotSettings\(duration=1\)",
        ),
    ],
)
def test_mistakes_get_a_sentence(call, sentence):
    with pytest.raises(ValueError, match=sentence):
        call()
