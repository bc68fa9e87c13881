"""Rigid contact in steps: sticking, cones, energy, impulses, batches, sentences, and the limit of
stiff compliant contact.
"""

import logging
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.clearance import AbstractClearance, ContactCandidate, ContactLaws
from jaxclear.integrators.checks import Check
from jaxclear.laws.contact import AbstractNormalLaw
from jaxclear.laws.stiffness import Shape
from jaxclear.multibody.assembly import guess
from jaxclear.native import loop
from jaxclear.simulation.simulate import run

GRAVITY, MASS, MU, CLEARANCE = 9.81, 2.0, 0.3, 1e-4
STEP = 1e-4


class Floor(AbstractClearance):
    """The child's origin stays above the plane y = 0 and rubs on it in both directions."""

    ideal_rows: ClassVar = ("y",)
    contact: AbstractNormalLaw
    friction: Any = None

    @property
    def axes(self):
        return ()

    def contact_laws(self):
        return (ContactLaws(self.contact, self.friction, Shape(1e-2, 1.0, None), False),)

    def indentations(self, offset, axes, worn):
        return (-1.0 * offset[1],)

    def contact_candidates(self, offset, axes, indentations):
        return (ContactCandidate((offset[0], 0, offset[2]), (0, -1, 0), ((1, 0, 0), (0, 0, 1))),)

    def maps(self):
        return {}

    def features(self, surface, offset, axes, indentations, index):
        raise NotImplementedError


def block(mu=MU, mu_static=None, *, angle=0.0, height=0.0, speed=(0.0, 0.0, 0.0), restitution=0.5):
    """A block on an incline that falls towards (0.8, 0, 0.6) at `angle`; numbers alone differ, so
    that all are one program.
    """
    down = GRAVITY * np.sin(angle)
    return jc.Mechanism(
        {"block": jc.Body(MASS, (1e-2,) * 3)},
        {
            "floor": jc.Connection(
                Floor(
                    jc.contact.Rigid(restitution=restitution),
                    jc.friction.Coulomb(mu_kinetic=mu, mu_static=mu_static),
                ),
                "ground",
                "block",
            )
        },
        {"gravity": jc.load.Gravity((0.8 * down, -GRAVITY * np.cos(angle), 0.6 * down))},
        start={"block": (0.0, height, 0.0, 1.0, 0.0, 0.0, 0.0)},
        speeds={"block": (*speed, 0.0, 0.0, 0.0)},
    )


def held(joint, inertia=1e-4, speeds=(0.0, 0.0, 0.0), gravity=None, start=None, **how):
    """A body in a clearance joint with the ground."""
    loads = {} if gravity is None else {"gravity": jc.load.Gravity(gravity)}
    connection = jc.Connection(joint, "ground", "body", **how)
    begin = {} if start is None else {"body": start}
    return jc.Mechanism(
        {"body": jc.Body(MASS, inertia)},
        {"B": connection},
        loads,
        start=begin,
        speeds={"body": speeds},
    )


def journal(restitution=0.5, mu=None, **rest):
    friction = None if mu is None else jc.friction.Coulomb(mu_kinetic=mu)
    return held(
        jc.clearance.PlanarJournalBearing(
            jc.contact.Rigid(restitution=restitution), friction, clearance=CLEARANCE
        ),
        **rest,
    )


def simulate(mechanism, duration, save=101, step=STEP, **rest):
    return jc.simulate(
        mechanism,
        duration,
        save=save,
        integrator=jc.integrator.MoreauJean(step),
        state=jc.State(concentric=False),
        balance=True,
        **rest,
    )


@pytest.mark.parametrize("angle", [0.1, 0.291])
def test_a_block_sticks_below_the_friction_angle(angle):
    found = simulate(block(mu_static=MU, angle=angle), 0.1)
    assert float(np.abs(found.body("block").com).max()) < 1e-12
    assert float(np.abs(found.body("block").velocity).max()) < 1e-12


@pytest.mark.parametrize("angle", [0.292, 1.5])
def test_a_block_slides_above_the_friction_angle(angle):
    found = simulate(block(mu_static=MU, angle=angle), 0.1)
    rate = GRAVITY * (np.sin(angle) - MU * np.cos(angle))
    expected = np.outer(rate * found.time, [0.8, 0.0, 0.6])
    np.testing.assert_allclose(found.body("block").velocity, expected, atol=1e-12)


