"""What a run with replicas holds and says: of any response, of any integrator, of odd runs; and
that it is the same run without them."""

import math
import pickle

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.errors import verification
from jaxclear.errors.estimates import Verified
from jaxclear.errors.verification import MOST_STEPS, refine_times, step_taken, thin_run
from jaxclear.integrators.base import REFERENCE
from jaxclear.integrators.checks import Outcome
from jaxclear.native import stop
from jaxclear.simulation import progress
from jaxclear.simulation import simulate as simulating
from tests.rigs.falling_journal import touching_journal

pytestmark = pytest.mark.verified
STEPS = jc.integrator.FixedStep(1e-3, "heun")


def pendulum(speed=1.0):
    joint = jc.Connection(jc.joint.Revolute(), "ground", "rod")
    rod = {"rod": jc.Body(1.0, 0.1, (0.0, -0.5))}
    return jc.Mechanism(rod, {"O": joint}, {"g": jc.load.Gravity()}, speeds={"O": speed})


def swing(**kwargs):
    return jc.simulate(pendulum(), 0.5, **({"save": 6, "integrator": STEPS} | kwargs))


def last(run):
    return run.coordinate("O")[-1]


@pytest.fixture(scope="module")
def verified():
    return swing(verify=True)


@pytest.fixture(scope="module")
def worn():
    """A journal that bounces and wears, whose replicas are saved more often."""
    steps = jc.integrator.FixedStep(2e-5)
    saving = jc.Saving(11, events=3)
    return jc.simulate(touching_journal(), 0.03, save=saving, integrator=steps, verify=True)


def test_a_run_with_replicas_is_the_run_without_them_bit_for_bit(verified, worn):
    plain = swing(verify=False)
    steps, saving = jc.integrator.FixedStep(2e-5), jc.Saving(11, events=3)
    alone = jc.simulate(touching_journal(), 0.03, save=saving, integrator=steps, verify=False)
    for one, other in ((verified, plain), (worn, alone)):
        same = eqx.tree_at(lambda run: run.verification, one, other.verification)
        for a, b in zip(jax.tree.leaves(same), jax.tree.leaves(other), strict=True):
            np.testing.assert_array_equal(a, b)


def test_what_counts_in_gaps_is_asked_of_integrators_that_heed_it(monkeypatch):
    """Each program that is called costs a run as much as its first steps."""
    asked, counting = [], verification._counting
    monkeypatch.setattr(
        verification, "_counting", lambda *of: asked.append(type(of[0])) or counting(*of)
    )
    for steps in (jc.integrator.FixedStep(1e-4), jc.integrator.Adaptive()):
        jc.simulate(touching_journal(), 1e-3, save=3, integrator=steps, verify=True)
    assert asked == [jc.integrator.Adaptive]


RESPONSES = {
    "a number": (last, True),
    "an array": (lambda run: run.coordinate("O"), True),
    "a collection": (lambda run: {"steps": int(run.accepted_steps), "end": [last(run)]}, True),
    "a truth": (lambda run: last(run) > 0, True),
    "a text": (lambda run: "off", "the answer is no number"),
    "nothing": (lambda run: None, "the answer is no number"),
    "no number": (lambda run: math.nan, "not finite"),
    "without bound": (lambda run: math.inf * last(run), "not finite"),
    "as long as steps are many": (lambda run: jnp.zeros(int(run.accepted_steps)), "another form"),
    "of this run alone": (lambda run: {500: 1.0}[int(run.accepted_steps)], "the same fails: 1000"),
}


@pytest.mark.parametrize("name", RESPONSES)
def test_whatever_is_drawn_from_a_run_has_an_error_or_why_not(name, verified):
    response, known = RESPONSES[name]
    found = verified.estimate(response)
    assert str(found) and jax.tree.structure(found.value) == jax.tree.structure(response(verified))
    if known is True:
        assert found.why == "twice the change with half the step"
        same = lambda value, error: np.shape(value) == np.shape(error) and np.all(error >= 0)
        assert all(jax.tree.leaves(jax.tree.map(same, found.value, found.error)))
    else:
        assert known in found.why and math.isnan(found.error)


