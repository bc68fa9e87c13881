"""Impact speeds are taken at the touch: restitution is the law's own on every rung, whatever the
speed, the clearance and the saving times; steps converge through impacts at their order.
"""

import itertools

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

import jaxclear as jc
from jaxclear.formulations.impact_speed import (
    ContactMotion,
    Passage,
    at_touch,
    end_at_passage,
    remembered,
)
from jaxclear.integrators.error_control import EndingAtTouches, Judged
from jaxclear.laws.contact import dissipation
from jaxclear.multibody.assembly import guess
from jaxclear.simulation.simulate import run
from tests.laws.law_family import members
from tests.laws.test_restitution import returned
from tests.rigs.cells import slow, slow_but

KVAERNO = diffrax.Kvaerno5(root_finder=optimistix.Newton(rtol=1e-6, atol=1e-8))
STIFFNESS, MASS, CLEARANCE = 1e9, 0.3, 0.5e-3
# As programs: XLA compiles each of their operations by itself otherwise.
end_at_passage, remembered = jax.jit(end_at_passage), jax.jit(remembered)


def damped(factor):
    """A law with this factor d: Hunt and Crossley's d = 3/2 (1 - c_e), whatever c_e that takes."""
    law = jc.contact.HuntCrossley(stiffness=STIFFNESS, restitution=0.9)
    return eqx.tree_at(
        lambda law: law.dissipation.restitution, law, jnp.asarray(1 - 2 / 3 * factor)
    )


def thrown(contact, speed=0.1, clearance=CLEARANCE):
    """A journal thrown from near the middle of its bearing, straight at the wall."""
    joint = jc.clearance.PlanarJournalBearing(contact, bearing_radius=0.5, clearance=clearance)
    return jc.Mechanism(
        {"journal": jc.Body(MASS, 1e-4)},
        {"B": jc.Connection(joint, "ground", "journal")},
        start={"journal": (0.06e-3, 0.08e-3, 0.0)},
        speeds={"journal": (0.6 * speed, 0.8 * speed, 0.0)},
    )


def contact_time(speed):
    """Duration [s] of an elastic Hertzian impact."""
    return 3.21 * (MASS / (STIFFNESS * jnp.sqrt(speed))) ** 0.4


ORDERS = {
    # Hertz's force begins as the 3/2th power of the indentation: no more than 5/2 by any method.
    "rk4": (lambda h: jc.integrator.FixedStep(h), 2.5, 16e-6),
    "munthe_kaas4": (lambda h: jc.integrator.FixedStep(h, "munthe_kaas4"), 2.5, 16e-6),
    "heun": (lambda h: jc.integrator.FixedStep(h, "heun"), 2, 8e-6),
    "semi_implicit": (lambda h: jc.integrator.FixedStep(h, "semi_implicit"), 1, 8e-6),
    "implicit": (lambda h: jc.integrator.ImplicitStep(h, rebound=1.0), 2, 16e-6),
}


@pytest.fixture(scope="module")
def falls():
    """Journals thrown down under strong gravity from several heights, aside too, so that the normal
    turns in flight; until after one impact."""
    law = jc.contact.Gonthier(stiffness=STIFFNESS, restitution=0.6)
    rig = thrown(law)
    rig = jc.Mechanism(
        rig.bodies, rig.connections, {"gravity": jc.load.Gravity((0.0, -1e3))}, start=rig.start
    )
    places = np.linspace(0.0, 0.7e-4, 20)
    q, _ = guess(rig)

    @eqx.filter_jit
    def go(rig, integrator):
        def one(place):
            start = q.at[:2].set(jnp.array([0.5e-4, 0.0]) + place)
            speed = jnp.array([0.12, -0.4, 0.0])
            return run(rig, start, speed, jnp.linspace(0.0, 1.2e-3, 2), integrator).states[-1]

        return jax.vmap(one)(places)

    ends = lambda integrator: np.asarray(go(rig, integrator))
    exact = ends(jc.integrator.Adaptive(rtol=1e-11, atol=1e-14))
    return ends, exact


