"""Members defined here, outside the package, are full members: laws, a clearance joint and an ideal
joint.
"""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import Scalar, quantity
from tests.laws.contracts import contact_contract, friction_contract, wear_contract


class Cushion(jc.contact.AbstractElasticForce):
    """F = K delta + K delta^2 / d: a linear spring that stiffens over the depth d."""

    stiffness: Scalar = quantity(1e6, "N/m", "stiffness at touch")
    depth: Scalar = quantity(1e-3, "m", "depth over which the stiffness trebles")

    def force(self, indentation):
        depth = jc.numerics.positive_part(indentation)
        return self.stiffness * depth * (1 + depth / self.depth)


class Firm(jc.contact.AbstractRestitutionFactor):
    """d = 1.51 (1 - e), near Hunt and Crossley's."""

    restitution: Scalar = quantity(0.9, "1", "coefficient of restitution", above=0, at_most=1)

    def factor(self):
        return 1.51 * (1 - self.restitution)


class Leaking(jc.contact.AbstractContactLaw):
    """A spring with a damper that grows with the indentation: a law that is no product."""

    stiffness: Scalar = quantity(1e7, "N/m", "stiffness")
    damping: Scalar = quantity(1e6, "N s/m^2", "damping per indentation")
    restitution: ClassVar[None] = None
    memory_time: ClassVar[None] = None

    def normal_force(self, indentation, rate, impact_speed):
        damper = self.damping * jc.numerics.positive_part(indentation) * rate
        return jc.numerics.positive_part(self.elastic_force(indentation) + damper)

    def elastic_force(self, indentation):
        return self.stiffness * jc.numerics.positive_part(indentation)


class Saturating(jc.friction.AbstractSlipFriction):
    """mu v / (v + v_0) made smooth by a tanh at rest."""

    mu_kinetic: Scalar = quantity(0.2, "1", "coefficient at high speed")
    transition_speed: Scalar = quantity(1e-3, "m/s", "speed of half the friction")

    def coulomb(self):
        return jc.friction.Coulomb(mu_kinetic=self.mu_kinetic)

    def coefficient(self, slip_speed):
        return self.mu_kinetic * jc.numerics.smooth_sign(slip_speed, self.transition_speed)


class Erosion(jc.wear.AbstractWearLaw):
    """dV/dt = k F v^1, half of what Archard gives."""

    wear_coefficient: Scalar = quantity(1e-15, "m^2/N", "worn volume per load and distance")

    def volume_rate(self, normal_force, slip_speed, traction):
        return 0.5 * self.wear_coefficient * normal_force * slip_speed


class FloorAndCeiling(jc.clearance.AbstractClearance):
    """A point between two planes y = -c and y = c."""

    ideal_rows: ClassVar = ("y",)
    contact: jc.contact.AbstractContactLaw
    friction: Any = None
    clearance: Scalar = quantity(1e-2, "m", "room on either side")

    @property
    def axes(self):
        return ()

    def contact_laws(self):
        shape = jc.stiffness.Shape(1e-2, 1.0, None)
        return (jc.clearance.ContactLaws(self.contact, self.friction, shape, False),) * 2

    def indentations(self, offset, axes, worn):
        return tuple(side * offset[1] - self.clearance for side in (-1, 1))

    def contact_candidates(self, offset, axes, indentations):
        return tuple(
            jc.clearance.ContactCandidate(
                (offset[0], side * self.clearance, 0), (0, side, 0), ((1, 0, 0),)
            )
            for side in (-1, 1)
        )

    def permanent_form(self):
        return Skid(self)


class AlongX(jc.joint.AbstractVectorJoint):
    """Slides along x: q displacement [m]."""

    home: ClassVar = (0.0,)
    units: ClassVar = ("m",)
    rows: ClassVar = ("y", "z", "x.y", "x.z", "y.z")
    reversal: ClassVar = ((-1, 0, 0), (0, -1, 0), (0, 0, 1))

    def motion(self, q):
        return jc.pose.Pose(jc.pose.REST.rotation, (q[0], 0, 0))

    def columns(self, q):
        return (jc.pose.Twist((1, 0, 0), (0, 0, 0)),)

    def bias(self, q, v):
        return None

    def coordinates_at(self, pose):
        return (pose.translation[0],)

    def speeds_at(self, pose, velocity, spin):
        return (velocity[0],)