def test_static_friction_holds_and_kinetic_friction_slides():
    """tan(0.5) = 0.55 lies between: at rest the block stays, pushed it goes on for ever."""
    at_rest = simulate(block(mu_static=0.6, angle=0.5), 0.1)
    assert float(np.abs(at_rest.body("block").velocity).max()) < 1e-12
    pushed = simulate(block(mu_static=0.6, angle=0.5, speed=(0.008, 0.0, 0.006)), 0.1)
    rate = GRAVITY * (np.sin(0.5) - MU * np.cos(0.5))
    np.testing.assert_allclose(
        pushed.speed("block")[:, 0], 0.8 * (0.01 + rate * pushed.time), atol=1e-12
    )


def test_a_block_is_stopped_along_its_velocity():
    """Speed 0.5 - mu g t until it stops, direction kept; then it does not move at all. All it had
    went into friction.
    """
    found = simulate(block(mu_static=MU, speed=(0.3, 0.0, 0.4)), 0.3)
    speed = np.maximum(0.5 - MU * GRAVITY * found.time, 0.0)
    np.testing.assert_allclose(
        found.body("block").velocity, np.outer(speed, [0.6, 0.0, 0.8]), atol=1e-12
    )
    energy = found.energy_balance()
    assert float(energy.friction_loss[-1]) == pytest.approx(0.5 * MASS * 0.5**2, rel=1e-12)
    assert float(np.abs(energy.error).max()) < 1e-12


@pytest.mark.parametrize("restitution", [1.0, 0.9, 0.0])
def test_bounces_never_gain_energy_and_impulses_are_changes_of_momentum(restitution):
    """A ball overlaps the floor by half a step of its speed at most; energy is counted to
    rounding."""
    found = simulate(block(0.0, 0.0, height=0.05, restitution=restitution), 1.0)
    energy = found.energy_balance()
    total = np.asarray(energy.kinetic + energy.potential)
    fastest = np.sqrt(2 * GRAVITY * 0.05)
    assert (
        np.diff(total).max() < 1e-12
        and float(found.body("block").com[:, 1].min()) > -0.5 * STEP * fastest
    )
    assert float(np.abs(energy.error).max()) < 1e-12
    if restitution == 1:
        np.testing.assert_allclose(total, total[0], rtol=1e-12)
    contact = found.contact("floor")
    impulse = np.sum(np.asarray(contact.normal_force)[1:, 0] * np.diff(found.time))
    gained = MASS * float(found.body("block").velocity[-1, 1]) + MASS * GRAVITY * float(
        found.time[-1]
    )
    assert impulse == pytest.approx(gained, abs=1e-10)


@pytest.mark.parametrize("restitution", [1.0, 0.9])
def test_a_journal_bouncing_in_its_bearing_never_gains_energy(restitution):
    """Not turning, no gravity: a linear scene. Measured: rounding."""
    found = simulate(journal(restitution, speeds=(0.3, 0.2, 0.0)), 0.1)
    energy = found.energy_balance()
    kinetic = np.asarray(energy.kinetic)
    assert np.diff(kinetic).max() < 1e-15 and float(np.abs(energy.error).max()) < 1e-12
    assert float(found.contact("B").indentation.max()) < 0.5 * STEP * np.hypot(0.3, 0.2)
    assert (
        kinetic[-1] == pytest.approx(kinetic[0], rel=1e-12)
        if restitution == 1
        else kinetic[-1] < 0.1 * kinetic[0]
    )


@pytest.mark.slow
def test_a_turning_journal_with_weight_loses_energy():
    """Speeds are of body axes, which turn: within a step of an impact the energy errs by step x
    spin x m v^2.
    """
    found = simulate(journal(0.9, 0.2, speeds=(0.3, 0.2, 5.0), gravity=(0.0, -GRAVITY)), 0.2)
    energy = found.energy_balance()
    total = np.asarray(energy.kinetic + energy.potential)
    assert np.diff(total).max() < STEP * 5.0 * 2 * total[0] and total[-1] < 0.1 * total[0]
    assert float(energy.contact_loss[-1]) > 0 and float(energy.friction_loss[-1]) > 0
    contact = found.contact("B")
    assert (
        float(contact.indentation.max()) < 0.5 * STEP * np.hypot(0.3, 0.2)
        and float(contact.normal_force.min()) >= 0
    )
    # At rest at last: a step's fall, and that of the turning normal.
    assert float(contact.indentation[-1, 0]) < 2 * STEP**2 * GRAVITY