def test_what_nobody_has_looked_at_says_so_and_what_is_no_response():
    run = swing(verify=False)
    with pytest.raises(ValueError, match="it must be a response, such as"):
        run.estimate("mean force")
    assert "Not verified: verify=False." in str(run)
    found = run.estimate(last)
    assert found.value == last(run) and math.isnan(found.error)
    assert str(found).endswith("(not verified: verify=False)")
    assert len(run.verification.table()) == 0


def test_long_runs_have_replicas_where_they_are_asked_for():
    long = {"save": 3, "integrator": jc.integrator.FixedStep(4e-6, "heun")}
    run = swing(**long)
    assert run.accepted_steps > MOST_STEPS == 100_000
    assert "Not verified: beyond 100000 steps replicas are run with verify=True." in str(run)
    assert np.isfinite(swing(**long, verify=True).estimate(last).error)


def test_a_traced_run_has_none():
    whole = lambda speed: jc.simulate(
        pendulum(speed), 0.5, save=6, integrator=STEPS, throw=False, verify=True
    )
    end = lambda speed: last(whole(speed))
    assert "traced" in str(jax.jit(whole)(1.0).verification)
    assert np.isfinite(jax.grad(end)(1.0))
    assert jax.vmap(end)(jnp.array([0.5, 1.0]))[1] == pytest.approx(float(end(1.0)), rel=1e-12)


def test_responses_see_a_replica_at_the_saving_times_of_the_run(worn):
    (half, *_) = worn.verification.replicas
    np.testing.assert_array_equal(half.time, worn.time)
    assert half.worn_volume("B", "bearing").shape == worn.time.shape
    touches = worn.estimate(lambda run: run.events()["time [s]"].iloc[0])
    assert 0 < touches.value < 0.03 and touches.error < 1e-5
    assert half.noted.counts.sum() == worn.noted.counts.sum()
    (rarer, own) = thin_run(worn, 2), worn.noted
    np.testing.assert_array_equal(rarer.noted.counts, own.counts[::2] + own.counts[1::2])
    assert rarer.events().equals(worn.events()) and len(rarer.time) == 6
    wear = worn.estimate(jc.response.WornVolume("B"))
    assert wear.error < 0.1 * wear.value


def test_saving_times_side_by_side_do_not_decide_how_long_steps_are():
    times = [0.1, 0.2, 0.2 + 1e-9, 0.5]
    run = swing(save=times, verify=True)
    (half,) = run.verification.replicas
    np.testing.assert_array_equal(half.time, run.time)
    assert 1.9 * run.accepted_steps < half.accepted_steps < 2.1 * run.accepted_steps
    assert step_taken(np.array([0.0, 1.0, 1.0 + 1e-9]), 0.3) == pytest.approx(0.25)
    np.testing.assert_array_equal(refine_times(np.array([0.0, 1.0, 3.0]), 2), [0, 0.5, 1, 2, 3])


def test_steps_that_saving_shortens_are_halved_as_they_were_taken():
    with pytest.warns(UserWarning, match="longer steps than"):
        run = swing(save=501, integrator=jc.integrator.FixedStep(1.5e-3, "heun"), verify=True)
    (half,) = run.verification.replicas
    assert (run.accepted_steps, half.accepted_steps) == (500, 1000)


def test_counted_steps_keep_their_number_and_double_their_saves():
    steps = jc.integrator.FixedStep(1.0, "heun", steps_per_save=10)
    run = swing(save=11, integrator=steps, verify=True)
    (half,) = run.verification.replicas
    assert (run.accepted_steps, half.accepted_steps) == (100, 200)
    np.testing.assert_array_equal(half.time, run.time)
    tight = jc.integrator.Adaptive(rtol=1e-11, atol=1e-13)
    true = abs(float(last(run) - last(swing(integrator=tight, verify=False))))
    assert 0.5 * true < run.estimate(last).error < 10 * true


