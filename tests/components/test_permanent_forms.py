"""What clearance joints become while they always touch, and the sentences of those that have no
such form.

Where a load presses a journal, ball or slider: of all poses that do not overlap, the one in
which the load has done the most work."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.formulations.permanent import permanent_joint
from jaxclear.ground import sparse as sp

RIGID = jc.contact.Rigid()
COULOMB = jc.friction.Coulomb(mu_kinetic=0.2)
JOINTS = {
    "planar": jc.clearance.PlanarJournalBearing(RIGID, COULOMB),
    "spatial": jc.clearance.JournalBearing(RIGID, COULOMB),
    "guide": jc.clearance.SliderGuide(RIGID, COULOMB),
}


class Wall(jc.clearance.AbstractClearance):
    """A point before a plane: nothing keeps it there."""

    ideal_rows: ClassVar = ("x",)
    contact: Any = RIGID

    @property
    def axes(self):
        return ()

    def contact_laws(self):
        shape = jc.stiffness.Shape(1e-2, 1.0, None)
        return (jc.clearance.ContactLaws(self.contact, None, shape, False),)

    def indentations(self, offset, axes, worn):
        return (offset[0],)

    def contact_candidates(self, offset, axes, indentations):
        return (jc.clearance.ContactCandidate(offset, (1, 0, 0), ()),)


class Worn(jc.clearance.AbstractClearance):
    """A joint that wears, and knows the joint that it becomes, but not what that wears."""

    ideal_rows: ClassVar = ("x", "y")

    @property
    def axes(self):
        return ()

    def contact_laws(self):
        return ()

    def indentations(self, offset, axes, worn):
        return ()

    def contact_candidates(self, offset, axes, indentations):
        return ()

    def maps(self):
        return {"bearing": None}

    def permanent_form(self):
        return jc.joint.Revolute()


REFUSED = {
    "wears": (Worn(), 'joint "B" is a Worn that wears, whose form in permanent contact, Revolute'),
    "none of its own": (Wall(), 'joint "B" is a Wall, which has no form in permanent contact'),
}


@pytest.mark.parametrize("case", REFUSED)
def test_joint_without_a_permanent_form_says_so(case):
    joint, sentence = REFUSED[case]
    with pytest.raises(ValueError, match=sentence):
        permanent_joint("B", joint)


def test_surface_of_a_joint_that_does_not_wear_is_refused():
    assert Wall().maps() == {}
    with pytest.raises(NotImplementedError, match="a Wall has no wear map for its side"):
        Wall().features("side", sp.ZERO, (), (), 0)


@pytest.mark.parametrize("name", JOINTS)
@pytest.mark.parametrize("ratio", [0.0, 0.15])
def test_carried_forces_add_up_to_the_reaction(name, ratio):
    """Forces of the contacts at their places against force and torque across the free direction;
    friction is the given share of the carried load."""
    joint = permanent_joint("B", JOINTS[name])
    force = tuple(map(jnp.asarray, (3.0, 0.0 if name == "guide" else -4.0, 0.0)))
    torque = {"planar": (0.0, 0.0, 0.0), "spatial": (0.02, 0.05, 0.0), "guide": (0.0, 0.2, 0.0)}
    ends = joint.carrying_ends(force, tuple(map(jnp.asarray, torque[name])), ratio)
    total = np.sum([sp.stack(end.force) for end in ends], 0)
    # rounding
    np.testing.assert_allclose(total, sp.stack(force), atol=1e-14)
    load = float(jc.clearance.carried_load(ends))
    friction = sum(contact.friction for end in ends for contact in end.contacts)
    np.testing.assert_allclose(friction, ratio * load, rtol=1e-12, atol=1e-15)
    moment = np.sum(
        [np.cross([0, 0, float(end.height)], np.asarray(sp.stack(end.force))) for end in ends], 0
    )
    if name == "guide":
        # friction acts at half the width from the axis, on either side
        for contact in (c for end in ends for c in end.contacts):
            moment += np.cross(sp.stack(contact.place), [0, 0, float(contact.friction)])
    np.testing.assert_allclose(moment[:2], torque[name][:2], atol=1e-14)


CLEARANCE, LENGTH = 50e-6, 40e-3
LAW = jc.contact.Hertz()
SEATS = {
    "planar": jc.clearance.PlanarJournalBearing(LAW, clearance=CLEARANCE),
    "spatial": jc.clearance.JournalBearing(LAW, clearance=CLEARANCE, length=LENGTH),
    "ball": jc.clearance.BallSocket(LAW, clearance=CLEARANCE),
    "slider": jc.clearance.SliderGuide(LAW, clearance=CLEARANCE, length=LENGTH),
}
# Components that the joint resists: offset x, y, z and slope dx/dz, dy/dz.
RESISTED = {"planar": 0b11, "spatial": 0b11011, "ball": 0b111, "slider": 0b1001}


def overlap(joint):
    def of(pose):
        x, y, z, along, across = pose
        axis = jnp.stack([along, across, 1.0 + 0 * x])
        axis = axis / jnp.linalg.norm(axis)
        first = jnp.stack([axis[2], 0 * x, -axis[0]]) / jnp.hypot(axis[2], axis[0])
        frame = (first, jnp.cross(axis, first), axis)
        own = tuple(tuple(frame[k]) for k in joint.axes)
        return jnp.max(jnp.stack(joint.indentations((x, y, z), own, {})))

    return jax.jit(jax.vmap(of))


@pytest.mark.parametrize("name", SEATS)
def test_no_pose_yields_more_to_the_load(name):
    joint, rng = SEATS[name], np.random.default_rng(3)
    free = np.array([bool(RESISTED[name] >> k & 1) for k in range(5)])
    scale = np.array([1, 1, 1, 2 / LENGTH, 2 / LENGTH]) * CLEARANCE
    inside_by = overlap(joint)
    for _ in range(6):
        force, torque = rng.normal(size=3), rng.normal(size=3) * LENGTH
        # Turning by the slopes is turning about y, and backwards about x.
        reaction = np.array([*force, torque[1], -torque[0]]) * free
        told = (tuple(reaction[:3]), (-reaction[4], reaction[3], 0.0))
        offset, slope = joint.seat(*(tuple(map(jnp.asarray, part)) for part in told))
        seat = np.array([float(x) for x in (*offset, *slope)]) * free
        # of second order in the slope
        assert abs(float(inside_by(seat[None])[0])) < 0.01 * CLEARANCE
        others = rng.uniform(-1, 1, (20000, 5)) * scale * free
        allowed = others[np.asarray(inside_by(others)) <= 0]
        assert len(allowed) > 200
        assert (-(allowed @ reaction)).max() <= -(seat @ reaction) * (1 + 0.01)


def test_a_tilted_collar_stops_by_its_rim():
    flange = jc.clearance.Flange(LAW, radius=14e-3, clearance=3 * CLEARANCE)
    joint = jc.clearance.JournalBearing(LAW, clearance=CLEARANCE, length=LENGTH, flange=flange)
    told = ((0.3, -0.2, 5.0), (1.0, 2.0, 0.0))
    offset, slope = joint.seat(*(tuple(map(jnp.asarray, part)) for part in told))
    pose = np.array([float(x) for x in (*offset, *slope)])
    assert pose[2] < 0 and abs(float(overlap(joint)(pose[None])[0])) < 0.01 * CLEARANCE