def test_a_resting_journal_carries_its_weight():
    found = simulate(journal(0.9, 0.2, start=(0.0, -CLEARANCE, 0.0), gravity=(0.0, -GRAVITY)), 0.1)
    np.testing.assert_allclose(
        found.contact("B").force[1:], np.tile([0.0, MASS * GRAVITY, 0.0], (100, 1)), atol=1e-10
    )
    assert float(np.abs(found.speed("body")).max()) < 1e-15


STARTS = {
    "concentric": 0.0,
    "exactly touching": CLEARANCE,
    "just open": CLEARANCE * (1 - 1e-15),
    "overlapping": 1.1 * CLEARANCE,
}


@pytest.mark.parametrize("name", STARTS)
def test_every_start_is_finite_and_ends_inside(name):
    for gravity in ((0.0, 0.0), (0.0, -GRAVITY)):
        found = simulate(
            journal(
                0.5, 0.2, start=(STARTS[name], 0.0, 0.0), speeds=(0.0, 0.0, 1.0), gravity=gravity
            ),
            0.01,
        )
        assert bool(jnp.all(jnp.isfinite(found.states))) and found.succeeded
        assert all(
            bool(jnp.all(jnp.isfinite(part))) for part in jax.tree.leaves(found.contact("B"))
        )
        assert float(found.contact("B").indentation[-1, 0]) < 2 * STEP**2 * GRAVITY
        if name == "concentric" and gravity[1] == 0:
            assert float(np.abs(found.contact("B").normal_force).max()) == 0


SPATIAL = ((1e-4, 3e-4, 2e-4), (0.1, 0.05, 0.2, 1.0, 2.0, 3.0), (0.3, -GRAVITY, 0.2))


def ball():
    return held(
        jc.clearance.BallSocket(
            jc.contact.Rigid(restitution=0.5),
            jc.friction.Coulomb(mu_kinetic=MU),
            clearance=CLEARANCE,
        ),
        *SPATIAL,
    )


def tilted():
    joint = jc.clearance.JournalBearing(
        jc.contact.Rigid(restitution=0.5), jc.friction.Coulomb(mu_kinetic=MU), clearance=CLEARANCE
    )
    return held(joint, *SPATIAL[:2], (0.3, -GRAVITY, 0.0))


def guide():
    joint = jc.clearance.SliderGuide(
        jc.contact.Rigid(restitution=0.5), jc.friction.Coulomb(mu_kinetic=MU), clearance=CLEARANCE
    )
    return held(joint, 1e-4, (0.5, 0.05, 1.0), (0.3, -GRAVITY), axis="x")


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        ball,
        pytest.param(tilted, marks=pytest.mark.slow),
        pytest.param(guide, marks=pytest.mark.slow),
        lambda: journal(0.5, MU, speeds=(0.3, 0.2, 5.0)),
    ],
)
def test_loops_are_native_and_contacts_keep_their_laws(make, caplog):
    """In a batch as alone; no overlap beyond a step's fall at last, no pull, no friction beyond the
    cone.
    """
    mechanism = make()
    q, v = guess(mechanism)

    def go(scale):
        return run(
            mechanism, q, scale * v, jnp.linspace(0.0, 0.05, 6), jc.integrator.MoreauJean(STEP)
        )

    with caplog.at_level(logging.INFO, logger=loop.LOG.name):
        alone = eqx.filter_jit(go)(1.0)
        batch = eqx.filter_jit(eqx.filter_vmap(lambda s: go(s).states))(jnp.array([0.5, 1.0, 0.0]))
    assert not caplog.records, caplog.text
    # Lanes of a batch add in another order; impacts multiply rounding.
    np.testing.assert_allclose(batch[1], alone.states, atol=1e-9)
    assert bool(jnp.all(jnp.isfinite(batch)))
    contact = alone.contact("B")
    assert float(contact.indentation[-1].max()) < 2 * STEP**2 * GRAVITY
    normal = np.asarray(contact.normal_force)
    assert normal.min() >= 0 and normal.max() > 0
    assert (np.asarray(contact.traction) <= MU * normal + 1e-10).all()


