"""Every response of the package on one run, against the trajectory it is drawn from; and what it
says when it cannot be."""

import csv
import re

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.results.response import AbstractResponse
from tests.rigs.falling_journal import touching_journal


@pytest.fixture(scope="module")
def run():
    return jc.simulate(touching_journal(), 0.05, save=51, state=jc.State(concentric=False))


def test_responses_are_what_their_names_say(run):
    com = np.asarray(run.body("journal").com)
    expected = {
        jc.response.PeakWornDepth("B"): np.asarray(run.worn["B"]["bearing"]).max(),
        jc.response.WornVolume("B"): run.worn_volume("B", "bearing")[-1],
        jc.response.MeanContactForce("B"): run.contact_impulse("B")[-1] / run.time[-1],
        jc.response.FinalCoordinate("journal", 1, unit="m"): com[-1, 1],
    }
    covered = {type(response) for response in expected} | {
        jc.response.FilmFriction,  # of films: tests/integrators/test_films.py
        jc.response.FromFunction,
        jc.response.LargestDeflection,  # of beams: tests/multibody/test_beams.py
        jc.response.LargestError,  # of drawings: tests/studies/test_drawing.py
        jc.response.LostMotion,  # of positions: tests/simulation/test_positions.py
        jc.response.PeakContactForce,  # below
        jc.response.PeakTransmitted,  # of couplings: tests/multibody/test_play.py
        jc.response.PositionError,
        jc.response.ThinnestFilm,  # of films: tests/integrators/test_films.py
        jc.response.PointingAngle,
    }
    assert covered == {
        cls for cls in AbstractResponse.__subclasses__() if cls.__module__.startswith("jaxclear.")
    }
    for response, value in expected.items():
        assert float(response(run)) == pytest.approx(float(value))
        assert np.isfinite(value) and value != 0
    error = jc.response.PositionError("journal", np.zeros_like(com), axes=(1,))
    assert float(error(run)) == pytest.approx(np.sqrt((com[:, 1] ** 2).mean()))


@pytest.mark.parametrize("at", [None, (0.02, 0.01, 0.0)])
def test_the_error_of_a_point_is_that_of_its_path(run, at):
    marker = jc.Marker("journal", at)
    path = np.asarray(run.body("journal").origin)
    if at is not None:
        path = path + np.asarray(run.body("journal").rotation) @ np.array(at)
    shift = np.array([3e-3, 0.0, 4e-3])
    assert float(jc.response.PositionError(marker, path + shift)(run)) == pytest.approx(5e-3)


def test_a_run_as_a_table_keeps_every_digit(run, tmp_path):
    with run.to_csv(tmp_path / "run.csv").open(newline="") as file:
        head, *rows = csv.reader(file)
    table = dict(zip(head, np.array(rows, float).T, strict=True))
    assert head[0] == "time [s]" and len(rows) == len(run.time)
    np.testing.assert_array_equal(table["journal.com.y [m]"], run.body("journal").com[:, 1])
    force = np.asarray(run.contact("B").normal_force)[:, 0]
    np.testing.assert_array_equal(table["B.normal_force.0 [N]"], force)


@pytest.mark.parametrize(
    ("name", "meant"),
    [("plot", "plot.result(run)"), ("position", "run.path(marker)"), ("x", "no 'x'.")],
)
def test_a_name_that_a_run_has_not_says_what_is_meant(run, name, meant):
    with pytest.raises(AttributeError, match=re.escape(meant)):
        getattr(run, name)


def test_lost_motion_of_a_run_says_what_it_reads(run):
    with pytest.raises(
        TypeError, match=r"reads positions .* not a run: give it jaxclear.positions"
    ):
        jc.response.LostMotion("B")(run)


DAMPED = {
    "Flores": (jc.contact.Flores(stiffness=1e9, restitution=0.2), jc.integrator.Adaptive()),
    "KelvinVoigt": (
        jc.contact.KelvinVoigt(stiffness=1e7, damping=1e4),
        jc.integrator.FixedStep(2e-6),
    ),
    "AdamsImpact": (
        jc.contact.AdamsImpact(stiffness=6e9),
        jc.integrator.FixedStep(2e-6, "munthe_kaas4"),
    ),
    "CarvalhoMartins": (
        jc.contact.CarvalhoMartins(restitution=0.3),
        jc.integrator.ImplicitStep(2e-6),
    ),
    "Hertz": (jc.contact.Hertz(), jc.integrator.FixedStep(2e-6, "heun")),
}


