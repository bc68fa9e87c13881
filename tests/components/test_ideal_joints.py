"""Every ideal joint: columns, rates, bias and rows follow from `motion` by differentiation,
whichever end the tree starts at."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

import jaxclear as jc
from jaxclear.components.clearance import PermanentPrismatic, PermanentRevolute, PermanentSpherical
from jaxclear.components.joint import AbstractJoint
from jaxclear.ground import sparse as sp
from jaxclear.ground.pose import REST, Pose
from jaxclear.multibody import constraints, kinematics, loops
from jaxclear.multibody.system import prepare

ALL_ROWS = ("x", "y", "z", *(f"{a}.{b}" for a in "xyz" for b in "xyz"))


def members(abstract):
    found = set()
    for child in abstract.__subclasses__():
        found |= members(child)
        if not child.__name__.startswith("Abstract") and child.__module__.startswith("jaxclear"):
            found.add(child)
    return found


# A joint that always touches has the gap of a clearance joint; its motion does not depend on it.
GAPS = {
    PermanentRevolute: jc.clearance.JournalBearing(jc.contact.Rigid()),
    PermanentPrismatic: jc.clearance.SliderGuide(jc.contact.Rigid()),
    PermanentSpherical: jc.clearance.BallSocket(jc.contact.Rigid()),
}
JOINTS = sorted(members(AbstractJoint), key=lambda kind: kind.__name__)


def built(kind):
    return kind(GAPS[kind]) if kind in GAPS else kind()


def by_name(kind):
    return kind.__name__


def coordinates(kind, rng):
    q = rng.normal(size=len(kind.home))
    if len(q) in (4, 7):
        q[-4:] /= np.linalg.norm(q[-4:])
    return jnp.asarray(q)


def matrix(pose):
    return jnp.stack([sp.stack(row) for row in pose.rotation]), sp.stack(pose.translation)


def arrays(twist):
    return jnp.concatenate([sp.stack(twist.linear), sp.stack(twist.angular)])


def slide(joint, q, v):
    columns = joint.columns(tuple(q))
    return sum((arrays(column) * x for column, x in zip(columns, v, strict=True)), jnp.zeros(6))


def coordinate_rate(joint, q, v):
    return sp.stack(joint.rate(tuple(q), tuple(v)))


def speeds(joint, q, rng):
    return jnp.asarray(rng.normal(size=len(joint.columns(tuple(q)))))


@pytest.mark.parametrize("kind", JOINTS, ids=by_name)
def test_columns_are_the_twist_of_the_motion(kind):
    rng, joint = np.random.default_rng(1), built(kind)
    q = coordinates(kind, rng)
    v = speeds(joint, q, rng)
    pose = lambda q: matrix(joint.motion(tuple(q)))
    (rotation, _), (turning, moving) = jax.jvp(pose, (q,), (coordinate_rate(joint, q, v),))
    spin = rotation.T @ turning
    # derivatives are exact: rounding only
    np.testing.assert_allclose(spin, -spin.T, atol=1e-14)
    expected = jnp.concatenate(
        [rotation.T @ moving, jnp.stack([spin[2, 1], spin[0, 2], spin[1, 0]])]
    )
    np.testing.assert_allclose(slide(joint, q, v), expected, atol=1e-14)


@pytest.mark.parametrize("kind", JOINTS, ids=by_name)
def test_bias_is_the_change_of_the_columns(kind):
    rng, joint = np.random.default_rng(2), built(kind)
    q = coordinates(kind, rng)
    v = speeds(joint, q, rng)
    change = jax.jvp(lambda q: slide(joint, q, v), (q,), (coordinate_rate(joint, q, v),))[1]
    bias = joint.bias(tuple(q), tuple(v))
    np.testing.assert_allclose(np.zeros(6) if bias is None else arrays(bias), change, atol=1e-14)


@pytest.mark.parametrize("kind", JOINTS, ids=by_name)
def test_coordinates_and_speeds_follow_from_the_motion(kind):
    """Inverse kinematics, also as seen from the child's side."""
    rng, joint = np.random.default_rng(5), built(kind)
    q = coordinates(kind, rng)
    v = speeds(joint, q, rng)
    pose = joint.motion(tuple(q))
    twist = np.split(np.asarray(slide(joint, q, v)), 2)
    velocity, spin = (tuple(sp.apply(pose.rotation, tuple(part))) for part in twist)
    seen = loops.Relative(pose, velocity, spin)
    assert_same_motion(joint, q, v, seen)
    there_and_back = loops.reverse_relative(
        loops.reverse_relative(seen, joint.reversal), sp.transpose(joint.reversal)
    )
    assert_same_motion(joint, q, v, there_and_back)


