"""The claims about the slider in a guide (paper 004), beside equations of the mechanism written by
hand."""

import numpy as np
import pytest

import jaxclear as jc
from jaxclear.commands import guide
from jaxclear_command.cli import main
from tests.rigs.figures import assert_complete
from tests.rigs.guide_by_hand import MU, by_hand, friction_problem, regularised, scene, solved
from tests.rigs.refusals import refusals

SPEED = scene.CRANK_SPEED
# An even number of steps: one of them ends where the slider turns round, at half a turn.
TURN, SAVES = 2 * np.pi / SPEED, 1257
STEP = TURN / (SAVES - 1)
# The free crank is let go here and comes to rest by friction.
RELEASE, MU_FREE, FREE_STEP, FREE_SAVES = -2.2, 0.3, 2e-3, 501
# Instants this close [s] to a switching, to the slider's turning points or to an impact are not
# compared.
AWAY = 5e-3


def corners(run):
    """Signed forces of both corners across the guide, and friction, means over the intervals."""
    contact = run.contact("P")
    normal, force = np.asarray(contact.normal_force)[1:], np.asarray(contact.force)[1:]
    return np.stack([normal[:, 1] - normal[:, 3], normal[:, 0] - normal[:, 2]]), force[:, 2]


def turned(step, kind="guide"):
    steps = jc.integrator.NonColliding(step)
    return jc.simulate(jc.scenes.guide(kind), TURN, save=SAVES, integrator=steps, balance=True)


@pytest.fixture(scope="module")
def driven():
    return turned(STEP)


@pytest.fixture(scope="module")
def instants(driven):
    return np.asarray(driven.switchings("P")["time [s]"])


@pytest.fixture(scope="module")
def compliant():
    rig = jc.scenes.guide(clearance=1e-5, friction="regularised")
    return jc.simulate(rig, 0.66, save=661, integrator=jc.integrator.Adaptive(rtol=1e-6))


@pytest.fixture(scope="module")
def free():
    friction = jc.friction.Coulomb(mu_kinetic=MU_FREE)
    rig = jc.scenes.guide(drive=None, crank_angle=RELEASE, crank_speed=0.0, friction=friction)
    integrator = jc.integrator.NonColliding(FREE_STEP)
    return jc.simulate(rig, FREE_STEP * (FREE_SAVES - 1), save=FREE_SAVES, integrator=integrator)


def away_from(times, instants):
    return np.abs(times[:, None] - instants).min(axis=1) > AWAY


def ends_in_reversal(time):
    """Which steps end as the slip reverses, where friction may be that of either side."""
    return np.abs(np.sin(SPEED * time[1:])) < 0.5 * SPEED * STEP


def test_corner_forces_and_friction_are_those_of_the_equations_by_hand(driven):
    time = np.asarray(driven.time)
    sure = ~ends_in_reversal(time)
    assert np.sum(~sure) == 2
    expected = regularised(SPEED * (time[1:][sure] - 0.5 * STEP), SPEED)
    n, friction = (own[..., sure] for own in corners(driven))
    # Midpoint rule: the guide's angle is of order h^2 beside the exact one; largest where the
    # slider is nearest to C.
    for own, wanted in ((n, expected["n"]), (friction, expected["friction"])):
        np.testing.assert_allclose(own, wanted, atol=5e-4 * np.abs(wanted).max())
    # True also where only rounding answers friction: the crank is driven, friction moves nothing.
    assert np.all(friction * expected["slip"] < 0)


def test_reactions_agree_with_the_regularised_model_away_from_switchings(driven, instants):
    time = np.asarray(driven.time)
    expected = regularised(SPEED * time, SPEED)
    far = away_from(time, np.array([*instants, 0.0, 0.5 * TURN, TURN]))
    for joint in "OA":
        force = np.asarray(driven.reaction(joint).force)[:, :2].T
        error = np.linalg.norm(force - expected[joint], axis=0)
        # Friction is its mean over the interval before: first order in the step, one per cent of
        # its part of a tenth.
        assert error[far].max() < 5e-3 * np.linalg.norm(expected[joint], axis=0).max()