@pytest.mark.parametrize("method", slow_but(("implicit",), ORDERS))
def test_steps_converge_through_an_impact_at_their_order(method, falls):
    """Root of the mean square over the starts, because where in a step a touch falls is chance."""
    ends, exact = falls
    make, order, step = ORDERS[method]
    assert (exact[:, 4] > 0.1).all(), "every journal has bounced"
    errors = [
        np.sqrt(np.mean(np.square((ends(make(h)) - exact)[:, 3:5]))) for h in (step, step / 4)
    ]
    assert np.log2(errors[0] / errors[1]) / 2 > order - 0.25


def test_every_law_that_remembers_damps_by_its_factor_over_the_impact_speed():
    """So the engine sees nothing of a law but its factor."""
    for law in members(dissipation.AbstractRestitutionFactor):
        factor = law(restitution=0.7)
        found = factor.relative_damping(jnp.asarray(-0.3), jnp.asarray(0.2))
        np.testing.assert_allclose(found, -1.5 * factor.factor(), rtol=1e-14)


def factors():
    """d of every law with a memory, at two restitutions."""
    found = [
        float(law(restitution=restitution).factor())
        for law in members(dissipation.AbstractRestitutionFactor)
        if law.__module__ == dissipation.__name__
        for restitution in (0.9, 0.5)
    ]
    return np.array(found)


RUNGS = {
    "Adaptive": jc.integrator.Adaptive(),
    "FixedStep": jc.integrator.FixedStep(),
    "short steps in contact": jc.integrator.FixedStep(4e-5, contact_steps=4),
    "on groups": jc.integrator.FixedStep(method="munthe_kaas4"),
    "ImplicitStep": jc.integrator.ImplicitStep(1e-5, rebound=1.0),
}


FAST = ("ImplicitStep",)


@pytest.mark.parametrize("rung", slow_but(FAST, RUNGS))
def test_restitution_is_the_law_s_within_a_thousandth(rung):
    """0.01 to 10 m/s, every law with a memory at two restitutions, at the defaults of its rung (an
    implicit step is told to resolve the impact). Ten m/s cross the clearance in 50 us: a state that
    followed the approach speed would lag.
    """
    q, v = guess(thrown(damped(0.1), 1.0))

    def rebound(factor, speed):
        rig = thrown(damped(factor), 1.0)
        # The second wall is twice the clearance away.
        duration = CLEARANCE / speed + 1.3 * contact_time(speed)
        times = jnp.linspace(0.0, 1.0, 33) * (duration + CLEARANCE / speed)
        states = run(rig, q, speed * v, times, RUNGS[rung]).states
        return jnp.max(-states[:, 3:5] @ v[:2]) / speed

    cases = [part.ravel() for part in np.meshgrid(factors(), [0.01, 0.1, 1.0, 3.0, 10.0])]
    # The program is let go in the line that calls it: its kernels must stay until it has run.
    found = np.asarray(jax.jit(jax.vmap(rebound))(*cases))
    wanted = np.array([returned(factor) for factor in cases[0]])
    np.testing.assert_allclose(found, wanted, rtol=1e-3)


@pytest.mark.slow
def test_saving_times_within_the_impact_change_nothing():
    """Each saving time ends a step, and begins another with what the last one has left."""
    law = jc.contact.Gonthier(stiffness=STIFFNESS, restitution=0.5)
    duration = CLEARANCE / 0.1 + 1.3 * float(contact_time(0.1))
    for integrator, off in (
        (jc.integrator.Adaptive(rtol=1e-9, atol=1e-11), 1e-6),
        (jc.integrator.FixedStep(2e-6), 1e-6),
        (jc.integrator.ImplicitStep(2e-6, rebound=1.0), 1e-4),
    ):
        np.testing.assert_allclose(speed_back(law, duration, 500, integrator), 0.5, atol=off)


def speed_back(law, duration, saves, integrator):
    """Of a journal that is thrown at 0.1 m/s, beside that."""
    how = {"integrator": integrator, "state": jc.State(concentric=False)}
    end = jc.simulate(thrown(law), duration, save=saves, **how)
    return -end.body("journal").velocity[-1, :2] @ jnp.array([0.6, 0.8]) / 0.1