class Skid(jc.clearance.AbstractPermanentJoint):
    """The point between the planes while it always touches one of them, on a body that keeps its
    orientation."""

    home: ClassVar = AlongX.home
    units: ClassVar = AlongX.units
    rows: ClassVar = AlongX.rows
    reversal: ClassVar = AlongX.reversal
    gap: FloorAndCeiling

    @property
    def ideal(self):
        return AlongX()

    @property
    def friction(self):
        return self.gap.friction

    @property
    def arm(self):
        return 1

    def friction_wrench(self, friction):
        return (friction, 0, 0), (0, 0, 0)

    def carrying_ends(self, force, torque, ratio):
        contacts = []
        for index, side in enumerate((-1, 1)):
            normal = jc.numerics.positive_part(-side * force[1])
            place = (0, side * self.gap.clearance, 0)
            contact = jc.clearance.CarriedContact(index, normal, ratio * normal, place)
            contacts.append(contact)
        offset = (0, -jnp.sign(force[1]) * self.gap.clearance, 0)
        return (jc.clearance.CarryingEnd(0, (0, force[1], 0), offset, tuple(contacts)),)

    def friction_ratio(self, mu):
        return mu


class Screw(jc.joint.AbstractVectorJoint):
    """Turns about z and advances by `pitch` per radian: q angle [rad]."""

    home: ClassVar = (0.0,)
    units: ClassVar = ("rad",)
    rows: ClassVar = ("x", "y", "x.z", "y.z")
    reversal: ClassVar = jc.joint.FLIP
    pitch: Scalar = quantity(unit="m/rad", meaning="advance per radian")

    def motion(self, q):
        return jc.pose.Pose(jc.pose.rotation_z(q[0]), (0, 0, self.pitch * q[0]))

    def columns(self, q):
        return (jc.pose.Twist((0, 0, self.pitch), (0, 0, 1)),)

    def bias(self, q, v):
        return None

    def coordinates_at(self, pose):
        return (pose.translation[2] / self.pitch,)

    def speeds_at(self, pose, velocity, spin):
        return (spin[2],)


@pytest.mark.parametrize(
    ("contract", "law"),
    [
        (contact_contract, jc.contact.ContactForce(Cushion())),
        (contact_contract, jc.contact.ContactForce(Cushion(), Firm())),
        (contact_contract, Leaking()),
        (friction_contract, Saturating()),
        (wear_contract, Erosion()),
    ],
    ids=["elastic force", "dissipation factor", "additive", "friction", "wear"],
)
def test_law_passes_its_contract(contract, law):
    contract(law)


def test_outsiders_run_in_a_bearing():
    joint = jc.clearance.PlanarJournalBearing(
        jc.contact.ContactForce(Cushion(stiffness=1e7)),
        Saturating(),
        bearing_wear=jc.Wearing(Erosion(), cells=(12, 1)),
    )
    ring = jc.Mechanism(
        {"ring": jc.Body(1.0, 1e-3)},
        {"B": jc.Connection(joint, "ground", "ring")},
        {"g": jc.load.Gravity()},
        speeds={"ring": (0, 0, 50.0)},
    )
    end = jc.simulate(ring, 0.2, save=21, balance=True)
    contact, balance = end.contact("B"), end.energy_balance()
    assert contact.normal_force.max() > 0
    assert balance.friction_loss[-1] > 0 and end.worn_volume("B", "bearing")[-1] > 0
    # the integrator's tolerance of 1e-7 a step, over a few hundred steps
    np.testing.assert_allclose(balance.error, 0, atol=1e-5 * float(balance.kinetic[0]))