@pytest.mark.slow
def test_both_parts_of_a_worn_guide_lose_what_the_forces_by_hand_take(driven):
    """Volumes are k / H times the integral of force and slip; wear changes nothing of the motion
    of joints that always touch."""
    worn = turned(STEP, "wearing")
    middle = SPEED * (np.asarray(worn.time)[1:] - 0.5 * STEP)
    expected = regularised(middle, SPEED)
    law = jc.wear.Archard()
    rate = float(law.wear_coefficient / law.hardness) * STEP
    wanted = rate * np.sum(np.abs(expected["n"]).sum(axis=0) * np.abs(expected["slip"]))
    for surface in ("guide", "slider"):
        np.testing.assert_allclose(worn.worn_volume("P", surface)[-1], wanted, rtol=1e-3)
    states = (run.history.states[:, :2] for run in (worn, driven))
    np.testing.assert_array_equal(*states)


@pytest.mark.slow
def test_reactions_agree_with_a_compliant_run_away_from_switchings_and_impacts(
    driven, compliant, instants
):
    time = np.asarray(compliant.time)
    # Centred in its gap, the slider first bounces; at a switching it crosses its gap and bounces
    # until it rests again.
    calm = ((time > 0.05) & (time < instants[0] - 5e-3)) | (
        (time > 0.45) & (time < instants[2] - 5e-3)
    )
    for joint in "OA":
        force = np.asarray(driven.reaction(joint).force)[:, :2]
        here = np.stack([np.interp(time, driven.time, part) for part in force.T], 1)
        error = np.linalg.norm(np.asarray(compliant.reaction(joint).force)[:, :2] - here, axis=1)
        assert error[calm].max() < 0.01 * np.linalg.norm(force, axis=1).max()
        assert np.median(error[calm]) < 5e-3 * np.median(np.linalg.norm(force, axis=1))


def test_switching_instants_are_where_a_corners_force_by_hand_passes_zero(instants):
    time = np.linspace(0.3, 0.64, 34001)
    changes = np.diff(np.sign(regularised(SPEED * time, SPEED)["n"]), axis=1) != 0
    first, second, third, fourth = np.sort(
        np.concatenate([time[:-1][change] for change in changes])
    )
    # The last two are 47 us apart, within a step: then the line changes sides at once. A tenth of a
    # step for the rest.
    np.testing.assert_allclose(instants, [first, second, 0.5 * (third + fourth)], atol=0.1 * STEP)


def test_switching_instants_are_those_of_the_model_with_a_small_clearance(
    driven, compliant, instants
):
    assert list(driven.switchings("P")["to"]) == [
        "two points on opposite sides",
        "a line (points on one side)",
        "a line (points on one side), on the other side",
    ]
    time, touch = np.asarray(compliant.time), np.asarray(compliant.contact("P").normal_force) > 0
    # The back corner leaves its wall, and strikes the other while the front corner still carries.
    lifted = time[np.flatnonzero((time > 0.3) & ~touch[:, 2])[0]]
    struck = time[np.flatnonzero((time > 0.3) & touch[:, 0])[0]]
    assert abs(lifted - instants[0]) < 2e-3 and instants[0] < struck < instants[0] + 15e-3
    assert np.all(touch[time == struck] == [True, False, False, True])
    # The line lets go within two saving intervals, and the slider strikes the other side after it
    # has crossed its gap.
    let_go = time[np.flatnonzero((time > 0.6) & ~touch[:, :2].any(axis=1))[0]]
    strikes = time[np.flatnonzero((time > 0.6) & touch[:, 2:].any(axis=1))[0]]
    assert abs(let_go - instants[2]) < 2e-3 and instants[2] < strikes < instants[2] + 7e-3


@pytest.mark.slow
def test_impact_follows_the_switching_after_a_flight_that_vanishes_with_the_clearance(instants):
    begin, step = 0.55, 5e-5
    flights, clearances = [], np.array([1e-4, 1e-5, 1e-6])
    for clearance in clearances:
        rig = jc.scenes.guide(clearance=clearance, crank_angle=SPEED * begin)
        run = jc.simulate(rig, 0.1, save=1001, integrator=jc.integrator.MoreauJean(step))
        strikes = np.asarray(run.contact("P").normal_force)[:, 2:].any(axis=1) & (
            run.time > instants[2] - begin - 0.01
        )
        flights.append(run.time[np.flatnonzero(strikes)[0]] + begin - instants[2])
    # The force grows as N' t from the switching on and turns the guide about C: 2 c = N' r^2 t^3 /
    # (6 I). Bounces before, turning of the slider and growth of N' are left out.
    around = regularised(SPEED * (instants[2] + np.array([-1e-3, 0.0, 1e-3])), SPEED)
    slope = abs(around["N"][2] - around["N"][0]) / 2e-3
    expected = np.cbrt(12 * clearances * scene.GUIDE_INERTIA / (slope * around["r"][1] ** 2))
    np.testing.assert_allclose(flights, expected, rtol=0.2)
    rate = np.polyfit(np.log(clearances), np.log(flights), 1)[0]
    assert abs(rate - 1 / 3) < 0.04


