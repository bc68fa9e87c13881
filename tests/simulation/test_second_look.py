"""A run in doubt is gone through again with shorter steps, and says where they change it."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.integrators import Check, Checks
from jaxclear.integrators.figures import Figure
from jaxclear.results.response import concerned
from jaxclear.simulation import doubts, second_look, two_runs
from tests.rigs.attacked import run_of


@pytest.fixture(scope="module")
def pushed():
    """A slider pushed to and fro in its guide: forty impacts, each of them resolved."""
    return lambda step: run_of(23, 8, jc.integrator.FixedStep(step), balance=True)


def offset(run):
    """Across the guide, beside the clearance."""
    (name,) = run.mechanism.topology.clearances
    joint = run.mechanism.connections[name].joint
    return np.asarray(run.contact(name).offset)[:, 0] / float(joint.clearance)


def test_a_body_that_is_elsewhere_in_its_gap_is_said_and_mean_forces_stand(pushed):
    """Beside steps an eighth as long it is a tenth of the clearance off; steps of a third are
    right, and say nothing. No other figure tells."""
    exact = offset(pushed(2.5e-6))
    found, right = pushed(2e-5), pushed(5e-6)
    assert np.abs(offset(found) - exact).max() > 0.05
    assert np.abs(offset(right) - exact).max() < 0.02
    assert {check for check, flag in found.checks.beyond().items() if flag} == {Check.PLACE_IN_GAP}
    assert "elsewhere in their gap" in found.result and right.warnings == ()
    # The windows look at what presses in the joint itself.
    pressed = found.checks.figures[Check.HALVED_CONTACT_FORCES]
    assert pressed.places == ("G",) and pressed.worst[0] < 0.01
    concerns = Check.PLACE_IN_GAP.concerns
    assert not concerned(jc.response.MeanContactForce("G"), concerns)
    assert concerned(jc.response.PeakWornDepth("G"), concerns)


def test_forces_at_an_instant_are_no_matter_of_a_mean_force():
    """Of which the windows tell by the impulses of contacts."""
    mean, peak = jc.response.MeanContactForce("G"), jc.response.PeakContactForce("G")
    instant, impulses = Check.HALVED_FORCES.concerns, Check.HALVED_CONTACT_FORCES.concerns
    assert concerned(peak, instant) and not concerned(mean, instant)
    assert concerned(peak, impulses) and concerned(mean, impulses)


def test_what_hardly_wears_is_not_compared():
    """Less than an atom in a thousand million runs, or a millionth of what wears elsewhere."""
    of = lambda one, other, least: two_runs._beside(np.array([one, other]), np.array(least))
    np.testing.assert_allclose(of([1e-36], [2e-36], [1e-21]), 0.0, atol=1e-14)
    np.testing.assert_allclose(of([1e-12, 1e-18], [1e-12, 2e-18], [1e-21] * 2), 0.0, atol=2e-3)
    np.testing.assert_allclose(of([1e-12, 1e-14], [1e-12, 2e-14], [1e-21] * 2), [0.0, 0.5])


def test_a_second_look_leaves_the_numbers_and_comes_only_in_doubt(pushed, monkeypatch):
    found = pushed(2e-5)
    monkeypatch.setattr(doubts, "DOUBTS", {Check.IMPACT_STEP: 20.0})
    monkeypatch.setattr(doubts, "ELASTIC", 1.0)
    monkeypatch.setattr(doubts, "BRIEF", 0)
    once = pushed(2e-5)
    assert Check.PLACE_IN_GAP not in once.checks.figures
    np.testing.assert_array_equal(found.states, once.states)


def test_a_brief_run_is_looked_at_again_whatever_its_figures(pushed, monkeypatch):
    """A longer one is not where none tells, nor one that meets no contact, nor `Adaptive`."""
    monkeypatch.setattr(doubts, "DOUBTS", {})
    monkeypatch.setattr(doubts, "ELASTIC", 1.1)
    run, step = pushed(2e-5), jc.integrator.FixedStep(2e-5)
    coordinates = run.mechanism.topology.coordinate_count

    def looked(run, integrator=step):
        asked = []
        second_look.looked_at_again(run, integrator, lambda finer, *_: asked.append(finer) or run)
        return bool(asked)

    def taking(steps):
        stats = dataclasses.replace(run.stats, accepted_steps=steps)
        return dataclasses.replace(run, stats=stats)

    longest = doubts.BRIEF // coordinates
    assert looked(run) and looked(taking(longest)) and not looked(taking(longest + 1))
    assert not looked(run, jc.integrator.Adaptive())
    depths = run.checks.figures[Check.INDENTATION]
    apart = dataclasses.replace(depths, worst=np.zeros(depths.worst.shape))
    checks = Checks.of(run.checks.figures | {Check.INDENTATION: apart})
    assert not looked(dataclasses.replace(run, checks=checks))


@pytest.mark.slow
def test_what_few_steps_of_low_order_make_of_impacts_is_said():
    """A four-bar in 200 steps of "heun": a journal is a third of its clearance off where
    indentations rise by less than a twentieth in a step."""
    found = run_of(19, 29, jc.integrator.FixedStep(4.14e-05, "heun"), balance=True)
    assert found.checks.figures[Check.IMPACT_STEP].worst.max() < 0.05
    assert "elsewhere in their gap" in found.result


def test_runs_of_many_steps_and_steps_that_are_counted_are_not_gone_through_again(pushed):
    run = pushed(2e-5)
    stats = dataclasses.replace(run.stats, accepted_steps=10**9)

    def again(finer):
        raise AssertionError("gone through again")

    step = jc.integrator.FixedStep(2e-5)
    counted = jc.integrator.FixedStep(steps_per_save=3)
    for one, integrator in (
        (dataclasses.replace(run, stats=stats), step),
        (run, counted),
        (dataclasses.replace(run, checks=Checks()), step),
    ):
        assert second_look.looked_at_again(one, integrator, again) is one
    with pytest.raises(AssertionError, match="again"):
        second_look.looked_at_again(run, step, again)


@pytest.mark.slow
def test_impacts_that_a_second_look_finds_right_are_not_accused_of_their_steps():
    """Indentations rise by more than the limit within a step, and the few impacts are right."""
    run = run_of(16, 2, jc.integrator.FixedStep())
    assert run.warnings == () and Check.IMPACT_STEP not in run.checks.figures
    assert run.checks.figures[Check.PLACE_IN_GAP].worst.max() < 0.01


def test_it_takes_a_quarter_of_the_steps_that_saving_times_have_left(pushed):
    """Steps end at every saving time: a quarter of one that was asked for may be the same run."""
    run, asked = pushed(2e-5), []

    def again(finer):
        asked.append(float(finer.step))
        return run

    interval = float(run.time[1])
    for step in (2e-5, 0.6 * interval, 0.5):
        second_look.looked_at_again(run, jc.integrator.FixedStep(step), again)
    shares = interval / np.array(asked)
    assert shares == pytest.approx([4 * np.ceil(interval / 2e-5), 8, 4])


def rising(run, figure, factor=1.0):
    """The run with another figure of its steps in contact, its forces so many times as large."""
    steps = Figure(np.full(4, figure), np.zeros(4), ("G",) * 4)
    checks = Checks.of(run.checks.figures | {Check.CONTACT_STEP: steps})
    model = run.history.model()
    place = model.layout.impulse_start + model.layout.impulses_of("G").start
    history = dataclasses.replace(run.history, states=run.states.at[:, place].multiply(factor))
    return dataclasses.replace(run, checks=checks, history=history)


@pytest.mark.parametrize(
    ("finer", "factor", "said"),
    [
        (0.3, 1.0, []),
        (0.9, 1.0, [Check.CONTACT_STEP]),
        (0.3, 1.1, [Check.CONTACT_STEP, Check.MEAN_FORCE]),
    ],
    ids=["resolved and the same", "not resolved", "other forces"],
)
def test_steps_in_contact_are_accused_unless_steps_that_resolve_it_change_nothing(
    pushed, finer, factor, said
):
    run = pushed(5e-6)
    looked = lambda of: second_look.looked_at_again(
        rising(run, 0.9), jc.integrator.FixedStep(5e-6), lambda *_: of
    )
    found = looked(rising(run, finer, factor))
    assert sorted(check for check, flag in found.checks.beyond().items() if flag) == said
    # Where nothing tells what friction takes, nothing is known to be right.
    silent = dataclasses.replace(run.history, balanced=False)
    run = dataclasses.replace(run, history=silent)
    assert Check.CONTACT_STEP in looked(rising(run, finer, factor)).checks.figures
    # Nor does the wear of another joint tell of it, only its own.
    known = {Check.MEAN_FORCE: 0.0, Check.HALVED_WEAR: 0.0}
    for joint, right in (("another", set()), ("G", {"G"} if factor == 1.0 else set())):
        worn = {joint: {"bearing": np.ones((3, 1))}}
        one, other = (dataclasses.replace(each, worn=worn) for each in (run, run))
        other = rising(other, finer, factor)
        assert second_look._right_joints(one, other, known) == right


def test_a_joint_is_cleared_of_its_own_steps_alone():
    """Those of others stay accused, as does a joint that the steps of the other run leave as it
    was."""
    places = ("A", "B", "B", "C")
    steps = Figure(np.array([0.9, 0.5, 0.95, 0.2]), np.arange(4.0), places)

    def left(worst, right):
        checks = Checks.of({Check.CONTACT_STEP: Figure(np.array(worst), np.arange(4.0), places)})
        other = SimpleNamespace(checks=checks)
        found = second_look._accused(steps, Check.CONTACT_STEP, other, right)
        return None if found is None else list(zip(found.places, found.worst, strict=True))

    assert left([0.3] * 4, {"A", "B", "C"}) is None
    assert left([0.3] * 4, {"A", "C"}) == [("B", 0.5), ("B", 0.95)]
    assert left([0.9, 0.3, 0.3, 0.3], {"A", "B", "C"}) == [("A", 0.9)]


def test_bodies_that_are_elsewhere_are_said(pushed, monkeypatch):
    """Their ways are those of the centres of mass, beside the longest or a hundred clearances."""
    run = pushed(5e-6)
    rows = np.unique(np.linspace(0, 199, 50).round().astype(int)) + 1
    gone = [np.asarray(run.body(name).com) for name in run.mechanism.bodies]
    gone = np.concatenate(gone, axis=1)[[0, *rows]]
    gone = gone - gone[0]
    was = two_runs.whereabouts(run.history)
    np.testing.assert_allclose(was.gone, gone, atol=1e-12)
    (name,) = run.mechanism.topology.clearances
    clearance = float(run.mechanism.connections[name].joint.clearance)
    assert was.way >= max(np.abs(gone).max(), 100 * clearance) * (1 - 1e-9)

    def looked(was, off, longer=1.0):
        other = was._replace(gone=longer * was.gone + off * was.way, way=longer * was.way)
        found = looked_at(run, elsewhere(monkeypatch, run, was, other))
        return {check for check, flag in found.checks.beyond().items() if flag}

    assert looked(was, 0.03) - looked(was, 0.01) == {Check.HALVED_MOTION}
    # All of it longer by a twentieth: both are measured by the same way. One that is a hundred
    # clearances long is not longer for what goes on in it.
    was = was._replace(gone=was.gone * float(was.way) / np.abs(was.gone).max())
    assert looked(was, 0.0, 1.05) - looked(was, 0.0, 1.01) == {Check.HALVED_MOTION}


def elsewhere(monkeypatch, run, here, there):
    """Another run, which was there where this one was here."""
    other = dataclasses.replace(run, history=dataclasses.replace(run.history))
    were = lambda history: there if history is other.history else here
    monkeypatch.setattr(two_runs, "whereabouts", were)
    return other


def looked_at(run, other):
    """The run as a second look leaves it that finds the other."""
    doubted = rising(run, 0.06)
    return second_look.looked_at_again(doubted, jc.integrator.FixedStep(5e-6), lambda *_: other)


@pytest.mark.parametrize(
    ("place", "factor", "said"),
    [
        (0.0, 1.03, set()),
        (0.1, 1.01, {Check.PLACE_IN_GAP}),
        (0.1, 1.03, {Check.PLACE_IN_GAP, Check.PARTED_FORCE}),
    ],
)
def test_mean_forces_of_paths_that_have_parted_are_held_to_less(
    pushed, place, factor, said, monkeypatch
):
    run = pushed(5e-6)
    was = two_runs.whereabouts(run.history)
    parted = was._replace(places=was.places + place)
    found = looked_at(run, elsewhere(monkeypatch, rising(run, 0.06, factor), was, parted))
    assert {check for check, flag in found.checks.beyond().items() if flag} == said


@pytest.mark.parametrize(("finer", "cleared"), [(0.29, True), (0.31, False)])
def test_creep_is_cleared_by_steps_that_resolve_the_vibration_of_a_contact(finer, cleared):
    """Not by those that are within the limit of a run alone (0.1 rad): 14 of 50 right runs of
    ImplicitStep that warned warned of creep and of nothing else (benchmarks/attack.py)."""
    own, other = (Figure(np.array([x]), np.zeros(1), ("A",)) for x in (0.9, finer))
    run = SimpleNamespace(checks=Checks.of({Check.CREEP_STEP: other}))
    assert (second_look._accused(own, Check.CREEP_STEP, run, {"A"}) is None) == cleared


@pytest.mark.slow
def test_creep_is_not_cleared_by_wear_that_has_turned_back():
    """Of steps as long, a quarter and 0.4 as long 0.84, 0.83 and 0.80 of the wear of a tight run:
    two agree to 2 % (draw 59 of benchmarks/attack.py)."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Goldsmith(modulus=6.556617e10, restitution=0.2664978),
        jc.friction.Dahl(mu_kinetic=0.3459431, presliding=2.686971e-7),
        bearing_radius=5.953582e-3,
        clearance=1.275621e-5,
        length=1.514182e-2,
        bearing_wear=jc.Wearing(jc.wear.Fouvry(energy_wear_coefficient=2.951275e-14), (24, 1)),
    )
    journal = jc.Marker("journal")
    rig = jc.Mechanism(
        bodies={"journal": jc.Body(2.727172, 2.894551e-3)},
        connections={"B": jc.Connection(bearing, "ground", "journal")},
        loads={
            "load": jc.load.Force(journal, (0.0, -2569.382)),
            "torque": jc.load.Torque(journal, 0.6484809),
        },
    )
    run = lambda integrator: jc.simulate(rig, 0.04645, save=201, integrator=integrator)
    long, tight = (
        run(jc.integrator.ImplicitStep(2.84965e-5)),
        run(jc.integrator.Adaptive(rtol=1e-8)),
    )
    wear = lambda run: float(run.worn_volume("B", "bearing")[-1])
    assert wear(long) < 0.9 * wear(tight)
    assert any("creeps" in sentence for sentence in long.warnings)