@pytest.mark.slow
@pytest.mark.parametrize("law", DAMPED)
def test_peak_forces_with_strong_damping_do_not_hang_on_the_saving_times(law):
    """A contact that damps presses hardest before it is deepest, here between saving times."""
    contact, integrator = DAMPED[law]
    bearing = jc.clearance.PlanarJournalBearing(contact, clearance=1e-3)
    rig = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        speeds={"journal": (0.0, -0.1, 0.0)},
    )
    peak = jc.response.PeakContactForce("B")
    few = jc.simulate(rig, 0.012, integrator=integrator, save=3)
    dense = jc.simulate(rig, 0.012, integrator=jc.integrator.Adaptive(), save=12_001)
    saved = np.asarray(dense.contact("B").normal_force)
    assert few.contact("B").normal_force.max() < 0.1 * saved.max()
    assert float(peak(few)) == pytest.approx(saved.max(), rel=0.03)
    assert float(peak(dense)) == pytest.approx(saved.max(), rel=0.01)


def test_a_function_has_the_unit_and_the_needs_that_it_is_given(run):
    lift = jc.response.FromFunction(lambda run: 2 * run.body("journal").com[-1, 1], "m", "motion")
    problem = jc.Problem(
        touching_journal(),
        {"lift": lift, "plain": lambda run: run.time[-1]},
        {"clearance": jc.Variable(lambda m: m.connections["B"].joint.clearance, tolerance=1e-6)},
        duration=0.05,
    )
    assert problem.units() == {"lift": "m", "plain": "1"}
    assert float(lift(run)) == 2 * float(run.body("journal").com[-1, 1])
    known = problem.description.responses
    assert "motion" in known["lift"].depends_on and "forces" not in known["lift"].depends_on
    assert "forces" in known["plain"].depends_on
    with pytest.raises(ValueError, match='no part of a run "force" to draw from; there are "any'):
        jc.response.FromFunction(lambda run: run.time[-1], "s", needs="force")


def thrown():
    """A slider thrown from wall to wall of its guide."""
    guide = jc.clearance.SliderGuide(jc.contact.Hertz(stiffness=1e8))
    ends = jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x")
    load = jc.load.Force(jc.Marker("slider", (0.03, 0.0)), (0.0, -50.0, 0.0))
    joints = {"B": jc.Connection(guide, *ends)}
    return jc.Mechanism({"slider": jc.Body(1.0, 1e-3)}, joints, {"load": load})


STEP = jc.integrator.FixedStep(5e-6)
# A rig, its steps, the share of the peak that is saved at the most, and how near is told.
PEAKS = {
    "fixed": (jc.scenes.slider_crank(friction=False), STEP, 0.5, 0.05),
    "own": (jc.scenes.slider_crank(friction=False), jc.integrator.Adaptive(), 0.5, 0.05),
    "guide": (thrown(), STEP, 0.95, 0.01),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", PEAKS)
def test_peaks_are_caught_between_the_saving_times(name):
    """Of impacts of 0.05 ms, one in forty was at a saving time: a tenth of the peak was told."""
    rig, integrator, saved, near = PEAKS[name]
    sparse, dense = (
        jc.simulate(rig, 0.02, save=saves, integrator=integrator) for saves in (11, 4001)
    )
    true = float(dense.contact("B").normal_force.max())
    assert float(sparse.contact("B").normal_force.max()) < saved * true
    assert float(jc.response.PeakContactForce("B")(sparse)) == pytest.approx(true, rel=near)


LACKING = {
    'no joint or coupling "C" in this mechanism; there is "B"': jc.response.PeakWornDepth("C"),
    '"journal" has 3 coordinates; the index of response.FinalCoordinate, 3, must be below': (
        jc.response.FinalCoordinate("journal", 3)
    ),
    'no joint or floating body "nothing"': jc.response.FinalCoordinate("nothing"),
    'no clearance joint "nothing"': jc.response.MeanContactForce("nothing"),
    'the reference path of "journal" has 3 saving times, the run has 51: take it from': (
        jc.response.PositionError("journal", np.zeros((3, 3)))
    ),
}


@pytest.mark.parametrize("sentence", LACKING)
def test_responses_that_do_not_exist_say_so(run, sentence):
    with pytest.raises(ValueError, match=sentence):
        LACKING[sentence](run)


def test_a_coordinate_has_the_unit_of_its_joint():
    """Slides of metres were told in radians."""
    rig = jc.scenes.slider_crank("ideal")
    end = jc.response.FinalCoordinate
    asked = {"turn": end("A"), "slide": end("G"), "told": end("G", unit="mm")}
    problem = jc.Problem(rig, asked, {}, duration=0.01)
    assert problem.units() == {"turn": "rad", "slide": "m", "told": "mm"}
    assert jc.response.unit_of(jc.response.LostMotion("G"), rig) == "m"