def test_the_complementarity_residual_is_rounding_at_every_step(driven, free):
    for run, mu in ((driven, MU), (free, MU_FREE)):
        n, friction = corners(run)
        slip = np.asarray(run.speed("P"))[1:]
        total = np.abs(n).sum(axis=0)
        normal = np.asarray(run.contact("P").normal_force)[1:]
        assert normal.min() >= 0
        assert np.minimum(normal[:, :2], normal[:, 2:]).max() == 0
        # 0 <= s+ perp mu S + T >= 0 and 0 <= s- perp mu S - T >= 0: slip beside the largest slip,
        # force beside the largest bound.
        largest = mu * total.max()
        backward, forward = ((mu * total - sign * friction) / largest for sign in (1, -1))
        speed = slip / np.abs(slip).max()
        # Where a driven slider turns round its speed is nought but for the drift of the closed
        # loop.
        turning = np.abs(speed) < 1e-5
        # Sweeps over the joints end at a last change of 1e-13, each with rounding of its own.
        assert min(backward.min(), forward.min()) > -1e-12
        assert np.abs(np.minimum(np.maximum(speed, 0), forward))[~turning].max() < 1e-12
        assert np.abs(np.minimum(np.maximum(-speed, 0), backward))[~turning].max() < 1e-12


def test_lemke_finds_the_same_friction_for_the_driven_crank(driven):
    n, friction = corners(driven)
    largest = np.abs(n).max()
    row = int(np.searchsorted(driven.time, driven.switchings("P")["time [s]"][0]))
    # Sliding out and back, on either side, two of them on opposite sides.
    for step in (100, 300, row, row + 1, 500, 640, 700, 900, 1200):
        angle = SPEED * (float(driven.time[step]) + 0.5 * STEP)
        slip = by_hand(angle, SPEED, 0.0, 0.0)["slip"]
        offset = by_hand(angle, SPEED, 0.0, -MU * np.sign(slip))["n"]
        own_n, own_friction, own_slip, residual = solved(
            friction_problem(offset, np.zeros(2), MU, slip, 0.0), MU
        )
        assert residual < 1e-12
        np.testing.assert_allclose(own_slip, slip, rtol=1e-12)
        np.testing.assert_allclose(own_n, n[:, step], atol=5e-4 * largest)
        np.testing.assert_allclose(own_friction, friction[step], atol=1e-4 * largest)


def test_lemke_finds_the_same_friction_and_slip_for_the_free_crank(free):
    n, friction = corners(free)
    angle, speed = (np.asarray(x) for x in (free.coordinate("O"), free.speed("O")))
    slips = np.asarray(free.speed("P"))
    h = FREE_STEP
    for step in (5, 50, 150, 250, 450):
        middle = angle[step] + 0.5 * h * speed[step]
        rate = 0.5 * (speed[step] + speed[step + 1])
        still, moved = (by_hand(middle, rate, a, 0.0) for a in (0.0, 1.0))
        lean = -np.sign(still["N"])
        # Both corners on one wall: friction T at half the width gives a moment +-w T / 2, and T
        # gives the crank's acceleration.
        along = by_hand(middle, 1.0, 0.0, 0.0)["slip"] / scene.CRANK
        inertia = moved["torque"] - still["torque"]
        acceleration, per_friction = -still["torque"] / inertia, scene.CRANK * along / inertia
        base = by_hand(middle, rate, acceleration, 0.0)["n"]
        turned = by_hand(middle, rate, acceleration + per_friction, 0.0)["n"] - base
        turned += np.array([1.0, -1.0]) * 0.5 * scene.WIDTH * lean / scene.SLIDER
        answer = h * scene.CRANK * along * per_friction
        # Slip at the step's end without friction: along the guide, by the crank's acceleration and
        # by what the geometry changes.
        ahead = by_hand(angle[step] + h * rate, 1.0, 0.0, 0.0)["slip"]
        slip = ahead * (speed[step] + h * acceleration)
        own_n, own_friction, own_slip, residual = solved(
            friction_problem(base, turned, MU_FREE, slip, answer), MU_FREE
        )
        assert residual < 1e-12
        np.testing.assert_allclose(own_n, n[:, step], rtol=2e-3)
        np.testing.assert_allclose(own_friction, friction[step], rtol=2e-3)
        np.testing.assert_allclose(own_slip, slips[step + 1], atol=1e-3 * np.abs(slips).max())