def hung(ratio):
    """A light link between ground and a heavy one, both joints with clearance."""
    pin = jc.clearance.PlanarJournalBearing(
        jc.contact.Rigid(restitution=0.0), jc.friction.Coulomb(mu_kinetic=MU), clearance=CLEARANCE
    )
    return jc.Mechanism(
        {
            "light": jc.Body(1.0, 1e-3, (0.05, 0.0)),
            "heavy": jc.Body(ratio, 1e-3 * ratio, (0.05, 0.0)),
        },
        {
            "B": jc.Connection(pin, "ground", "light"),
            "C": jc.Connection(pin, "light", "heavy", at=(0.1, 0.0)),
        },
        {"gravity": jc.load.Gravity((0.0, -GRAVITY))},
        start={"heavy": (0.1, 0.0, 0.0)},
    )


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.0, 10.0, 100.0])
def test_a_light_link_holds_a_heavy_one(ratio):
    found = simulate(hung(ratio), 0.2, save=201)
    energy = found.energy_balance()
    assert max(float(found.contact(name).indentation.max()) for name in "BC") < 0.05 * CLEARANCE
    assert float(np.abs(energy.error).max()) < 5e-3 * ratio * GRAVITY * 0.1


@pytest.mark.slow
def test_projection_puts_no_work_into_a_driven_mechanism():
    """The guide, driven: the balance closes with it as without, and friction is the same."""
    losses = []
    for project in (True, False):
        found = jc.simulate(
            jc.scenes.guide(),
            1.2,
            integrator=jc.integrator.MoreauJean(STEP, project=project),
            balance=True,
        )
        energy = found.energy_balance()
        assert float(np.abs(energy.error).max()) < 1e-6 * float(energy.input[-1])
        losses.append(float(energy.friction_loss[-1]))
    assert losses[0] == pytest.approx(losses[1], rel=1e-3)


def test_sentences_name_the_joint():
    compliant = jc.integrator.ImplicitStep()
    with pytest.raises(ValueError, match='joint "B" has contact.Rigid.*MoreauJean'):
        jc.simulate(journal(), 0.1, integrator=compliant)
    elastic = held(jc.clearance.PlanarJournalBearing(jc.contact.MarhefkaOrin()))
    with pytest.raises(
        ValueError, match='joint "B" has a contact law whose restitution.*contact.Rigid'
    ):
        jc.simulate(elastic, 0.1, integrator=jc.integrator.MoreauJean())

    class Mine(jc.friction.AbstractSlipFriction):
        def coulomb(self):
            return None

        def coefficient(self, slip_speed):
            return slip_speed

    with pytest.raises(ValueError, match='joint "B" has friction Mine.*friction.Coulomb'):
        rubbing = jc.clearance.PlanarJournalBearing(jc.contact.Rigid(), Mine())
        jc.simulate(held(rubbing), 0.1, integrator=jc.integrator.MoreauJean())


@pytest.mark.slow
def test_stiff_compliant_contact_tends_to_rigid_contact():
    """A slider-crank about its first impact: what differs is where it is while in contact, K^(-2/5)
    long (Hertz).
    """
    restitution, gap, grid = 0.9, 0.5e-3, 4e-6

    def motion(law, integrator):
        rig = jc.scenes.slider_crank(
            "planar", gap, contact=law, friction=None, crank_speed=100.0, gravity=None
        )
        run = jc.simulate(rig, 12e-3, save=3001, integrator=integrator, verify=False)
        reach = np.linalg.norm(np.asarray(run.contact("B").offset)[:, :2], axis=1) / gap
        return np.asarray(run.coordinate("G")), reach

    place, reach = motion(jc.contact.Rigid(restitution=restitution), jc.integrator.MoreauJean(1e-7))
    tops = (reach[1:-1] >= reach[:-2]) & (reach[1:-1] > reach[2:]) & (reach[1:-1] > 0.98)
    until = np.flatnonzero(tops)[1] + 2  # the second impact
    assert until * grid < 12e-3
    tight = jc.integrator.Adaptive(rtol=1e-10, atol=1e-12)
    errors = []
    for stiffness in (1e9, 1e10, 1e11):
        law = jc.contact.CarvalhoMartins(stiffness=stiffness, restitution=restitution)
        errors.append(np.abs(motion(law, tight)[0] - place)[:until].max())
    np.testing.assert_allclose(np.diff(np.log10(errors)), -0.4, atol=0.08)