@pytest.mark.slow
def test_implicit_solver_takes_them_too():
    implicit = jc.integrator.Adaptive(KVAERNO, rtol=1e-9, atol=1e-11)
    law = jc.contact.Gonthier(stiffness=STIFFNESS, restitution=0.5)
    np.testing.assert_allclose(speed_back(law, 6e-3, 2, implicit), 0.5, atol=1e-6)


def test_law_without_memory_has_nothing_to_take():
    tight = jc.integrator.Adaptive(rtol=1e-9, atol=1e-11)
    law = jc.contact.Hertz(stiffness=STIFFNESS)
    np.testing.assert_allclose(speed_back(law, 6e-3, 2, tight), 1.0, atol=1e-6)


def motion(depth, rate):
    return ContactMotion(jnp.array([depth]), jnp.array([rate]))


def test_speed_at_the_touch_is_that_of_the_path_to_the_third_power_of_the_step():
    """A path with every power: sin; a constant acceleration is followed exactly."""
    errors = []
    for h in (0.2, 0.1, 0.05):
        start = -0.37 * h
        ends = [motion(np.sin(t) + t * t, np.cos(t) + 2 * t) for t in (start, start + h)]
        errors.append(abs(float(at_touch(*ends, h)[0]) - 1.0))
    assert errors[2] < 1e-5 and np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 2.7)
    falling = [motion(0.5 * t * t - 0.5, t) for t in (0.3, 1.2)]
    np.testing.assert_allclose(at_touch(*falling, 0.9), 1.0, rtol=1e-14)


def test_memory_is_held_in_contact_forgotten_after_and_taken_anew():
    """As the contact touches, stays, parts, and touches again, in steps of 1 s."""
    path = [motion(-0.5, 1.0), motion(0.5, 1.0), motion(0.6, -0.8), motion(-0.2, -0.8)]
    path += [motion(-0.1, 0.2), motion(0.1, 0.2)]
    speeds, found = jnp.zeros(1), []
    for before, after in itertools.pairwise(path):
        speeds = remembered(speeds, before, after, 1.0)
        found.append(float(speeds[0]))
    np.testing.assert_allclose(found, [1.0, 1.0, 0.0, 0.0, 0.2], rtol=1e-12)


def test_derivatives_of_the_touch_are_finite_where_nothing_moves():
    """At rest on the wall, at a wall that is just met, and where nothing happens."""
    zero = motion(0.0, 0.0)
    for before, after in ((zero, zero), (motion(-1.0, 0.0), zero), (motion(-1.0, -1.0),) * 2):
        slopes = jax.jacfwd(remembered, (0, 1, 2, 3))(jnp.zeros(1), before, after, 1.0)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))


def looked_at(depth, rate):
    """A path at the beginning, halfway and at the end of a step of 2 s."""
    at = (0.0, 1.0, 2.0)
    return [ContactMotion(*map(jnp.atleast_1d, (depth(t), rate(t)))) for t in at]


def test_a_touch_between_the_ends_of_a_step_is_seen():
    """A dip of 1e-6 m on either side of the wall, closing or opening; not one of 1e-10 m."""
    for sign in (1.0, -1.0):
        for depth, seen in ((1e-6, True), (1e-10, False)):
            dip = lambda t, d=depth: sign * (d - (t - 0.7) ** 2)
            path = looked_at(dip, lambda t: sign * 1.4 - sign * 2 * t)
            share = float(end_at_passage(*path, 2.0, 1e-9))
            assert (share < 1) == seen


def test_a_touch_is_seen_where_the_journal_has_passed_the_middle_since():
    """It comes nearer to the wall at both ends of the step, and at the wall it turned between."""
    for depth, seen in ((1e-6, True), (-1e-6, False)):
        # From its touch at 0.7 s it is in the middle at 1.7 s, so that it nears the other wall.
        place = lambda t, d=depth: 1.0 + d - (t - 0.7) ** 2
        speed = lambda t: -2 * (t - 0.7)
        aside = lambda t: abs(place(t)) - 1.0
        path = looked_at(aside, lambda t: speed(t) * np.sign(place(t)))
        assert path[0].rates > 0 and path[2].rates > 0
        assert (float(end_at_passage(*path, 2.0, 1e-9)) < 1) == seen