@pytest.mark.parametrize(("vibrates", "asked"), [(0.05, False), (0.9, True)])
def test_losses_of_steps_that_follow_no_vibration_are_asked_for_once_more(
    vibrates, asked, monkeypatch
):
    figure = Figure(np.array([vibrates]), np.zeros(1), ("B",))
    run = SimpleNamespace(checks=Checks.of({Check.CREEP_STEP: figure}), succeeded=True)
    monkeypatch.setattr(second_look, "_in_steps", lambda *_: None)
    third = {Check.HALVED_WEAR: (np.array([0.09]), ("B",))}
    monkeypatch.setattr(second_look, "apart_by_check", lambda *_: third)
    agreed = {Check.HALVED_WEAR: (np.array([0.01]), ("B",))}
    integrator = jc.integrator.ImplicitStep(1e-5)
    found = second_look._apart_by_chance(agreed, run, integrator, lambda *_: run)
    assert found == (third if asked else {})


@pytest.mark.parametrize(
    ("finer", "factor", "dropped"),
    [(0.05, 1.0, True), (0.2, 1.0, False), (0.05, 1.1, False)],
    ids=["the same", "not within its limit", "other forces"],
)
def test_what_windows_say_of_forces_is_dropped_where_the_whole_run_has_the_same(
    pushed, finer, factor, dropped
):
    def with_window(run, figure):
        window = Figure(np.full(1, figure), np.zeros(1), ("slide",))
        checks = Checks.of(run.checks.figures | {Check.HALVED_FORCES: window})
        return dataclasses.replace(run, checks=checks)

    run = rising(pushed(5e-6), 0.2)
    other = with_window(rising(pushed(5e-6), 0.2, factor), finer)
    found = second_look.looked_at_again(
        with_window(run, 0.5), jc.integrator.FixedStep(5e-6), lambda _: other
    )
    assert (Check.HALVED_FORCES not in found.checks.figures) == dropped