@pytest.mark.slow
def test_wear_of_the_four_bar_is_that_of_the_reference():
    """From 0.1 to 0.3 s. In the first impacts the two differ: steel's take 0.75 ms, in which the
    journal slides on and the normal turns."""
    rig = jc.scenes.four_bar("planar")
    joint = rig.connections["B"].joint
    laws = (
        jc.contact.CarvalhoMartins(stiffness=joint.contact.stiffness, restitution=0.9),
        jc.friction.ThreeZone(mu_static=0.1, mu_kinetic=0.1, static_speed=1e-3, kinetic_speed=1e-2),
    )
    rig = eqx.tree_at(
        lambda m: (m.connections["B"].joint.contact, m.connections["B"].joint.friction), rig, laws
    )
    volumes = []
    for integrator in (
        jc.integrator.MoreauJean(1e-4),
        jc.integrator.Adaptive(rtol=1e-7, atol=1e-9),
    ):
        worn = jc.simulate(rig, 0.3, save=31, integrator=integrator).worn_volume("B", "bearing")
        volumes.append(float(worn[-1] - worn[10]))
    assert volumes[0] == pytest.approx(volumes[1], rel=0.03)


def test_a_closed_loop_without_clearance_keeps_its_balance():
    """Nothing strikes: multipliers alone close the loop, and the drive pays for what moves."""
    crank = jc.scenes.slider_crank("ideal")
    step = jc.integrator.MoreauJean(1e-4)
    balance = jc.simulate(crank, 0.02, save=11, integrator=step, balance=True).energy_balance()
    # theta method, order 2: steps of 1e-4 s at 50 rad/s leave (5e-3)^2 of the energy
    np.testing.assert_allclose(balance.error, 0, atol=2.5e-5 * float(balance.kinetic.max()))


# A slider that falls on the wall of its guide: mass [kg], inertia [kg m^2], and so on.
SLIDER, INERTIA, HALF_LENGTH, GAP, FALL = 1.0, 1e-3, 0.02, 1e-3, 0.1
# Steps to the first impact.
BEFORE = 3.3


def landed(pitch, restitution):
    """Speed [m/s] and spin [rad/s] of a slider that has fallen on the wall with this pitch [rad],
    without gravity and friction."""
    guide = jc.clearance.SliderGuide(
        jc.contact.Rigid(restitution=restitution),
        width=0.02,
        length=2 * HALF_LENGTH,
        clearance=GAP,
    )
    height = -GAP + FALL * BEFORE * STEP + HALF_LENGTH * np.sin(abs(pitch))
    rig = jc.Mechanism(
        {"slider": jc.Body(SLIDER, INERTIA)},
        {"G": jc.Connection(guide, jc.Marker("ground", axis="x"), jc.Marker("slider", axis="x"))},
        start={"slider": (0.0, height, pitch)},
        speeds={"slider": (0.0, -FALL, 0.0)},
    )
    times = 10 * STEP
    run = jc.simulate(rig, times, integrator=jc.integrator.MoreauJean(STEP), save=3)
    return np.asarray(run.speed("slider"))[-1][[1, 2]]


def by_hand(pitch, restitution):
    """The corner that is lower strikes, then the other, if it still comes down."""
    sides = np.sign(pitch) * np.array([-1.0, 1.0])
    speed, spin = -FALL, 0.0
    for side in sides:
        own = 1 / SLIDER + HALF_LENGTH**2 / INERTIA
        closing = -(speed + side * HALF_LENGTH * spin)
        percussion = (1 + restitution) * max(closing, 0.0) / own
        speed += percussion / SLIDER
        spin += side * HALF_LENGTH * percussion / INERTIA
    return np.array([speed, spin])


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("pitch", [1e-5, -1e-5])
def test_corners_that_strike_within_a_step_strike_one_after_the_other(pitch, restitution):
    """They touch 4 us apart, in steps of 100 us; at once they would leave the slider level."""
    exact = by_hand(pitch, restitution)
    assert abs(exact[1]) > 0.1
    np.testing.assert_allclose(landed(pitch, restitution), exact, rtol=1e-3)


def test_corners_that_touch_at_once_strike_at_once():
    speed, spin = landed(0.0, 0.5)
    assert speed == pytest.approx(0.5 * FALL, rel=1e-9) and abs(spin) < 1e-9