def test_a_step_that_passes_a_wall_is_to_end_there():
    """Closing and opening in either half of it, on a path of the third power of time; the earliest
    of several contacts tells, and one that is hardly beyond its wall may go on."""
    for at in (0.3, 1.7):
        for sign in (1.0, -1.0):
            way = lambda t, a=at, s=sign: s * ((t - a) + 0.1 * (t - a) ** 3)
            path = looked_at(way, lambda t, a=at, s=sign: s * (1 + 0.3 * (t - a) ** 2))
            share = float(end_at_passage(*path, 2.0, 1e-6))
            np.testing.assert_allclose(2 * share, at + 0.5e-6, rtol=1e-6)
            assert float(end_at_passage(*path, 2.0, 10.0)) == 1
    both = looked_at(lambda t: np.array([t - 1.5, t - 0.4]), lambda t: np.ones(2))
    assert float(end_at_passage(*both, 2.0, 1e-6)) == pytest.approx(0.2, abs=1e-6)


def test_a_contact_that_parts_at_the_start_of_a_step_hides_no_touch_of_another():
    """It has parted before time could tell, and counts so from the next step on, in whose middle
    the other closes."""
    both = looked_at(lambda t: np.array([1e-9 - t, t - 0.4]), lambda t: np.array([-1.0, 1.0]))
    assert float(end_at_passage(*both, 2.0, 1e-6)) < 1e-6
    assert float(end_at_passage(*both, 2.0, 1e-6, 1e-5)) == pytest.approx(5e-6)
    rest = looked_at(
        lambda t: np.array([-1e-5 - t, t + 1e-5 - 0.4]), lambda t: np.array([-1.0, 1.0])
    )
    assert float(end_at_passage(*rest, 2.0, 1e-6, 1e-5)) == pytest.approx(0.2, abs=1e-5)
    # as does one that parts at its end
    both = looked_at(lambda t: np.array([2 - 2e-6 - t, t - 0.4]), lambda t: np.array([-1.0, 1.0]))
    assert float(end_at_passage(*both, 2.0, 1e-7, 1e-5)) == pytest.approx(0.2, abs=1e-6)


def test_a_step_ends_at_a_touch_though_another_contact_parts_at_its_end():
    control = diffrax.PIDController(rtol=1e-3, atol=1e-6, dtmin=1e-5)
    touches = EndingAtTouches(control, jnp.asarray(1e-6))
    both = looked_at(lambda t: np.array([2 - 2e-6 - t, t - 0.4]), lambda t: np.array([-1.0, 1.0]))
    at_rest = jnp.zeros(1)
    state = touches.init(None, 0.0, 2.0, at_rest, 2.0, None, None, 5.0)[1]
    judged = Judged(at_rest, Passage(*both))
    keep, _, stop, *_ = touches.adapt_step_size(
        0.0, 2.0, at_rest, at_rest, None, judged, 5.0, state
    )
    assert not keep and float(stop) == pytest.approx(0.4, abs=1e-5)


@pytest.mark.parametrize("plain", [False, *slow(True)], ids=["kernel", "plain loops"])
def test_a_grazing_touch_is_not_stepped_over(plain, monkeypatch):
    """A ball thrown up whose path just meets the wall above: a parabola, which error control would
    cross in one step, wherever that is to end. It loses what the law takes at the speed of the
    touch."""
    monkeypatch.setenv("JAXCLEAR_PLAIN_LOOPS", str(int(plain)))
    graze, gravity, clearance = 1e-7, 10.0, 1e-2
    law = jc.contact.Linear(stiffness=1e8, restitution=0.5)
    joint = jc.clearance.PlanarJournalBearing(law, bearing_radius=0.5, clearance=clearance)
    speed = np.sqrt(2 * gravity * (clearance + graze))
    rig = jc.Mechanism(
        {"ball": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(joint, "ground", "ball")},
        {"gravity": jc.load.Gravity((0.0, -gravity))},
        speeds={"ball": (0.0, speed, 0.0)},
    )
    back = 2 * speed / gravity
    ways = (1e-7, 1.0), (1e-10, 1e-3 * back)
    loose, tight = (
        jc.integrator.Adaptive(rtol=rtol, atol=1e-2 * rtol, largest_step=longest)
        for rtol, longest in ways
    )

    def height(end, integrator):
        # A number of saving times for either way: the program is compiled anew.
        saves, start = 3 if plain else 2, jc.State(concentric=False)
        found = jc.simulate(rig, end, save=saves, integrator=integrator, state=start)
        assert ("switched off" in found.stats.loops) == plain
        return float(found.body("ball").com[-1, 1])

    # It would be in the middle again at 1.
    for end in back * np.array([0.8, 0.93, 1.0, 1.1]):
        wanted, untouched = height(end, tight), end * (speed - 0.5 * gravity * end)
        assert abs(wanted - untouched) > 1e-5
        np.testing.assert_allclose(height(end, loose), wanted, atol=1e-2 * abs(wanted - untouched))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Hertz", "KelvinVoigt", "AdamsImpact"])