@pytest.mark.parametrize(("deeper", "dropped"), [(1.005, True), (1.02, False)])
def test_impacts_are_right_only_where_their_peaks_are(pushed, deeper, dropped):
    """A run whose places agree, and whose deepest indentations are so many times as deep."""
    run = pushed(5e-6)
    figures = run.checks.figures
    depth = figures[Check.INDENTATION]
    steep = dataclasses.replace(depth, worst=np.full(depth.worst.shape, 0.5))
    other = dataclasses.replace(depth, worst=deeper * depth.worst)
    looked = second_look.looked_at_again(
        dataclasses.replace(run, checks=Checks.of(figures | {Check.IMPACT_STEP: steep})),
        jc.integrator.FixedStep(5e-6),
        lambda _: dataclasses.replace(run, checks=Checks.of(figures | {Check.INDENTATION: other})),
    )
    assert (Check.IMPACT_STEP not in looked.checks.figures) == dropped


@pytest.mark.parametrize(
    ("wear", "promised", "said"),
    [(0.03, True, True), (0.03, False, False), (0.01, True, False), (0.06, True, False)],
)
def test_wear_is_held_to_what_a_rung_promises(wear, promised, said):
    """Beyond a twentieth another check tells."""
    run = SimpleNamespace(history=SimpleNamespace(balanced=False))
    found = two_runs._losses_apart(run, run, (np.array([0.0, wear]), ("A", "B")), promised)
    assert set(found) == ({Check.FRICTION_LOSS} if said else set())