@pytest.mark.parametrize("sweeps", [1, 20])
def test_steps_that_miss_their_laws_are_told(sweeps):
    """A slider that falls askew on the walls of its guide and rubs: one sweep is not enough."""
    guide = jc.clearance.SliderGuide(
        jc.contact.Rigid(restitution=0.4),
        jc.friction.Coulomb(mu_kinetic=0.2),
        width=0.02,
        length=2 * HALF_LENGTH,
        clearance=GAP,
    )
    rig = jc.Mechanism(
        {"slider": jc.Body(SLIDER, 1e-4)},
        {"G": jc.Connection(guide, "ground", "slider", axis="x")},
        {"gravity": jc.load.Gravity((0.3, -9.81))},
        speeds={"slider": (0.2, -0.05, 1.0)},
    )
    integrator = jc.integrator.MoreauJean(2e-4, max_sweeps=sweeps)
    run = jc.simulate(rig, 0.04, save=5, integrator=integrator, verify=False)
    residual = float(run.invariants.figures[Check.LAW_RESIDUAL].worst[0])
    missed = "Steps missed the laws of contact and friction by up to"
    assert run.succeeded and any(missed in each for each in run.warnings) == (sweeps == 1)
    assert (residual > 1e-3) if sweeps == 1 else (residual <= 1e-12)


def chain(overlaps):
    """Bars, one behind the other, each beyond (> 0) a rigid stop of its joint by so much [rad]."""
    numbers = range(len(overlaps))
    behind = ["ground", *(jc.Marker(f"bar {i}", (0.5, 0.0)) for i in numbers)]
    joints = {
        f"J{i}": jc.Connection(jc.joint.Revolute(), behind[i], jc.Marker(f"bar {i}", (-0.5, 0.0)))
        for i in numbers
    }
    return jc.Mechanism(
        {f"bar {i}": jc.Body(1.0, 0.01) for i in numbers},
        joints,
        {f"stop {i}": jc.load.JointStop(f"J{i}", upper=0.0, restitution=0.0) for i in numbers},
        start={f"J{i}": overlap for i, overlap in enumerate(overlaps)},
    )


@pytest.mark.filterwarnings("ignore:.*beyond stop")
@pytest.mark.parametrize("sweeps", [1, 50])
def test_steps_that_move_overlaps_apart_by_too_little_say_so(sweeps):
    """At rest nothing strikes: only what moves bars apart is searched for."""
    rig = chain([0.0034, 0.0082, 0.0033, -0.013])
    integrator = jc.integrator.MoreauJean(1e-3, max_sweeps=sweeps)
    run = jc.simulate(rig, 1e-3, save=2, integrator=integrator, verify=False)
    residual = float(run.invariants.figures[Check.LAW_RESIDUAL].worst[0])
    beyond = max(float(run.coordinate(f"J{i}")[-1]) for i in range(4))
    assert (residual > 1e-3) == (beyond > 1e-3) == (sweeps == 1)


@pytest.mark.parametrize("integrator", [jc.integrator.MoreauJean, jc.integrator.FixedStep])
def test_a_coupling_that_steps_do_not_follow_is_named(integrator):
    """omega^2 = stiffness (1 / J_a + ratio^2 / J_b) of two free wheels."""
    stiffness, ratio, inertias = 9e3, 2.0, (1e-3, 2e-3)
    joints = {
        "A": jc.Connection(jc.joint.Revolute(), "ground", "a"),
        "B": jc.Connection(jc.joint.Revolute(), jc.Marker("ground", (0.1, 0.0)), "b"),
    }
    rig = jc.Mechanism(
        {name: jc.Body(1.0, inertia) for name, inertia in zip("ab", inertias, strict=True)},
        joints,
        {"drive": jc.load.JointTorque("A", 1.0)},
        couplings={"belt": jc.coupling.Ratio("A", "B", ratio=ratio, stiffness=stiffness)},
    )
    omega = (stiffness * (1 / inertias[0] + ratio**2 / inertias[1])) ** 0.5
    with pytest.raises(jc.SimulationError, match='Coupling "belt" has a stiffness of 9e.03') as end:
        jc.simulate(rig, 0.2, save=5, integrator=integrator(1e-3))
    assert f"at {omega:.3g} rad/s" in str(end.value)
    assert f"shorter than {2 / omega:.2g} s" in str(end.value)
    steps = integrator(1.5 / omega)
    assert jc.simulate(rig, 0.2, save=5, integrator=steps, verify=False).succeeded
