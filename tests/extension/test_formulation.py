"""A formulation of a stranger, with the integrator that holds it."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear import Scalar, quantity
from tests.extension.test_clearance_joint import dropped
from tests.extension.test_friction_law import Saturating


class PlasticContact(jc.formulation.AbstractFormulation):
    """Bodies that do not overlap and do not rebound, without friction: one percussion a contact,
    kept in the state as an impulse."""

    forces_are_means: ClassVar = True

    def check(self, mechanism, integrator):
        for name in mechanism.topology.clearances:
            if any(laws.friction for laws in mechanism.connections[name].joint.contact_laws()):
                raise ValueError(f'joint "{name}" rubs, which {integrator} knows nothing of.')

    def modelled(self, mechanism):
        return mechanism

    def impulses(self, system):
        return tuple((name, len(b.contact_laws)) for name, b in system.bearings.items())

    def normal_impulses(self, system, name):
        return tuple(range(len(system.bearings[name].contact_laws)))

    def contact_joints(self, mechanism):
        return mechanism.topology.clearances

    def forces(self, instant):
        return instant.forces(jc.formulation.reports_of_means(instant))

    def contact(self, instant, name):
        return jc.formulation.clearance_contact(instant, self.forces(instant), name)

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
    step: Scalar = quantity(1e-4, "s", "length of a step", above=0)

    @property
    def formulation(self):
        return PlasticContact()

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
    np.testing.assert_allclose(end.contact_impulse("gap")[-1], impulse, rtol=1e-12)
    np.testing.assert_allclose(end.reaction("gap").force[-1], [0, weight, 0], atol=1e-9)
    assert "normal_force" in end.to_dataset()["gap"]
    assert "gap.normal_force" in end.to_dataset(flat=True) and "gap.impulse0" in end.state_names()


def test_formulation_from_outside_says_what_it_asks_of_laws():
    with pytest.raises(ValueError, match='joint "gap" rubs, which integrator.PlasticSteps knows'):
        jc.simulate(dropped(Saturating()), 1e-3, save=2, integrator=PlasticSteps())