def test_a_free_crank_comes_to_rest_and_sticks(free):
    slip = np.abs(np.asarray(free.speed("P")))
    n, friction = corners(free)
    # Loops are closed anew to rounding, which moves it by as much.
    at_rest = np.flatnonzero(slip > 1e-9)[-1] + 1
    assert at_rest < 0.6 * FREE_SAVES and slip.max() > 0.1
    angle = np.asarray(free.coordinate("O"))
    assert np.ptp(angle[at_rest:]) < 1e-6
    # What holds it is less than the bound, and is what statics asks: no torque at the crank.
    share = np.abs(friction[at_rest:]) / (MU_FREE * np.abs(n[:, at_rest:]).sum(axis=0))
    assert share.max() < 0.9
    held = by_hand(angle[-1], 0.0, 0.0, friction[-1] / np.abs(n[:, -1]).sum())
    np.testing.assert_allclose(held["torque"], 0.0, atol=1e-6 * scene.CRANK * abs(friction[-1]))


# The first step knows no acceleration yet: an error of order h^2, which decays as the drift does.
FRICTIONLESS = {
    "guide": (jc.integrator.NonColliding(2.5e-4), 5e-4),
    "ideal": (jc.integrator.FixedStep(2e-3), 1e-6),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FRICTIONLESS)
def test_without_friction_the_reactions_are_those_of_the_equations_by_hand(kind):
    integrator, off = FRICTIONLESS[kind]
    run = jc.simulate(jc.scenes.guide(kind, friction=None), 0.25, save=126, integrator=integrator)
    expected = by_hand(SPEED * np.asarray(run.time), SPEED, 0.0, 0.0)["A"].T
    force = np.asarray(run.reaction("A").force)[:, :2]
    np.testing.assert_allclose(force, expected, atol=off * np.abs(expected).max())
    assert kind == "ideal" or np.all(np.asarray(run.contact("P").traction) == 0)


def test_energy_balance_closes_with_the_square_of_the_step(driven):
    coarse, halved = (run.energy_balance() for run in (driven, turned(STEP / 2)))
    loss = np.asarray(coarse.friction_loss)
    sure = ~ends_in_reversal(np.asarray(driven.time))
    assert np.all(np.diff(loss)[sure] >= 0) and loss[-1] > 100
    error = [np.abs(np.asarray(b.error)).max() for b in (coarse, halved)]
    assert error[0] < 2e-4 * float(coarse.kinetic.max())
    assert 3.5 < error[0] / error[1] < 4.5
    # The crank's work over a turn is what friction takes.
    np.testing.assert_allclose(coarse.input[-1], loss[-1], rtol=1e-3)


@pytest.mark.slow
def test_every_figure_is_drawn_and_named(driven, compliant, instants):
    assert len(guide.impacts(compliant, instants)) == len(instants)
    figures = [
        guide.corner_forces(driven, instants),
        guide.switching_window(driven, compliant, instants),
        guide.reactions(driven, compliant, instants),
    ]
    for figure in figures:
        assert_complete(figure)


@pytest.mark.slow
def test_the_command_writes_figures_and_tables(tmp_path, capsys, keep_settings):
    main(["guide", "--out", str(tmp_path), "--quiet"])
    kinds = sorted(path.suffix for path in tmp_path.iterdir())
    assert set(kinds) == {".png", ".csv"} and len(kinds) == 5
    assert str(tmp_path) in capsys.readouterr().out


test_impossible_scenes_are_refused = refusals(
    {
        '"slot" of guide; there are "guide", "wearing", "ideal"': lambda: jc.scenes.guide("slot"),
        "set_valued": lambda: jc.scenes.guide(friction="viscous"),
        "drive=None": lambda: jc.scenes.guide(torque=3.0),
    }
)