@pytest.mark.parametrize(
    "integrator",
    [
        jc.integrator.ImplicitStep(1e-4),
        jc.integrator.MoreauJean(1e-4),
        jc.integrator.NonColliding(1e-3),
    ],
    ids=lambda integrator: type(integrator).__name__,
)
def test_laws_from_outside_serve_every_formulation(integrator):
    law = jc.contact.ContactForce(Cushion(stiffness=1e7), Firm(restitution=0.8))
    joint = jc.clearance.PlanarJournalBearing(law, Saturating(), clearance=1e-4)
    pendulum = jc.Mechanism(
        {"arm": jc.Body(1.0, 1e-3, com=(0.1, 0.0))},
        {"B": jc.Connection(joint, "ground", "arm")},
        {"g": jc.load.Gravity()},
    )
    run = jc.simulate(pendulum, 2e-2, save=5, integrator=integrator, balance=True)
    assert run.succeeded and run.energy_balance().friction_loss[-1] > 0


def test_clearance_joint_from_outside_bounces_as_a_parabola():
    joint = FloorAndCeiling(jc.contact.ContactForce(Cushion(stiffness=1e7)))
    drop = jc.Mechanism(
        {"ball": jc.Body(1.0, 1e-3)},
        {"gap": jc.Connection(joint, "ground", "ball")},
        {"g": jc.load.Gravity()},
    )
    fall = np.sqrt(2 * 1e-2 / 9.81)
    end = jc.simulate(drop, 2 * fall, save=201)
    assert float(end.contact("gap").normal_force.max()) > 0
    # an elastic bounce delays the top of the parabola by T < pi sqrt(m/K) = 1e-3 s, which is g T^2
    # / 2 below it
    np.testing.assert_allclose(end.body("ball").com[-1, 1], 0.0, atol=1e-5)
    np.testing.assert_allclose(
        end.time[np.argmin(end.body("ball").com[:, 1])], fall, atol=2 * fall / 200
    )


def test_clearance_joint_from_outside_slides_to_rest_in_permanent_contact():
    mu, speed = 0.2, 1.0
    law = jc.contact.ContactForce(Cushion(stiffness=1e7))
    joint = FloorAndCeiling(law, jc.friction.Coulomb(mu_kinetic=mu))
    sled = jc.Mechanism(
        {"sled": jc.Body(1.0, 1e-3)},
        {"gap": jc.Connection(joint, "ground", "sled")},
        {"g": jc.load.Gravity()},
        speeds={"sled": (speed, 0, 0)},
    )
    run = jc.simulate(sled, 1.0, save=11, integrator=jc.integrator.NonColliding(1e-2))
    left = np.maximum(speed - mu * 9.81 * np.asarray(run.time), 0.0)
    # constant deceleration is exact for the step; where it stops is known to a step
    np.testing.assert_allclose(
        run.body("sled").com[:, 0], (speed**2 - left**2) / (2 * mu * 9.81), atol=mu * 9.81 * 1e-4
    )
    contact = run.contact("gap")
    np.testing.assert_allclose(contact.normal_force[1:, 0], 9.81, rtol=1e-9)
    np.testing.assert_allclose(contact.normal_force[:, 1], 0.0, atol=1e-9)
    np.testing.assert_allclose(contact.traction[1:6, 0], mu * 9.81, rtol=1e-6)


@pytest.mark.parametrize("turned_round", [False, True], ids=["from parent", "from child"])
def test_screw_from_outside_falls_as_its_formula(turned_round):
    pitch, mass, inertia = 0.01, 2.0, 3e-4
    ends = ("nut", "ground") if turned_round else ("ground", "nut")
    rig = jc.Mechanism(
        {"nut": jc.Body(mass, (2e-4, 2e-4, inertia))},
        {"thread": jc.Connection(Screw(pitch), *ends)},
        {"g": jc.load.Gravity((0.0, 0.0, -9.81))},
    )
    end = jc.simulate(rig, 0.5, save=6)
    acceleration = -mass * 9.81 * pitch / (inertia + mass * pitch**2)
    height = pitch * 0.5 * acceleration * np.asarray(end.time) ** 2
    # a parabola is exact for the integrator: rounding
    np.testing.assert_allclose(end.body("nut").com[:, 2], height, rtol=1e-9, atol=1e-12)