def test_a_short_touch_is_seen_whatever_the_law_remembers(name):
    """Thrown up so that it would go 3 um beyond the wall: without the wall it would lie
    elsewhere by more than a tenth of the gap."""
    law = getattr(jc.contact, name)(**({} if name == "KelvinVoigt" else {"stiffness": 1e9}))
    joint = jc.clearance.PlanarJournalBearing(law, clearance=1e-4)
    rig = jc.Mechanism(
        {"pin": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(joint, "ground", "pin")},
        {"gravity": jc.load.Gravity((0.0, -9.81))},
        speeds={"pin": (0.0, float(np.sqrt(2 * 9.81 * 103e-6)), 0.0)},
    )
    both = jc.integrator.Adaptive(), jc.integrator.Adaptive(rtol=1e-11, atol=1e-14)
    usual, tight = (
        float(jc.simulate(rig, 8.5e-3, save=2, integrator=one).states[-1, 1]) for one in both
    )
    assert usual == pytest.approx(tight, abs=1e-8)
    flown = np.sqrt(2 * 9.81 * 103e-6) * 8.5e-3 - 0.5 * 9.81 * 8.5e-3**2
    assert abs(usual - flown) > 1e-5


@pytest.mark.parametrize("friction", [None, jc.friction.LuGre()], ids=["smooth", "bristles"])
@pytest.mark.slow
def test_flights_through_the_centre_reach_their_end_at_the_tightest_tolerance(friction):
    """The normal turns by pi in no time there, and forces are nothing: no step may shrink to that.
    Exactly through it, past it by 1e-7 m, and on to the wall, with one saving time long after."""
    law = jc.contact.LankaraniNikravesh(stiffness=STIFFNESS, restitution=0.9)
    joint = jc.clearance.PlanarJournalBearing(law, friction, bearing_radius=0.5, clearance=5e-3)
    tight = jc.integrator.Adaptive(rtol=1e-10, atol=1e-13)
    for off in (0.0, 1e-7):
        rig = jc.Mechanism(
            {"journal": jc.Body(MASS, 1e-4)},
            {"B": jc.Connection(joint, "ground", "journal")},
            start={"journal": (-3e-3, off, 0.0)},
            speeds={"journal": (0.01, 0.0, 0.0)},
        )
        found = jc.simulate(rig, 10.0, save=2, integrator=tight, state=jc.State(concentric=False))
        assert found.succeeded and abs(float(found.body("journal").com[-1, 0])) < 5e-3


def test_a_loose_tolerance_keeps_the_journals_place_over_many_impacts():
    """Errors grow at every impact, so a tolerance of 1e-4 is no tolerance for a gap: the journal
    ended elsewhere by 0.3 of its clearance after 0.06 s, and by all of it after 0.12 s."""
    rig = jc.scenes.slider_crank()
    of = lambda rtol: jc.integrator.Adaptive(rtol=rtol, atol=1e-2 * rtol)
    runs = [jc.simulate(rig, 0.06, save=101, integrator=of(rtol)) for rtol in (1e-9, 1e-4)]
    offsets = [run.contact("B").offset for run in runs]
    clearance = float(rig.connections["B"].joint.clearance)
    assert np.abs(offsets[1] - offsets[0]).max() < 0.1 * clearance