def test_tolerances_as_tight_as_numbers_allow_are_not_said_to_be_without_error():
    run = swing(integrator=jc.integrator.Adaptive(rtol=1e-12, atol=1e-14), verify=True)
    assert str(run.verification) == "Not verified: its steps cannot be refined."
    held = jc.integrator.Adaptive(rtol=1e-6, atol=1e-6, largest_step=0.02)
    assert swing(save=2, integrator=held, verify=True).estimate(last).error > 0


def test_what_goes_on_tells_since_when_its_error_counts(verified):
    run = swing(state=verified.state(), verify=True)
    assert run.estimate(last).why == "twice the change with half the step, since 0.5 s"


def others(monkeypatch, second):
    """What is run after the run itself is `second(run)`."""
    own, told = simulating._run_soon, []

    def runs(*given):
        told.append(own(*given))
        return told[-1] if len(told) == 1 else second(told[-1])

    monkeypatch.setattr(simulating, "_run_soon", runs)


def test_a_replica_that_fails_says_so_and_leaves_the_run(monkeypatch, verified):
    infinite = jnp.asarray(int(Outcome.NOT_FINITE))
    others(monkeypatch, lambda run: eqx.tree_at(lambda run: run.outcome, run, infinite))
    run = swing(verify=True)
    assert run.succeeded and "With shorter steps the same run fails" in run.result
    np.testing.assert_array_equal(run.states, verified.states)
    assert math.isnan(run.estimate(last).error)


INTERRUPTED, NO_ROOM = "interrupted", "a replica could not be run: out of memory"


# None: Ctrl-C while a kernel runs.
@pytest.mark.parametrize("error", [KeyboardInterrupt, None, MemoryError])
def test_what_stops_a_replica_keeps_the_run(error, monkeypatch, verified):
    def stopped(run):
        if error is not None:
            raise error
        stop()
        return run

    others(monkeypatch, stopped)
    run = swing(verify=True)
    why = NO_ROOM if error is MemoryError else INTERRUPTED
    assert str(run.verification) == f"Not verified: {why}." and run.warnings == ()
    np.testing.assert_array_equal(run.states, verified.states)


class Bar:
    """What a bar shows."""

    def __init__(self, total, **layout):
        self.total, self.n, self.shares = total, 0.0, []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def unpause(self):
        pass

    def update(self, more):
        self.n += more
        self.shares.append(self.n / self.total)


@pytest.mark.parametrize("doubt", [0.5, 0.0])
def test_one_bar_shows_the_run_and_its_replicas(doubt, monkeypatch):
    bars = []
    monkeypatch.setattr(progress, "tqdm", lambda **given: bars.append(Bar(**given)) or bars[-1])
    monkeypatch.setattr("jaxclear.errors.verification.DOUBT", doubt)
    run = swing(progress_bar=True)
    (bar,) = bars
    assert len(run.verification.replicas) == (1 if doubt else 2)
    assert bar.total == pytest.approx(3.0 if doubt else 7.0, abs=0.1)
    assert max(bar.shares[:-1]) < 1.0 == bar.shares[-1] and bar.shares[4] < 0.4
    swing(progress_bar=True, verify=False)
    assert bars[-1].total == 1.0


def test_a_kept_run_keeps_its_replicas(verified):
    kept = pickle.loads(pickle.dumps(verified))
    assert str(kept) == str(verified)
    assert kept.estimate(last).error == verified.estimate(last).error
    assert "numerical errors" in kept.to_dataset().attrs


