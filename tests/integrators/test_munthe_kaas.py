"""Methods on groups: the exponentials are those of matrices, every order is seen, and rotations
never leave their group.
"""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import jaxclear as jc
from jaxclear.components.joint import AbstractGroupJoint
from jaxclear.formulations.model import Model
from jaxclear.ground import sparse as sp
from jaxclear.integrators.munthe_kaas import TABLEAUS, state_group
from jaxclear.multibody.state import lay_out
from jaxclear.multibody.system import prepare
from jaxclear.simulation.simulate import run

ORDERS = (1, 2, 3, 4)
# At rest, in the first digit that counts, on both sides of the end of the series (0.5), half a
# turn, and beyond a turn.
ANGLES = (0.0, 1e-160, 1e-9, 1e-4, 0.4999, 0.5001, 1.0, np.pi, 7.0)
MEMBERS = [
    kind
    for kind in AbstractGroupJoint.__subclasses__()
    if kind.__module__.startswith("jaxclear") and not kind.__name__.startswith("Abstract")
]
GROUPS = sorted(MEMBERS, key=lambda kind: kind.__name__)


def by_name(kind):
    return kind.__name__


def test_every_joint_of_a_group_is_here():
    assert [kind.__name__ for kind in GROUPS] == ["Free", "Planar", "Spherical"]


# --- exponentials and brackets ---


