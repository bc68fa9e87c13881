"""A response or a variable that cannot be is refused by its name where a problem is built, before
anything is compiled; one that can is taken as it is."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

RIG = jc.scenes.slider_crank()
ROD = jc.Variable(lambda rig: rig.bodies["rod"].mass, tolerance=1e-3)
PATH = np.zeros((11, 3))


def problem(response, variable=ROD, **more):
    asked = {"duration": 1e-2, "save": 21} | more
    return jc.Problem(RIG, {"wanted": response}, {"rod": variable}, **asked)


@pytest.fixture
def nothing_compiles(monkeypatch):
    """What is refused here is refused before the mechanism is assembled."""

    def refused(*_):
        raise AssertionError("a mechanism is assembled before its responses are looked at")

    monkeypatch.setattr("jaxclear.studies.run_experiment.sampled", refused)
    monkeypatch.setattr("jaxclear.studies.run_experiment.unasked", refused)
    monkeypatch.setattr("jaxclear.studies.run_experiment.chosen_integrator", refused)


def branches(run):
    if run.body("rod").com[-1, 0] > 0:
        return run.ended
    return 0.0


RESPONSES = {
    "float": (
        lambda run: float(jnp.max(run.contact("B").normal_force)),
        r'leaves JAX in ".*float\(.*" \(test_asked_wrongly.py, line \d+\).*Leave float',
    ),
    "math": (lambda run: math.sqrt(run.ended), 'leaves JAX in ".*math.sqrt.*jax.numpy.sqrt'),
    "if": (branches, r'leaves JAX in "if .*> 0:".*jax.numpy.where for `if`'),
    "a table": (lambda run: run.to_dataset(), "leaves JAX"),
    "a joint": (jc.response.MeanContactForce("b"), 'fails: no clearance joint "b".*mean "B"'),
    "a joint of a function": (
        lambda run: run.contact("Bb").normal_force[-1],
        'fails in ".*contact.*no clearance joint "Bb"',
    ),
    "a body": (lambda run: run.body("rodd").com[-1, 0], 'no body "rodd".*Did you mean "rod"'),
    "a method": (lambda run: run.bodie("rod"), "fails in .*AttributeError: .*bodie"),
    "a surface": (jc.response.PeakWornDepth("B"), 'fails: surface "bearing" of joint "B" does not'),
    "a path": (jc.response.PositionError("rod", PATH), "11 saving times, the run has 21"),
    "a tip": (jc.response.PointingAngle("rodd"), 'no body "rodd" for the tip'),
    "several": (lambda run: run.body("rod").com, r"gives an array of shape \(21, 3\)"),
    "nothing": (lambda run: None, "is a `return` missing"),
    "events that nobody kept": (lambda run: run.events(), "kept no touches"),
}


@pytest.mark.parametrize("name", RESPONSES)
@pytest.mark.parametrize("accuracy", [None, 0.1])
def test_a_response_that_cannot_be_is_refused_by_its_name(name, accuracy, nothing_compiles):
    response, sentence = RESPONSES[name]
    with pytest.raises(ValueError, match=f'response "wanted" .*{sentence}'):
        problem(response, accuracy=accuracy)


def mass(rig):
    return rig.bodies["rod"].mass


def inertia(rig):
    return rig.bodies["rod"].inertia[0]


# Where a variable points, what it derives, and the sentence.
POINTS = {
    'variable "rod".*gives 0.42. It computes': (lambda rig: 2 * mass(rig),),
    'variable "rod".*It computes, and what is computed': (lambda rig: sum(rig.bodies["rod"].com),),
    'variable "rod".*gives 0.21. It computes': (lambda rig: float(mass(rig)),),
    'variable "rod".*points at nothing.*Did you mean "rod"': (lambda rig: rig.bodies["rodd"].mass,),
    'variable "rod".*gives a Body': (lambda rig: rig.bodies["rod"],),
    "must be one number": (mass, (lambda rig: 1 * inertia(rig), mass)),
    'place of what.*Did you mean "rod"': (mass, (lambda rig: rig.bodies["rodd"].mass, mass)),
    'what variable "rod" derives fails with KeyError': (
        mass,
        (inertia, lambda rig: rig.bodies["rodd"].mass),
    ),
}


@pytest.mark.parametrize("sentence", POINTS)
def test_a_variable_that_sets_no_number_is_refused_by_its_name(sentence, nothing_compiles):
    where, *derived = POINTS[sentence]
    with pytest.raises(ValueError, match=sentence):
        problem(lambda run: run.ended, jc.Variable(where, tolerance=1e-3, derived=derived))


# Of a normal distribution with a deviation of a clearance, 16 % (below -1 deviation) lie below 0.
LOST = {
    "metres in the place of micrometres": (jc.Variable, 20.0, "50 %"),
    "a deviation as large as the clearance": (jc.distribution.Normal, 0.2e-3, "16 %"),
}


@pytest.mark.parametrize("name", LOST)
def test_a_distribution_beyond_what_its_number_can_be_is_warned_about(name):
    kind, size, share = LOST[name]
    where = lambda rig: rig.connections["B"].joint.clearance
    named = kind is jc.Variable
    wide = kind(where, tolerance=size) if named else jc.Variable(where, kind(size))
    with pytest.warns(UserWarning, match=f"{share} of its distribution lie below 0 m") as said:
        problem(lambda run: run.ended, wide)
    assert len(said) == 1 and said[0].filename == __file__


@pytest.mark.filterwarnings("error::UserWarning")
def test_a_usual_tolerance_is_not_warned_about():
    where = lambda rig: rig.connections["B"].joint.clearance
    problem(lambda run: run.ended, jc.Variable(where, tolerance=0.1e-3))


def test_responses_of_positions_are_refused_by_their_names():
    asked = {"positions": {"O": np.linspace(0.0, 1.0, 2)}}
    for response, sentence in (
        (lambda found: float(found.body("rod").com[-1, 0]), "leaves JAX in"),
        (lambda found: found.body("rodd").com[-1, 0], 'no body "rodd"'),
    ):
        with pytest.raises(ValueError, match=f'response "wanted" .*{sentence}'):
            jc.PositionProblem(RIG, {"wanted": response}, {"rod": ROD}, **asked)


# Whatever a run tells a response may be asked of a sketch of one.
TOLD = {
    "peaks": lambda run: run.extremes.force[0] + run.extremes.indentation[0],
    "steps": lambda run: run.accepted_steps + run.stats.verdict,
    "outcome": lambda run: jnp.where(run.succeeded, run.ended, 0.0),
    "coordinates": lambda run: run.coordinate("O").sum() + run.speed("O").sum(),
    "reactions": lambda run: jnp.max(run.reaction("A").force),
    "impulse": lambda run: run.contact_impulse("B")[-1],
    "drift": lambda run: sum(map(jnp.max, run.drift().values()), 0.0),
    "a number of the mechanism": lambda run: run.mechanism.bodies["rod"].mass * run.ended,
    "events": lambda run: run.noted.counts.sum() + run.noted.times.sum(),
    "states": lambda run: run.states[-1, 0] + run.time[-1],
}


def test_a_sketch_tells_all_that_a_run_does():
    step = jc.integrator.FixedStep(2e-5)
    rod = {"rod": ROD}
    save = jc.Saving(3, events=4)
    asked = jc.Problem(RIG, TOLD, rod, duration=1e-4, save=save, integrator=step)
    found = jax.eval_shape(lambda values: asked.evaluate(values), asked.nominal())
    assert set(found.responses) == set(TOLD)


def test_an_accuracy_may_be_asked_of_rigid_contact():
    """Responses are not tried on explicit steps, which have no force law there."""
    rig = jc.scenes.slider_crank(contact=jc.contact.Rigid(restitution=0.0))
    response = jc.response.MeanContactForce("B")
    assert jc.Problem(rig, response, {}, duration=1e-3, accuracy=0.05).response_names