@pytest.mark.parametrize(("left", "said"), [(0.0, False), (0.25, True)])
def test_what_a_finer_run_of_low_order_is_off_by_as_well_counts(left, said):
    """Steps a quarter as long change wear by 1.9 %: of first order it is 2.5 % off."""
    run = SimpleNamespace(history=SimpleNamespace(balanced=False))
    found = two_runs._losses_apart(run, run, (np.array([0.019]), ("A",)), True, left)
    assert set(found) == ({Check.FRICTION_LOSS} if said else set())
    for integrator, wanted in (
        (jc.integrator.ImplicitStep(1e-5), 0.25),
        (jc.integrator.FixedStep(1e-5), 0.0),
        (jc.integrator.Adaptive(), 0.0),
    ):
        assert second_look._left(integrator, 0.25) == wanted


def test_forces_of_parted_paths_are_compared_on_the_way(monkeypatch):
    """Which give the same in the end by chance."""
    given = {"run": np.array([0.0, 1.0, 2.0]), "other": np.array([0.0, 1.5, 2.0])}
    monkeypatch.setattr(two_runs, "contact_impulse", lambda history, _: given[history])
    run, other = (SimpleNamespace(history=name) for name in given)
    found = two_runs._impulses_on_the_way(run, other, ("B",))
    np.testing.assert_allclose(found, [0.25])


@pytest.mark.slow
def test_mean_forces_that_hang_on_the_step_are_said():
    """A slider thrown between the walls of its guide: its impacts fall within steps that saving
    times have cut, and the mean force is off by a tenth. Only what a second look compares tells."""
    with pytest.warns(UserWarning, match="shortened"):
        run = run_of(22, 2, jc.integrator.ImplicitStep(8.5e-4))
    told = {check for check, flag in run.checks.beyond().items() if flag}
    assert told == {Check.MEAN_FORCE, Check.DEEPEST, Check.PEAK_FORCE}
    assert "mean of the contact forces" in run.result


@pytest.mark.slow
def test_wear_of_rigid_contact_that_hangs_on_the_step_is_said():
    """The windows see nothing; the deepest wear is off by two fifths."""
    run = run_of(14, 0, jc.integrator.MoreauJean(1e-4))
    assert run.checks.beyond()[Check.HALVED_WEAR] and Check.PLACE_IN_GAP not in run.checks.figures