def assert_same_motion(joint, q, v, seen):
    # rounding
    found = sp.stack(joint.speeds_at(*seen))
    np.testing.assert_allclose(found, v, atol=1e-14)
    there, wanted = (matrix(joint.motion(tuple(x))) for x in (joint.coordinates_at(seen.pose), q))
    for a, b in zip(there, wanted, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-14)


@pytest.mark.parametrize("kind", JOINTS, ids=by_name)
def test_moved_and_retracted_go_with_the_rate(kind):
    rng, joint = np.random.default_rng(6), built(kind)
    q = coordinates(kind, rng)
    v = speeds(joint, q, rng)
    for way in (joint.moved, joint.retracted):
        along = lambda h, way=way: sp.stack(way(tuple(q), tuple(h * x for x in v)))
        _, change = jax.jvp(along, (jnp.zeros(()),), (jnp.ones(()),))
        np.testing.assert_allclose(change, coordinate_rate(joint, q, v), atol=1e-14)


@pytest.mark.parametrize("kind", JOINTS, ids=by_name)
def test_home_is_the_drawing_and_counts_agree(kind):
    joint = built(kind)
    assert len(kind.home) == len(kind.units)
    assert len(joint.columns(kind.home)) + len(kind.rows) == 6
    rotation, translation = matrix(joint.motion(kind.home))
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(translation, 0)


@pytest.mark.parametrize("turned_round", [False, True], ids=["from parent", "from child"])
@pytest.mark.parametrize("kind", JOINTS, ids=by_name)
def test_rows_vanish_on_the_joints_own_motion(kind, turned_round):
    """The same constraint whether the connection is a branch of the tree, started at either end, or
    closes a loop."""
    rng = np.random.default_rng(3)
    fixed = jc.Marker("ground", (0.1, 0.2, 0.3), quaternion=tuple(rng.normal(size=4)))
    moving = jc.Marker("body", (0.3, 0.1, -0.2), quaternion=tuple(rng.normal(size=4)))
    connection = jc.Connection(built(kind), *((moving, fixed) if turned_round else (fixed, moving)))
    rig = jc.Mechanism({"body": jc.Body(1.0, (1.0, 1.2, 1.3), (0.1, 0.2, 0.3))}, {"J": connection})
    system = prepare(rig)
    q = tuple(coordinates(kind, rng))
    v = tuple(jnp.asarray(rng.normal(size=system.topology.speed_count)))
    motions = kinematics.link_motions(system, (q,), (v,), 0.0)
    frames = {"ground": REST, "body": system.links[0].frame}
    ends = (connection.parent, connection.child)
    poses = [frames[end.body].after(end.pose()) for end in ends]
    closure = loops.Closure(*poses, *[system.topology.index(end.body) for end in ends], kind.rows)
    found = constraints.constraint_rows(system, motions, closure)
    np.testing.assert_allclose(sp.stack(found.residuals), 0, atol=1e-14)
    np.testing.assert_allclose(sp.stack(found.rates), 0, atol=1e-14)