class PlasticContact(jc.formulation.AbstractFormulation):
    """Bodies that do not overlap and do not rebound, without friction: one percussion a contact,
    kept in the state as an impulse."""

    forces_are_means: ClassVar = True

    def check(self, mechanism, integrator, step):
        for name in mechanism.topology.clearances:
            if any(laws.friction for laws in mechanism.connections[name].joint.contact_laws()):
                raise ValueError(f'joint "{name}" rubs, which {integrator} knows nothing of.')

    def seen(self, mechanism):
        return mechanism

    def impulses(self, system):
        return tuple((name, len(b.contact_laws)) for name, b in system.bearings.items())

    def contact_joints(self, mechanism):
        return mechanism.topology.clearances

    def forces(self, instant):
        return instant.forces(jc.formulation.reports_of_means(instant))

    def contact(self, instant, name):
        report = jc.formulation.reports_of_means(instant)[name]
        return jc.formulation.clearance_contact(instant, report, name)

    def step(self, model, time_step, state, sweeps):
        """Explicit in the loads; contacts that overlap in the middle of the step are stopped."""
        entries, h = model.entries(state), time_step.length
        still = [0.0] * model.layout.speeds
        middle = jc.formulation.middle_of_step(model, time_step, entries, still)
        points = middle.free_motion.contacts
        closing = [point.rows[0] for point in points]
        delassus = jc.formulation.delassus_operator(middle.free_motion, closing)
        free = [v + h * a for v, a in zip(middle.v, delassus.free, strict=True)]
        # Along the rows, which measure the closing, a percussion is negative.
        p = [jnp.zeros(()) for _ in points]
        for _ in range(sweeps):
            for i, line in enumerate(delassus.matrix()):
                rate = jc.formulation.along(closing[i], free)
                rate = rate + sum(w * x for w, x in zip(line, p, strict=True))
                closed = points[i].gap_function.indentation > 0
                p[i] = jnp.where(closed, jnp.minimum(p[i] - rate / line[i], 0.0), 0.0)
        v = [a + b for a, b in zip(free, delassus.under(p)[0], strict=True)]
        mean = [0.5 * (a + b) for a, b in zip(middle.v, v, strict=True)]
        end = [*middle.end(model, mean, h), *v]
        return jnp.stack([*end, *(x - r for x, r in zip(entries[len(end) :], p, strict=True))])


class PlasticSteps(jc.integrator.AbstractIntegrator):
    """Equal steps with `PlasticContact`."""

    pathwise: ClassVar = False
    projects: ClassVar = True
    formulation: PlasticContact = eqx.field(default_factory=PlasticContact)
    step: Scalar = quantity(1e-4, "s", "length of a step", above=0)

    def relaxing_step(self, interval):
        return None

    def first_warm_start(self, model, start, state):
        return ()

    def advance(self, model, interval, state, warm_start):
        count = jnp.ceil((interval.stop - interval.start) / self.step * (1 - 1e-9)).astype(int)
        h = (interval.stop - interval.start) / count

        def one(i, state):
            time_step = jc.formulation.TimeStep(interval.start + i * h, h)
            return self.formulation.step(model, time_step, state, sweeps=3)

        end = jax.lax.fori_loop(0, count, one, state)
        return jc.integrator.Advance(end, count, 0 * count, (), jc.integrator.Outcome.REACHED)