def test_a_run_with_replicas_is_a_tree_of_numbers(verified):
    """So it goes through `jax.jit`, and runs of other numbers through the same program."""
    traces = []
    error = jax.jit(lambda run: traces.append(0) or run.estimate(last).error)
    faster = jc.simulate(pendulum(1.5), 0.5, save=6, integrator=STEPS)
    for run in (verified, faster):
        assert error(run) == pytest.approx(run.estimate(last).error, rel=1e-12)
    assert len(traces) == 1


def test_a_table_fits_a_screen_and_a_sentence_a_line(worn):
    lines = str(worn).splitlines()
    table = lines[lines.index(next(line for line in lines if line.startswith("quantity"))) :]
    assert max(map(len, table)) <= 80
    rows = worn.verification.table()
    assert list(rows.quantity)[-1] == 'worn depth, "B, bearing"' and (rows.error >= 0).all()
    names = (("peak contact force", "peak_force", "crank pin", "N"),) * 3
    numbers, lost = np.array([[1e3, 300.0, 0.3, 0.05]] * 3), np.zeros(3, bool)
    path, begun = np.array([0.3, 0.029]), np.zeros(())
    given = (), numbers, lost, path, begun, REFERENCE, names, "take shorter steps"
    verified = Verified(*given)
    said = [*verified.notes, *verified.warnings]
    assert len(said) == 2 and max(len(sentence.split()) for sentence in said) <= 26
    # Steps do not help a chaotic path; another does what the integrator advises.
    assert said[1].endswith(
        ", and 2 more answers; the path is chaotic, so take means over samples."
    )
    settled = Verified((), numbers, lost, None, *given[4:])
    assert settled.warnings[0].endswith(", and 2 more answers; take shorter steps.")


def test_a_mean_above_its_peak_is_explained():
    """A journal that touches at both ends: means are sums over its contacts."""
    names = (
        ("mean contact force", "mean_force", "B", "N"),
        ("peak contact force", "peak_force", "B", "N"),
    )
    for mean, says in ((249.0, True), (120.0, False)):
        numbers = np.array([[mean, 0.1, 4e-4, 0.1], [196.0, 0.1, 5e-4, 0.5]])
        lost = np.zeros(2, bool)
        shown = str(
            Verified((), numbers, lost, None, np.zeros(()), REFERENCE, names, "take shorter")
        )
        assert ("sums over a joint's contacts" in shown) is says


def test_a_place_that_is_off_by_the_gap_is_anywhere_in_it():
    names = (("places in the gap", "gaps", "B", "m"),)
    for error, says in ((5e-4, True), (1e-5, False)):
        numbers, none = np.array([[2e-4, error, error / 2e-4, 0.05]]), np.zeros(1, bool)
        shown = Verified((), numbers, none, None, np.zeros(()), REFERENCE, names, "shorter steps")
        assert ("anywhere in the gap" in str(shown)) is says
        assert "in a gap the clearance." in str(shown)


def odd():
    still = jc.Mechanism(
        {"rod": jc.Body(1.0, 0.1, (0.0, -0.5))},
        {"O": jc.Connection(jc.joint.Revolute(), "ground", "rod")},
    )
    drive = jc.joint.Revolute(drive=jc.drive.ConstantSpeed(10.0))
    driven = still.with_joint("O", drive)
    bearing = jc.clearance.PlanarJournalBearing(jc.contact.Hertz(), clearance=1e-3)
    joint = {"B": jc.Connection(bearing, "ground", "journal")}
    floating = jc.Mechanism({"journal": jc.Body(1.0, 1e-3)}, joint)
    return {"nothing moves": still, "drives alone": driven, "no force": floating}


@pytest.mark.parametrize("name", odd())
def test_runs_of_which_there_is_little_to_tell_say_nothing(name):
    run = jc.simulate(odd()[name], 0.01, save=2)
    assert run.warnings == () and not run.verification.beyond
    assert all(told.error == told.share == 0 for told in run.verification.entries)