def skew(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def algebra(joint, increment):
    """The 4x4 matrix of an increment, from the joint's columns."""
    columns = np.array(
        [[*map(float, c.linear), *map(float, c.angular)] for c in joint.columns(joint.home)]
    )
    linear, angular = np.split(np.asarray(increment) @ columns, 2)
    return np.block([[skew(angular), linear[:, None]], [np.zeros((1, 4))]])


def place(joint, q):
    pose = joint.motion(tuple(q))
    out = np.eye(4)
    out[:3, :3] = [[float(x) for x in row] for row in pose.rotation]
    out[:3, 3] = [float(x) for x in pose.translation]
    return out


def somewhere(joint, rng):
    q = rng.normal(size=len(joint.home))
    if len(q) >= 4:
        q[-4:] /= np.linalg.norm(q[-4:])
    return jnp.asarray(q)


def moved(joint, q, increment):
    return sp.stack(joint.moved(tuple(q), tuple(jnp.asarray(increment))))


def increment_of(joint, angle, rng):
    u = rng.normal(size=len(joint.columns(joint.home)))
    turning = slice(-1, None) if len(u) == 3 and len(joint.home) == 3 else slice(-3, None)
    u[turning] *= angle / np.linalg.norm(u[turning])
    return u


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("kind", GROUPS, ids=by_name)
def test_exponential_is_that_of_matrices(kind, angle):
    rng, joint = np.random.default_rng(1), kind()
    q, u = somewhere(joint, rng), increment_of(joint, angle, rng)
    end = moved(joint, q, u)
    if len(q) >= 4:
        assert abs(np.linalg.norm(end[-4:]) - 1) < 4e-16
    # rounding of scipy's own scaling and squaring at seven radians
    np.testing.assert_allclose(
        place(joint, end), place(joint, q) @ expm(algebra(joint, u)), atol=5e-14
    )


@pytest.mark.parametrize("kind", GROUPS, ids=by_name)
def test_bracket_is_that_of_matrices(kind):
    rng, joint = np.random.default_rng(4), kind()
    a, b = rng.normal(size=(2, len(joint.columns(joint.home))))
    first, second = algebra(joint, a), algebra(joint, b)
    found = sp.stack(joint.bracket(tuple(a), tuple(b)))
    np.testing.assert_allclose(algebra(joint, found), first @ second - second @ first, atol=1e-15)


@pytest.mark.parametrize("kind", GROUPS, ids=by_name)
def test_derivatives_are_finite_and_start_as_the_rate(kind):
    rng, joint = np.random.default_rng(5), kind()
    q, u = somewhere(joint, rng), jnp.stack([increment_of(joint, angle, rng) for angle in ANGLES])

    def end(u):
        return moved(joint, q, u)

    @jax.jit
    @jax.vmap
    def derivatives(u):
        slope = lambda u: jax.jvp(end, (u,), (direction,))[1]
        (forward, second), backward = (
            jax.jvp(slope, (u,), (direction,)),
            jax.vjp(end, u)[1](other)[0],
        )
        return forward, second, backward, sp.stack(joint.rate(tuple(q), tuple(direction)))

    direction, other = (
        jnp.asarray(rng.normal(size=u.shape[1])),
        jnp.asarray(rng.normal(size=len(q))),
    )
    forward, second, backward, rate = derivatives(u.at[0].set(0.0))
    np.testing.assert_allclose(forward @ other, backward @ direction, atol=1e-13)
    assert np.all(np.isfinite(second))
    np.testing.assert_allclose(forward[0], rate[0], atol=1e-15)


# --- orders ---


def conditions(weights, tableau):
    """What is left of the conditions of order 1, 2, 3, 3, 4, 4, 4, 4 (Hairer, Norsett & Wanner
    1993, table II.2.1).
    """
    c, a, b = tableau.nodes, tableau.matrix, weights
    sums = (b.sum() - 1, b @ c - 1 / 2, b @ c**2 - 1 / 3, b @ a @ c - 1 / 6)
    return np.array(
        [
            *sums,
            b @ c**3 - 1 / 4,
            b @ (c * (a @ c)) - 1 / 8,
            b @ a @ c**2 - 1 / 12,
            b @ a @ a @ c - 1 / 24,
        ]
    )


@pytest.mark.parametrize("order", ORDERS)
def test_tableau_satisfies_its_order_conditions(order):
    tableau, first = TABLEAUS[order], (0, 1, 2, 4, 8)
    weights = tableau.matrix[-1]
    np.testing.assert_allclose(conditions(weights, tableau)[: first[order]], 0, atol=1e-15)
    compared = conditions(weights - tableau.error, tableau)
    np.testing.assert_allclose(compared[: first[tableau.error_order - 1]], 0, atol=1e-15)
    # what depends on time alone has an error too, and the estimate sees it
    assert max(abs(tableau.error @ tableau.nodes**k) for k in range(tableau.error_order)) > 1e-3


INERTIA, CENTRE, GRAVITY = (
    np.array([0.1, 0.2, 0.15]),
    np.array([1.0, 0.1, 0.05]),
    np.array([0.0, -9.81, 0.0]),
)
TWIST = (0.3, 0.1, -0.2, 0.5, 1.0, 2.0)


def floating():
    """An asymmetric body that tumbles without torque."""
    return jc.Mechanism(
        {"rod": jc.Body(1.0, tuple(INERTIA))},
        {"hold": jc.Connection(jc.joint.Free(), "ground", "rod")},
        speeds={"hold": TWIST},
    )


def pendulum():
    """A rod that swings and spins on a ball joint."""
    return jc.Mechanism(
        {"rod": jc.Body(1.0, tuple(INERTIA), tuple(CENTRE))},
        {"hold": jc.Connection(jc.joint.Spherical(), "ground", "rod")},
        {"gravity": jc.load.Gravity(tuple(GRAVITY))},
        start={"hold": (0.3, 0.2, 0.1)},
        speeds={"hold": TWIST[3:]},
    )


def solved_by_scipy(name, duration):
    """Rotation matrix, and speeds: Euler's equations with rotation matrices, by an independent
    solver.
    """
    held = name == "pendulum"
    inertia = np.diag(INERTIA) + (
        CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE) if held else 0
    )

    def rate(_, y):
        rotation, spin, linear = y[:9].reshape(3, 3), y[9:12], y[12:]
        torque = np.cross(CENTRE, rotation.T @ GRAVITY) if held else np.zeros(3)
        turning = np.linalg.solve(inertia, torque - np.cross(spin, inertia @ spin))
        return np.concatenate([(rotation @ skew(spin)).ravel(), turning, -np.cross(spin, linear)])

    start = Rotation.from_rotvec((0.3, 0.2, 0.1) if held else (0, 0, 0)).as_matrix()
    y = np.concatenate([start.ravel(), TWIST[3:], TWIST[:3]])
    end = solve_ivp(rate, (0, duration), y, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    return np.concatenate([end[:9], end[9:12] if held else np.concatenate([end[12:], end[9:12]])])


RIGS = {"floating": (floating(), 1.0), "pendulum": (pendulum(), 0.5)}
TRUTH = {name: solved_by_scipy(name, duration) for name, (_, duration) in RIGS.items()}


def error(name, integrator):
    mechanism, duration = RIGS[name]
    end = jc.simulate(mechanism, duration, save=2, integrator=integrator)
    rotation = np.asarray(end.body("rod").rotation)[-1]
    speeds = np.asarray(end.states[-1])[4 if name == "pendulum" else 7 :]
    return np.abs(np.concatenate([rotation.ravel(), speeds]) - TRUTH[name]).max()


@pytest.mark.parametrize("name", RIGS)
def test_order_of_fixed_steps(name):
    coarse, fine = (
        error(name, jc.integrator.FixedStep(RIGS[name][1] / n, "munthe_kaas4")) for n in (60, 120)
    )
    # the next term of the error moves the observed order by a few per cent at these steps
    assert abs(np.log2(coarse / fine) - 4) < 0.15
    assert coarse > 1e-9  # above rounding, or the order would mean nothing


def test_adaptive_steps_keep_their_tolerance_as_the_default_does():
    solver = jc.integrator.MuntheKaas(4)
    errors = [
        error("pendulum", jc.integrator.Adaptive(solver, rtol=rtol, atol=1e-2 * rtol))
        for rtol in (1e-6, 1e-7, 1e-8)
    ]
    # local errors of rtol add up over some tens of steps, and grow with the motion
    assert errors[0] < 1e-4 and errors[1] < 1e-5 and errors[2] < 1e-6
    assert error("pendulum", jc.integrator.Adaptive()) < 1e-5


def test_quaternion_stays_unit_over_1e5_steps():
    end = jc.simulate(
        floating(), 100.0, save=101, integrator=jc.integrator.FixedStep(1e-3, "munthe_kaas4")
    )
    length = np.linalg.norm(np.asarray(end.states)[:, 3:7], axis=1)
    # made unit after each step: two roundings, whatever the number of steps
    assert np.abs(length - 1).max() < 1e-15
    # and the motion is right: energy and angular momentum in space are kept to the method's own
    # order (h^4 times 1e5 steps)
    turned = (
        np.asarray(end.body("rod").rotation)
        @ (INERTIA * np.asarray(end.states)[:, 10:13])[..., None]
    )
    np.testing.assert_allclose(
        turned[..., 0], np.broadcast_to(INERTIA * TWIST[3:], (101, 3)), atol=1e-10
    )


@pytest.mark.slow
def test_impacts_on_the_group_agree_with_ordinary_steps():
    """A floating body in the plane is a group too; a touch is found inside a step, on the group."""
    bearing = jc.clearance.PlanarJournalBearing(
        jc.contact.Flores(stiffness=1e7, restitution=0.5), clearance=1e-3
    )
    drop = jc.Mechanism(
        {"journal": jc.Body(1.0, 1e-4)},
        {"B": jc.Connection(bearing, "ground", "journal")},
        {"gravity": jc.load.Gravity()},
        speeds={"journal": (0.05, 0.0, 2.0)},
    )
    integrators = (
        jc.integrator.Adaptive(jc.integrator.MuntheKaas(4)),
        jc.integrator.FixedStep(1e-6, "munthe_kaas4", contact_steps=2),
        jc.integrator.FixedStep(1e-6),
    )
    runs = [
        jc.simulate(drop, 0.03, save=7, integrator=i, state=jc.State(concentric=False))
        for i in integrators
    ]
    on_group, steps_on_group, ordinary = (np.asarray(r.body("journal").com) for r in runs)
    assert np.diff(ordinary[:, 1]).max() > 1e-5  # it has touched and gone up again
    # a thousandth of the clearance, as between all integrators (tests/time/test_integrators.py)
    np.testing.assert_allclose(on_group, ordinary, atol=1e-6)
    np.testing.assert_allclose(steps_on_group, ordinary, atol=1e-6)


# --- groups ---


class OfJoint(jc.integrator.AbstractGroup):
    joint: AbstractGroupJoint

    def moved(self, y, increment):
        return moved(self.joint, y, increment)

    def bracket(self, a, b):
        return sp.stack(self.joint.bracket(tuple(a), tuple(b)))

    def tangent(self, y, increment):
        return sp.stack(self.joint.rate(tuple(y), tuple(increment)))


def test_state_within_a_step_is_on_the_group():
    joint, twist = jc.joint.Free(), jnp.asarray(TWIST)
    term = jc.integrator.GroupTerm(lambda t, y, args: twist, OfJoint(joint))
    solution = diffrax.diffeqsolve(
        term,
        jc.integrator.MuntheKaas(2),
        0.0,
        2.0,
        2.0,
        jnp.asarray(joint.home),
        saveat=diffrax.SaveAt(ts=(0.6, 2.0)),
        stepsize_controller=diffrax.ConstantStepSize(),
    )
    for time, y in zip(solution.ts, solution.ys, strict=True):
        np.testing.assert_allclose(place(joint, y), expm(algebra(joint, time * twist)), atol=2e-15)


class Affine(jc.integrator.AbstractGroup):
    """x -> a x + b as (a, b): a group of one's own, of increments (u, w) for the matrix [[u, w],
    [0, 0]].
    """

    def moved(self, y, increment):
        u, w = increment
        spread = jnp.where(u == 0, 1.0, jnp.expm1(u) / jnp.where(u == 0, 1.0, u))
        return jnp.stack([y[0] * jnp.exp(u), y[1] + y[0] * w * spread])

    def bracket(self, a, b):
        return jnp.stack([jnp.zeros(()), a[0] * b[1] - b[0] * a[1]])

    def tangent(self, y, increment):
        return y[0] * increment


# Those of order 1 and 2 take the rate of the increment for that of the state.
@pytest.mark.parametrize("order", ORDERS[1:])
def test_group_of_ones_own_with_time_running_both_ways(order):
    term = jc.integrator.GroupTerm(lambda t, y, args: jnp.stack([jnp.cos(t), 1 + t]), Affine())

    def solve(steps, start, stop, y):
        controller = diffrax.ConstantStepSize()
        start, stop = jnp.asarray(start), jnp.asarray(stop)
        h = (stop - start) / steps
        solver = jc.integrator.MuntheKaas(order)
        return diffrax.diffeqsolve(
            term, solver, start, stop, h, y, stepsize_controller=controller
        ).ys[-1]

    truth = [
        np.exp(np.sin(2.0)),
        quad(lambda t: np.exp(np.sin(t)) * (1 + t), 0, 2, epsabs=1e-13)[0],
    ]
    coarse, fine = (
        np.abs(solve(n, 0.0, 2.0, jnp.array([1.0, 0.0])) - np.array(truth)).max() for n in (40, 80)
    )
    assert abs(np.log2(coarse / fine) - order) < 0.15
    back = solve(80, 2.0, 0.0, jnp.asarray(truth))
    np.testing.assert_allclose(back, [1, 0], atol=4 * fine)


def test_scene_without_groups_traces_none():
    hinge = jc.Mechanism(
        {"rod": jc.Body(1.0, 0.1)}, {"hold": jc.Connection(jc.joint.Revolute(), "ground", "rod")}
    )
    system = prepare(hinge)
    group = state_group(Model(system, {}, None, lay_out(system)))
    assert group.joints == () and group.bracket(jnp.ones(2), jnp.ones(2)) is None
    program = jax.make_jaxpr(group.moved)(jnp.ones(2), jnp.ones(2))
    assert {equation.primitive.name for equation in program.eqns} <= {"slice", "add", "concatenate"}


# --- derivatives and refusals ---


def test_derivative_through_steps_from_rest():
    """From rest, without force, a speed w turns the body by w t: the quaternion's vector part grows
    as t / 2.
    """
    duration, integrator = 0.4, jc.integrator.FixedStep(0.1, "munthe_kaas4")
    ball = jc.Mechanism(
        {"rod": jc.Body(1.0, tuple(INERTIA))},
        {"hold": jc.Connection(jc.joint.Spherical(), "ground", "rod")},
    )

    def end(speeds):
        return run(
            ball,
            jnp.asarray(jc.joint.Spherical.home),
            speeds,
            jnp.array([0.0, duration]),
            integrator,
        ).states[-1]

    expected = np.vstack([np.zeros((1, 3)), np.eye(3) * duration / 2, np.eye(3)])
    direction = jnp.array([0.3, -1.0, 2.0])
    forward = jax.jit(lambda v: jax.jvp(end, (v,), (direction,))[1])(jnp.zeros(3))
    np.testing.assert_allclose(forward, expected @ direction, atol=1e-15)


@pytest.mark.parametrize("order", (0, 5, True))
def test_order_that_is_none_is_refused(order):
    with pytest.raises(ValueError, match="must be 1, 2, 3 or 4"):
        jc.integrator.MuntheKaas(order)


@pytest.mark.parametrize("method", ["euler", "munthe_kaas3"])
def test_fixed_steps_name_their_methods(method):
    names = '"semi_implicit", "heun", "rk4", "munthe_kaas4"'
    with pytest.raises(ValueError, match=f'fixed-step method "{method}".*{names}'):
        jc.integrator.FixedStep(1e-3, method)