def test_rows_rates_and_accelerations_are_derivatives():
    """All rows between two moving bodies, against nested derivatives of the residual along the
    motion."""
    rng = np.random.default_rng(4)
    body = jc.Body(1.0, (1.0, 1.2, 1.3), (0.1, -0.2, 0.05))
    ends = [
        jc.Marker(name, tuple(rng.normal(size=3)), quaternion=tuple(rng.normal(size=4)))
        for name in ("first", "second")
    ]
    rig = jc.Mechanism(
        {"first": body, "second": body},
        {
            "A": jc.Connection(jc.joint.Free(), "ground", "first"),
            "B": jc.Connection(jc.joint.Universal(), "first", "second"),
        },
    )
    system = prepare(rig)
    frames = {
        branch.body: link.frame
        for branch, link in zip(system.topology.branches, system.links, strict=True)
    }
    poses = [frames[end.body].after(end.pose()) for end in ends]
    closure = loops.Closure(*poses, *[system.topology.index(end.body) for end in ends], ALL_ROWS)
    q = jnp.concatenate([coordinates(jc.joint.Free, rng), jnp.asarray(rng.normal(size=2))])
    v, a = jnp.asarray(rng.normal(size=8)), jnp.asarray(rng.normal(size=8))

    def split(x, first):
        return tuple(x[:first]), tuple(x[first:])

    def motions(q, v):
        return kinematics.link_motions(system, split(q, 7), split(v, 6), 0.0)

    def rate_of_q(q, v):
        pairs = zip(system.links, split(q, 7), split(v, 6), strict=True)
        return jnp.concatenate(
            [sp.stack(link.joint.rate(own_q, own_v)) for link, own_q, own_v in pairs]
        )

    def residual(q):
        return sp.stack(
            loops.residuals(ALL_ROWS, kinematics.relative_motion(closure, motions(q, v))[1])
        )

    def residual_rate(q, v):
        return jax.jvp(residual, (q,), (rate_of_q(q, v),))[1]

    _, second = jax.jvp(residual_rate, (q, v), (rate_of_q(q, v), a))
    moved = motions(q, v)
    found = constraints.constraint_rows(system, moved, closure)
    # exact derivatives on both sides: rounding
    np.testing.assert_allclose(sp.stack(found.rates), residual_rate(q, v), atol=1e-13)
    jacobian = np.array([[float(row.get(j, 0)) for j in range(8)] for row in found.jacobian])
    np.testing.assert_allclose(jacobian @ v, residual_rate(q, v), atol=1e-13)
    accelerations = kinematics.link_accelerations(system, moved, split(a, 6))
    view, pose, moving = kinematics.relative_motion(closure, moved)
    ends = [
        loops.marker_twist(accelerations[link], marker)
        for link, marker in (
            (closure.parent_link, closure.parent),
            (closure.child_link, closure.child),
        )
    ]
    faster = loops.relative_acceleration(pose, view, *ends)
    np.testing.assert_allclose(
        sp.stack(loops.row_accelerations(ALL_ROWS, pose, moving.spin, *faster)), second, atol=1e-12
    )


@pytest.mark.parametrize("kind", [jc.joint.Revolute, jc.joint.Cylindrical], ids=by_name)
def test_speeds_are_rates_of_the_coordinates_also_where_a_journal_leans(kind):
    joint, (velocity, spin) = kind(), np.random.default_rng(6).normal(size=(2, 3))

    def pose(time):
        turn = jaxlie.SO3.exp(time * spin) @ jaxlie.SO3.exp(jnp.asarray([0.1, -0.2, 2.5]))
        return Pose(tuple(map(tuple, turn.as_matrix())), tuple(time * velocity))

    @jax.jit
    def both(time):
        rates = jax.jacfwd(lambda now: sp.stack(joint.coordinates_at(pose(now))))(time)
        return sp.stack(joint.speeds_at(pose(time), tuple(velocity), tuple(spin))), rates

    np.testing.assert_allclose(*both(0.0), atol=1e-14)
