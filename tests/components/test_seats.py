"""Where a load presses a journal, ball or slider: of all poses that do not overlap, the one in
which the load has done the most work."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxclear as jc

CLEARANCE, LENGTH = 50e-6, 40e-3
LAW = jc.contact.Hertz()
JOINTS = {
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


@pytest.mark.parametrize("name", JOINTS)
def test_no_pose_yields_more_to_the_load(name):
    joint, rng = JOINTS[name], np.random.default_rng(3)
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