class Ralston(jc.integrator.AbstractIntegrator):
    """Explicit steps of order 2 (Ralston 1962, Math. Comput. 16, 431) through compliant contact."""

    pathwise: ClassVar = True
    projects: ClassVar = True
    step: Scalar = quantity(1e-4, "s", "length of a step", above=0)

    @property
    def formulation(self):
        return jc.formulation.CompliantContact()

    def relaxing_step(self, interval):
        return self.step

    def first_warm_start(self, model, start, state):
        return ()

    def advance(self, model, interval, state, warm_start):
        count = jnp.ceil((interval.stop - interval.start) / self.step * (1 - 1e-9)).astype(int)
        h = (interval.stop - interval.start) / count
        rate = lambda time, y: self.formulation.rate(model, time, y)[0]

        def one(i, y):
            time = interval.start + i * h
            first = rate(time, y)
            return y + h * (first / 4 + 3 / 4 * rate(time + 2 / 3 * h, y + 2 / 3 * h * first))

        end = jax.lax.fori_loop(0, count, one, state)
        return jc.integrator.Advance(end, count, 0 * count, (), jc.integrator.Outcome.REACHED)


class LowestPoint(jc.response.AbstractResponse):
    """Lowest height of a body's centre of mass [m]."""

    body: str
    unit: str = "m"

    def __call__(self, run):
        return jnp.min(run.body(self.body).com[:, 1])


def dropped(friction=None):
    joint = FloorAndCeiling(jc.contact.ContactForce(Cushion(stiffness=1e7)), friction)
    return jc.Mechanism(
        {"ball": jc.Body(2.0, 1e-3)},
        {"gap": jc.Connection(joint, "ground", "ball")},
        {"g": jc.load.Gravity()},
    )


def test_formulation_from_outside_lands_without_rebound_and_tells_its_impulses():
    fall = np.sqrt(2 * 1e-2 / 9.81)
    end = jc.simulate(dropped(), 3 * fall, save=301, integrator=PlasticSteps())
    contact, weight = end.contact("gap"), 2.0 * 9.81
    on_the_floor = np.asarray(end.time) > 1.05 * fall
    # It lands within a step, and what it has sunk by then stays.
    np.testing.assert_allclose(end.body("ball").com[on_the_floor, 1], -1e-2, atol=1e-4 * 0.5)
    np.testing.assert_allclose(contact.normal_force[on_the_floor, 0], weight, rtol=1e-9)
    assert not np.any(contact.normal_force[:, 1])
    # It rests at the end: the floor's impulse is that of gravity, to rounding.
    impulse = np.sum(np.diff(end.time) * contact.normal_force[1:, 0])
    np.testing.assert_allclose(impulse, weight * end.time[-1], rtol=1e-9)
    np.testing.assert_allclose(end.reaction("gap").force[-1], [0, weight, 0], atol=1e-9)
    assert "gap.normal_force" in end.to_dataset() and "gap.impulse0" in end.state_names()


def test_formulation_from_outside_says_what_it_asks_of_laws():
    with pytest.raises(ValueError, match='joint "gap" rubs, which integrator.PlasticSteps knows'):
        jc.simulate(dropped(Saturating()), 1e-3, save=2, integrator=PlasticSteps())


def test_integrator_and_response_from_outside_serve_a_study():
    lowest = LowestPoint("ball")
    fall = np.sqrt(2 * 1e-2 / 9.81)
    problem = jc.Problem(
        dropped(),
        {"lowest": lowest},
        {"c": jc.Variable(lambda rig: rig.connections["gap"].joint.clearance, tolerance=1e-3)},
        duration=0.8 * fall,
        integrator=Ralston(),
    )
    found = jc.monte_carlo(problem, samples=4)
    # No sample has reached the floor: a parabola, exact for a method of order 2.
    np.testing.assert_allclose(found.responses["lowest"], -0.64e-2, rtol=1e-9)
    assert problem.units() == {"lowest": "m"}
    reference = jc.simulate(dropped(), 2 * fall, save=101)
    end = jc.simulate(dropped(), 2 * fall, save=101, integrator=Ralston(step=2e-5))
    # sqrt(K/m) h = 0.04: the bounce is off by its square, of a depth of 6e-5 m.
    np.testing.assert_allclose(lowest(end), lowest(reference), atol=1e-6)
