"""A settled cycle: periodic where it is, and means with their noise where it is not."""

import equinox as eqx
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.scenes.slider_crank import slider_crank
from jaxclear.studies.life.settling import correlation_factor, standard_error
from tests.rigs.refusals import refusals
from tests.rigs.wearing_ring import SAVES, TURN, ClosedForm, problem, wearing_ring

PERIOD = 2 * np.pi / 50


@pytest.fixture(scope="module")
def ring():
    return jc.steady_cycle(problem(wearing_ring()), tolerance=1e-6)


def test_a_journal_that_falls_into_its_place_settles_there(ring):
    """What the periodic turn wears is that of the closed form; the first one wears otherwise."""
    assert ring.periodic and 1 < ring.cycles < 5
    assert f"Periodic after {ring.cycles} cycles" in ring.sentence()
    wanted = ClosedForm().rate(0.0)
    first, last = (float(np.mean(ring.settling.cycles[i].wore["B"]["bearing"])) for i in (0, -1))
    # A turn wears 3e-11 m, by which the force falls by 3e-6 of itself.
    assert last == pytest.approx(wanted, rel=1e-5)
    assert abs(first / wanted - 1) > 1e-5
    np.testing.assert_allclose(ring.wear["B"]["bearing"], wanted, rtol=1e-5)
    assert float(ring.noise["B"]["bearing"].max()) == 0.0
    assert ring.responses["force"] == pytest.approx((ClosedForm().force_at(0.0), 0.0), rel=1e-5)


def test_a_settled_cycle_says_the_means_of_its_responses(ring):
    lines = str(ring).splitlines()
    for name, (value, _) in ring.responses.items():
        [line] = [one for one in lines if one.startswith(f'"{name}" of a cycle: ')]
        assert float(line.split(": ")[1].split(" ±")[0].strip("(")) != 0 or value == 0


@pytest.mark.slow
def test_a_cycle_is_the_run_that_simulate_makes(ring):
    own = {"save": SAVES, "integrator": ring.problem.integrator}
    state = None
    for one in ring.settling.cycles:
        run = jc.simulate(ring.problem.mechanism, TURN, state=state, **own)
        np.testing.assert_allclose(
            run.worn["B"]["bearing"], one.wore["B"]["bearing"], rtol=1e-6, atol=1e-19
        )
        state = jc.State(motion=run.state().motion)


def test_a_run_goes_on_from_the_settled_cycle(ring):
    """On the surfaces on which that began, a turn later: the same once more."""
    again = jc.steady_cycle(problem(wearing_ring(), state=ring.state), tolerance=1e-6)
    assert again.cycles == 1
    assert float(again.run.time[0]) == pytest.approx(ring.cycles * TURN)
    np.testing.assert_allclose(again.wear["B"]["bearing"], ring.wear["B"]["bearing"], rtol=1e-9)
    table = ring.table()
    assert len(table) == ring.cycles and table["taken"].sum() == 1 and table["taken"].iloc[-1]
    assert table["apart"].iloc[-1] <= 1e-6 < table["apart"].iloc[0]
    assert "journal" in table["most"].iloc[0] and "B bearing [m^3]" in table


def test_whole_turns_are_no_change_of_place():
    """The crank has turned once, and the rod against it; the second half of a turn is no period."""
    found = jc.steady_cycle(slider_crank("ideal"), PERIOD, tolerance=1e-9)
    assert found.periodic and found.cycles == 1
    turned = found.run.coordinate("A")
    assert abs(float(turned[-1] - turned[0])) == pytest.approx(2 * np.pi)
    with pytest.raises(ValueError, match=r'joint "O" moves it by 6\.25 rad in a period of 0\.125'):
        jc.steady_cycle(slider_crank("ideal"), 0.125, cycles=2)


def test_cycles_given_as_a_period_are_refused_before_anything_runs_or_said():
    rig = slider_crank(clearance=1e-4)
    for study in (jc.steady_cycle, lambda *given: jc.wear_life(*given, cycles=10)):
        with pytest.raises(ValueError, match="cycles are given by name"):
            study(rig, 1e5)
    said = r"repeat after 0\.05 s already, 20 times in the period of"
    with pytest.warns(UserWarning, match=said):
        jc.steady_cycle(wearing_ring(), 1.0, cycles=1, throw=False)


@pytest.mark.slow
def test_chaotic_motion_is_known_by_means():
    """A journal that rattles ends no cycle as it began it. Two halves of many cycles have means
    that agree within what their noise says."""
    rig = slider_crank(clearance=1e-3, wear=True)
    found = jc.steady_cycle(rig, PERIOD, cycles=40)
    assert not found.periodic and found.settling.measured == 20
    assert "Not periodic after 40 cycles" in found.sentence() and "20 cycles" in found.sentence()
    other = jc.steady_cycle(rig, PERIOD, cycles=40, state=found.state)
    for name, (mean, error) in found.responses.items():
        theirs, own = other.responses[name]
        assert 0 < error < mean, name
        assert abs(theirs - mean) < 4 * np.hypot(error, own), name


def test_a_correlated_series_has_a_larger_error():
    """Where neighbours correlate by 0.6, means over 400 scatter twice as much."""
    rng, alike, length = np.random.default_rng(1), 0.6, 400
    series = np.zeros((200, length))
    series[:, 0] = rng.normal(size=200)
    for i in range(1, length):
        series[:, i] = alike * series[:, i - 1] + np.sqrt(1 - alike**2) * rng.normal(size=200)
    told = [correlation_factor(own) * standard_error(own) for own in series]
    assert np.mean(told) == pytest.approx(series.mean(axis=1).std(ddof=1), rel=0.15)


def test_a_cycle_that_fails_says_so():
    """A step far too long for the contact."""
    bad = eqx.tree_at(lambda p: p.integrator.step, problem(wearing_ring()), np.asarray(2e-3))
    found = jc.steady_cycle(bad, throw=False)
    assert not found.periodic and found.sentence().startswith("Cycle 1: the run of a cycle ended")
    with pytest.raises(jc.SimulationError, match="the run of a cycle ended early"):
        jc.steady_cycle(bad)


test_what_cannot_be_asked_is_refused = refusals(
    {
        r"needs its period \[s\]": lambda: jc.steady_cycle(wearing_ring()),
        "given a Problem, whose duration": lambda: jc.steady_cycle(problem(wearing_ring()), 0.05),
        "must be a Mechanism or a Problem": lambda: jc.steady_cycle("ring", 0.05),
        "cycles of steady_cycle is 0": lambda: jc.steady_cycle(wearing_ring(), 0.05, cycles=0),
        r"A turn of it takes 0\.05 s; cycles are": lambda: jc.steady_cycle(
            wearing_ring(), 1e5 + 0.02
        ),
        "tolerance of steady_cycle is -1": lambda: jc.steady_cycle(
            wearing_ring(), 0.05, tolerance=-1
        ),
    }
)
