"""Advice on integrators: what is recommended keeps its word; what cannot be promised is said."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import plot
from jaxclear.ground.printing import as_typed
from jaxclear.studies.advice import PRESENT, Accuracy
from tests.rigs.refusals import refusals

THREE = jc.PilotSettings(copies=3)
ALONE = jc.PilotSettings(copies=1)


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
    """A bouncing journal in a bearing that is shaken: neighbouring runs part quickly."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Flores(stiffness=1e7, restitution=0.95), clearance=1e-3
    )
    shaken = jc.joint.Prismatic(drive=jc.drive.Harmonic(5e-4, 100.0))
    return jc.Mechanism(
        {"ring": jc.Body(1.0, 1e-3), "journal": jc.Body(1.0, 1e-4)},
        {
            "G": jc.Connection(shaken, "ground", "ring", axis="x"),
            "B": jc.Connection(bearing, "ring", "journal"),
        },
        {"gravity": jc.load.Gravity()},
    )


def last_angle(run):
    return run.coordinate("pivot")[-1]


def swings(response=last_angle, variables=(), *, damping=0.1, duration=1.0):
    pendulum = jc.Mechanism(
        {"rod": jc.Body(1.0, 1.0, (1.0, 0.0))},
        {"pivot": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
        {"gravity": jc.load.Gravity(), "brake": jc.load.JointSpring("pivot", damping=damping)},
    )
    return jc.Problem(pendulum, response, dict(variables), duration=duration, save=11)


MASS = {"mass": jc.Variable(lambda rig: rig.bodies["rod"].mass, jc.distribution.Uniform(1.5))}
CLEARANCE = {
    "clearance": jc.Variable(lambda rig: rig.connections["B"].joint.clearance, tolerance=2e-5)
}


def seen_force(run):
    """Mean of the force at the saved instants, which depends on the steps."""
    return jnp.mean(run.contact("B").normal_force)


FALL = {
    "force": seen_force,
    "place": jc.response.FinalCoordinate("journal", 1, unit="m"),
}


def falls(response=FALL, **kwargs):
    return jc.Problem(falling(), response, CLEARANCE, **({"duration": 0.05, "save": 26} | kwargs))


@pytest.fixture(scope="module")
def advice():
    return jc.advise(falls(), 1e-3, pilot=THREE)


def by(problem, integrator, values):
    """Responses of one set of values by an integrator."""
    own = eqx.tree_at(lambda p: p.integrator, problem, integrator)
    return eqx.filter_jit(own.evaluate)(jnp.asarray(values)).responses


@pytest.fixture(scope="module")
def truth(advice):
    """Steps far below those of any candidate."""
    fine = jc.integrator.FixedStep(1e-6)
    return [by(advice.original_problem, fine, values) for values in advice.copies.values]


@pytest.mark.parametrize("accuracy", [0.05, 0.01, 1e-3])
def test_the_recommended_setting_keeps_its_word(advice, truth, accuracy):
    found = advice.at(accuracy)
    assert found.is_accurate and f"keeps {100 * accuracy:g} %" in found.sentence()
    assert str(found).startswith(found.sentence()) and "f64[" not in str(found)
    for values, exact in zip(advice.copies.values, truth, strict=True):
        answer = by(advice.original_problem, found.recommended, values)
        for name, value in answer.items():
            assert abs(value / exact[name] - 1) < accuracy


def test_errors_told_are_errors_made(advice, truth):
    """Replicas tell them on the safe side, by at most ten times."""
    settings = [t for t in advice.trials if t.method == "FixedStep rk4" and not t.remark]
    assert len(settings) > 2
    exact = np.array([float(responses["force"]) for responses in truth])
    for trial in settings:
        answers = advice.copies.run(trial.integrator).answers["force"]
        made = max(abs(answers - exact)) / np.sqrt(np.mean(exact**2))
        assert 0.5 * made < trial.errors["force"] < 10 * made + 1e-6


def test_less_accuracy_is_never_dearer_and_runs_nothing_twice(advice):
    known = len(advice.copies._cache)
    works = [advice.at(accuracy).chosen.work for accuracy in (1e-1, 1e-2, 1e-3)]
    assert works == sorted(works) and len(advice.copies._cache) <= known + 6
    again = advice.at(1e-3)
    assert as_typed(again.recommended) == as_typed(advice.recommended)


def test_it_is_what_the_problem_itself_chooses():
    """Of the nominal sample, where no further rung is cheaper."""
    own = falls(accuracy=0.01)
    found = jc.advise(own, 0.01, pilot=ALONE)
    present = next(trial for trial in found.trials if trial.method == PRESENT)
    assert found.chosen.work <= present.work
    stated = {"Adaptive", "ImplicitStep", "FixedStep rk4"}
    cheapest = min(
        (t for t in found.trials if t.method in stated and t.meets), key=lambda t: t.work
    )
    assert as_typed(cheapest.integrator) == as_typed(own.integrator)


def test_a_trial_is_shown_as_a_sentence(advice):
    shown = f"{[*advice.trials]}{advice.chosen}"
    assert "array(" not in shown and "Trial(" not in shown
    assert str(advice.chosen).startswith(str(advice.sentence()).split(" keeps ")[0])
    assert " keeps the accuracy: estimated error " in shown


def test_the_problem_comes_back_with_the_recommended_integrator(advice):
    assert as_typed(advice.problem.integrator) == as_typed(advice.recommended)
    assert advice.problem.names == advice.original_problem.names
    assert "The problem's own FixedStep(step=2e-05)" in advice.sentence()
    names = {"Adaptive", "ImplicitStep", "FixedStep rk4", "FixedStep semi_implicit"}
    names |= {"FixedStep contact_steps", "MoreauJean", "NonColliding"}
    assert set(advice.why_not()) == names - {advice.chosen.method}
    # Nothing but the journal's own bearing holds it, so it has no place that always touches.
    assert "fails: no joint or floating body" in advice.why_not()["NonColliding"]


def test_what_a_model_leaves_out_is_told_and_never_recommended():
    """Rigid contact does not press while it is struck; its steps agree with each other."""
    found = jc.advise(falls({"force": seen_force}), 1e-3, pilot=ALONE)
    table = found.table()
    rigid, permanent = (table[table["method"] == name] for name in ("MoreauJean", "NonColliding"))
    assert rigid["left out by the model"].min() > 0.1 and not rigid["meets"].any()
    assert not permanent["recommended"].any() and len(permanent)
    assert "MoreauJean" in found.sentence() and "another model of contact" in found.sentence()
    assert found.why_not()["MoreauJean"].startswith("another model of contact")


@pytest.mark.slow(sample=False)
def test_chaos_is_said():
    response = {
        "force": jc.response.MeanContactForce("B"),
        "place": jc.response.FinalCoordinate("journal", unit="m"),
    }
    question = jc.Problem(rattling(), response, CLEARANCE, duration=0.8, save=81)
    for copies in (4, 1):
        found = jc.advise(question, 0.01, pilot=jc.PilotSettings(copies=copies))
        assert not found.is_accurate and found.chosen.worst[1] > 0.01
        assert "No integrator that was tried keeps 1 %" in found.sentence()
        assert "as chaotic ones do, ask for means over a sample" in found.sentence()
        assert found.warnings() and found.warnings()[0] in found.sentence()


def test_nothing_is_compiled_for_a_copy_or_a_setting():
    """Of a pendulum's three kinds of steps."""
    traced = []

    def counted(run):
        traced.append(1)
        return last_angle(run)

    found = jc.advise(swings(counted, MASS), 1e-6, pilot=THREE)
    assert len(found.trials) > 5 and len(traced) <= 3


def test_copies_that_cannot_be_are_left_out():
    found = jc.advise(swings(variables=MASS), 0.01)
    assert 1 < len(found.copies.values) < 8 and np.all(found.copies.values > 0)
    assert found.is_accurate and f"{len(found.copies.values)} runs" in found.sentence()


def test_the_worst_of_a_few_copies_leaves_something_to_those_not_seen():
    asked = Accuracy(0.01)
    assert [asked.limit(n) for n in (1, 3, 9)] == pytest.approx([0.01, 0.005, 0.0075])


def test_the_figure_shows_every_method(advice):
    axis = plot.work_precision(advice).axes[0]
    labels = [line.get_label() for line in axis.get_lines()]
    assert "Adaptive" in labels and "recommended" in labels and PRESENT in labels
    assert "accuracy asked, 0.1 %" in labels


FUNCTION = jc.FunctionProblem(lambda a: a, {"a": jc.Dimension(1.0, tolerance=0.1)})
test_mistakes_get_a_sentence = refusals(
    {
        "what advice is given on is a Mechanism; it must be a jaxclear.Problem": lambda: jc.advise(
            falling()
        ),
        "is a FunctionExperiment; it must be a jaxclear.Problem of a mechanism": lambda: jc.advise(
            FUNCTION
        ),
        "the accuracy .* is 1.0; it must be": lambda: jc.advise(swings(), 1.0),
        "the accuracy .* is 'high'; it must be": lambda: jc.advise(swings(), "high"),
        "above 0 and below 1": lambda: jc.advise(swings(), 0.0),
        "copies = 0; it must be": lambda: jc.PilotSettings(copies=0),
        "it must be one number": lambda: jc.advise(swings(lambda run: run.time)),
        "not finite": lambda: jc.advise(swings(lambda run: run.time[-1] * jnp.nan)),
        "is 0 in every copy": lambda: jc.advise(swings(lambda run: 0.0 * run.time[-1])),
    }
)
