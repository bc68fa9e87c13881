"""Contacts with Coulomb friction solved contact by contact, each exactly, then all at once by
Newton's method.

v = W r + b; per contact, normal first, then one or two tangents: the reaction r lies in the cone
|r_t| <= mu r_n, v + mu |v_t| n in the dual cone, and the two are perpendicular: open (r = 0), stick
(v = 0) or slide (v_n = 0, r_t against v_t). An LCP is the same without tangents. Sources: De Saxce
& Feng 1998, Math. Comput. Model. 28, 225; Jourdan, Alart & Jean 1998, Comput. Methods Appl. Mech.
Eng. 155, 31 (sweeps); Bonnefon & Daviet 2011, INRIA RT-0400 (one contact); Alart & Curnier 1991,
ibid. 92, 353.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.complementarity.problem import (
    CORNER,
    LCP,
    LIMIT,
    NOT_FINITE,
    REDUNDANT,
    SOLVED,
    AbstractProblem,
    AbstractSolver,
    PivotingResult,
    Scaled,
    Solution,
    as_floats,
    check_shapes,
    excuse,
    power_of_two,
    solve_exactly,
)
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.quantity import Scalar, quantity

# Newton steps for the sliding direction of one contact; 6 reach rounding in 99 of 100
# well-conditioned contacts, 10 in 999 of 1000 ill-conditioned ones (measured).
LOCAL_STEPS = 10
# Sweeps between two tries of Newton's method for all contacts.
SWEEPS = 5
# Added to scaled sticking rows in Newton's method, so that redundant contacts leave a regular
# system.
REGULAR = 1e-12


def project_on_cone(r: Float[Array, " d"], mu: Scalar) -> Float[Array, " d"]:
    """The point of the cone |r_t| <= mu r_n nearest to r; of the half-line r_n >= 0 where there are
    no tangents.
    """
    if r.shape[0] == 1:
        return jnp.maximum(r, 0.0)
    size = safe_sqrt(jnp.sum(r[1:] ** 2))
    normal = jnp.maximum(r[0] + mu * size, 0.0) / (1 + mu**2)
    tangent = safe_divide(mu * normal, size) * r[1:]
    outside = jnp.concatenate([normal[None], tangent])
    return jnp.where((size <= mu * r[0]) & (r[0] >= 0), r, outside)


def saxce_residual(
    r: Float[Array, "c d"], v: Float[Array, "c d"], mu: Float[Array, " c"], rho: Float[Array, " c"]
) -> Float[Array, "c d"]:
    """r - projection of r - rho (v + mu |v_t| n) on the cone, for every contact: zero exactly at a
    solution (De Saxce & Feng).
    """
    lifted = v.at[:, 0].add(mu * safe_sqrt(jnp.sum(v[:, 1:] ** 2, 1)))
    return r - jax.vmap(project_on_cone)(r - rho[:, None] * lifted, mu)


class FrictionContact(AbstractProblem):
    """v = W r + b with Coulomb's law at every contact; z = r are reactions (or percussions) and w =
    v velocities.

    Unknowns are ordered contact by contact: normal, then one tangent (planar) or two (spatial).
    `mu` holds one coefficient for each contact. Planar problems are LCPs of three rows a contact
    (Pfeiffer & Glocker 1996, Multibody Dynamics with Unilateral Contacts): r_n perp v_n, mu r_n +
    r_t perp v_right, v_left perp mu r_n - r_t, v_t = v_right - v_left. Spatial ones are not.
    """

    delassus: Float[Array, "m m"] = eqx.field(converter=as_floats)
    free_velocity: Float[Array, " m"] = eqx.field(converter=as_floats)
    mu: Float[Array, " c"] = eqx.field(converter=as_floats)

    def __check_init__(self):
        m, c = jnp.size(self.free_velocity), jnp.size(self.mu)
        expected = {"free_velocity": (m,), "mu": (c,), "delassus": (m, m)}
        check_shapes(
            "a FrictionContact",
            {name: (getattr(self, name), shape) for name, shape in expected.items()},
        )
        if c == 0 or m not in (2 * c, 3 * c):
            raise ValueError(
                f"a FrictionContact with {c} coefficients mu has {2 * c} (planar) or {3 * c} "
                f"(spatial) rows, not {m}."
            )
        if not isinstance(self.mu, jax.core.Tracer) and bool(jnp.any(self.mu < 0)):
            raise ValueError(
                f"mu of a FrictionContact is {self.mu}; no coefficient may be negative."
            )

    @property
    def dimension(self) -> int:
        """2 for planar, 3 for spatial contacts."""
        return self.free_velocity.shape[0] // self.mu.shape[0]

    def _planar(self):
        if self.dimension != 2:
            raise ValueError(
                "spatial friction cones are not linear complementarity; solve them by "
                "ProjectedGaussSeidel."
            )
        c = self.mu.shape[0]
        # r = turn @ (r_n, mu r_n + r_t) for all normals first
        eye, zero = jnp.eye(c), jnp.zeros((c, c))
        turn = (
            jnp.zeros((2 * c, 2 * c))
            .at[::2, :c]
            .set(eye)
            .at[1::2, :c]
            .set(-jnp.diag(self.mu))
            .at[1::2, c:]
            .set(eye)
        )
        return c, eye, zero, turn

    def to_lcp(self):
        c, eye, zero, turn = self._planar()
        order = jnp.concatenate([jnp.arange(c) * 2, jnp.arange(c) * 2 + 1])
        velocity = (self.delassus @ turn)[order]
        left = jnp.concatenate([zero, eye])
        matrix = jnp.block([[velocity, left], [2 * jnp.diag(self.mu), -eye, zero]])
        return LCP(matrix, jnp.append(self.free_velocity[order], jnp.zeros(c)))

    def from_lcp(self, z):
        c, _, _, turn = self._planar()
        reaction = turn @ z[: 2 * c]
        return reaction, self.delassus @ reaction + self.free_velocity

    def residual(self, z, w):
        c = self.mu.shape[0]
        saxce = jnp.max(
            jnp.abs(saxce_residual(z.reshape(c, -1), w.reshape(c, -1), self.mu, jnp.ones(c)))
        )
        return jnp.maximum(saxce, jnp.max(jnp.abs(self.delassus @ z + self.free_velocity - w)))


class Contacts(NamedTuple):
    """Blocks: v_i = rows_i r + velocity_i; own_i is the contact's own block, and r_i - rho_i v_i a
    sum of like units.
    """

    rows: Float[Array, "c d m"]
    velocity: Float[Array, "c d"]
    mu: Float[Array, " c"]
    own: Float[Array, "c d d"]
    rho: Float[Array, " c"]


def _contacts(matrix, offset, mu) -> Contacts:
    c, d = mu.shape[0], offset.shape[0] // mu.shape[0]
    # Slices, not a gather: a time loop with these stays one kernel.
    own = jnp.stack([matrix[i * d : (i + 1) * d, i * d : (i + 1) * d] for i in range(c)])
    largest = jax.lax.stop_gradient(jnp.max(jnp.stack([own[:, k, k] for k in range(d)]), 0))
    rho = 1 / jnp.where(largest > 0, largest, 1.0)
    return Contacts(matrix.reshape(c, d, c * d), offset.reshape(c, d), mu, own, rho)


def _velocity(contacts: Contacts, r):
    return contacts.rows @ r.reshape(-1) + contacts.velocity


def _error(contacts: Contacts, r):
    """Largest residual as a velocity, relative to the data (scaled to 1) or the size of the
    reactions; infinite if not finite.
    """
    v = _velocity(contacts, r)
    residual = saxce_residual(r, v, contacts.mu, contacts.rho)
    return jnp.where(
        jnp.all(jnp.isfinite(r + v)),
        jnp.max(jnp.abs(residual) / contacts.rho[:, None]) / excuse(r),
        jnp.inf,
    )


def one_contact(
    own: Float[Array, "d d"], free: Float[Array, " d"], mu: Scalar
) -> Float[Array, " d"]:
    """Reaction of a single contact with v = own r + free; it exists for every positive definite
    `own`, and is found up to condition numbers of some 1e8.

    Sliding with v_t = -alpha r_t makes r the solution of (own + alpha on the tangents) r = -free:
    stick at alpha = 0; otherwise mu r_n / |r_t| - 1, nearly linear in alpha, has a root, which
    Newton's method finds between bounds.
    """
    stiff = jnp.where(own[0, 0] > 0, own[0, 0], jnp.inf)
    pressed = free[0] < 0
    if free.shape[0] == 1:
        return jnp.where(pressed, -free / stiff, 0.0)
    coupling = own[0, 1:] / stiff
    tangents = own[1:, 1:] - jnp.outer(own[1:, 0], coupling)
    push = free[1:] - own[1:, 0] * free[0] / stiff
    normal = lambda tangent: -free[0] / stiff - coupling @ tangent
    stick = -_inverse(tangents, 0.0) @ push
    sticks = safe_sqrt(stick @ stick) <= mu * normal(stick)
    direction = (
        -jnp.sign(push)
        if free.shape[0] == 2
        else _sliding_direction(tangents, push, normal, coupling, mu)
    )
    resistance = stiff + mu * (own[0, 1:] @ direction)
    pressure = safe_divide(-free[0], jnp.maximum(resistance, 0.0))
    slide = jnp.append(pressure, pressure * mu * direction)
    return jnp.where(pressed, jnp.where(sticks, jnp.append(normal(stick), stick), slide), 0.0)


def _inverse(matrix, alpha):
    """(matrix + alpha)^-1 for one or two rows, zero where it is singular."""
    if matrix.shape[0] == 1:
        return safe_divide(1.0, matrix + alpha)
    a, b, c, d = matrix[0, 0] + alpha, matrix[0, 1], matrix[1, 0], matrix[1, 1] + alpha
    return safe_divide(1.0, a * d - b * c) * jnp.array([[d, -b], [-c, a]])


def _sliding_direction(tangents, push, normal, coupling, mu):
    """Direction of the tangential reaction of a sliding spatial contact."""

    def improve(_, carry):
        alpha, low, high = carry
        inverse = _inverse(tangents, alpha)
        tangent = -inverse @ push
        slope = -inverse @ tangent
        size = safe_sqrt(tangent @ tangent)
        share = safe_divide(mu * normal(tangent), size)
        rate = safe_divide(-mu * (coupling @ slope), size) - share * safe_divide(
            tangent @ slope, size * size
        )
        low, high = jnp.where(share < 1, alpha, low), jnp.where(share < 1, high, alpha)
        newton = alpha - safe_divide(share - 1, rate)
        middle = jnp.where(jnp.isfinite(high), 0.5 * (low + high), 2 * low + jnp.trace(tangents))
        return jnp.where((newton >= low) & (newton <= high) & (rate > 0), newton, middle), low, high

    alpha, _, _ = jax.lax.fori_loop(0, LOCAL_STEPS, improve, (0.0, 0.0, jnp.inf))
    tangent = -_inverse(tangents, alpha) @ push
    return safe_divide(1.0, safe_sqrt(tangent @ tangent)) * tangent


def _sweep(contacts: Contacts, r, over_relaxation):
    def one(i, r):
        free = contacts.rows[i] @ r.reshape(-1) + contacts.velocity[i] - contacts.own[i] @ r[i]
        solved = one_contact(contacts.own[i], free, contacts.mu[i])
        return r.at[i].set(
            project_on_cone(r[i] + over_relaxation * (solved - r[i]), contacts.mu[i])
        )

    return jax.lax.fori_loop(0, r.shape[0], one, r)


class Law(NamedTuple):
    """One contact's law F(r, s, mu) = 0 linearised, dF = of_r dr + of_s ds + of_mu dmu."""

    value: Float[Array, " d"]
    of_r: Float[Array, "d d"]
    of_s: Float[Array, "d d"]
    of_mu: Float[Array, " d"]


def law(r: Float[Array, " d"], s: Float[Array, " d"], mu: Scalar, margin: Scalar) -> Law:
    """The law of open, stick or slide, whichever r - s tells, for s = rho v (Alart & Curnier).

    Within `margin` a contact that just touches without force counts as open, one on the edge of its
    cone without slip as sticking.
    """
    d = r.shape[0]
    eye, zero, none = jnp.eye(d), jnp.zeros((d, d)), jnp.zeros(d)
    pushed = jax.lax.stop_gradient(r[0] - s[0])
    opened, stuck = Law(r, eye, zero, none), Law(s, zero, eye, none)
    if d == 1:
        return jax.tree.map(lambda a, b: jnp.where(pushed > margin, b, a), opened, stuck)
    trial = r[1:] - s[1:]
    size = safe_sqrt(trial @ trial)
    unit = safe_divide(1.0, size) * trial
    turning = safe_divide(mu * r[0], size) * (jnp.eye(d - 1) - jnp.outer(unit, unit))
    slid = Law(
        jnp.append(s[0], r[1:] - mu * r[0] * unit),
        zero.at[1:, 1:].set(jnp.eye(d - 1) - turning).at[1:, 0].set(-mu * unit),
        zero.at[0, 0].set(1.0).at[1:, 1:].set(turning),
        none.at[1:].set(-r[0] * unit),
    )
    slides = jax.lax.stop_gradient((size > mu * pushed + margin) | (mu <= 0))
    choose = lambda a, b, c: jnp.where(pushed > margin, jnp.where(slides, c, b), a)
    return jax.tree.map(choose, opened, stuck, slid)


def _laws(contacts: Contacts, r, margin) -> tuple[Law, Float[Array, "m m"]]:
    """All contacts' laws, and the Jacobian of F(r, rho (W r + b)) with respect to r."""
    c, d = r.shape
    s = contacts.rho[:, None] * _velocity(contacts, r)
    margin = margin * jax.lax.stop_gradient(jnp.maximum(jnp.max(jnp.abs(r)), jnp.max(jnp.abs(s))))
    laws = jax.vmap(law, (0, 0, 0, None))(r, s, contacts.mu, margin)
    through_s = (laws.of_s @ (contacts.rho[:, None, None] * contacts.rows)).reshape(c * d, c * d)
    return laws, _block_diagonal(laws.of_r) + through_s


def _block_diagonal(blocks):
    c, d, _ = blocks.shape
    return (
        jnp.zeros((c, d, c, d))
        .at[jnp.arange(c), :, jnp.arange(c)]
        .set(blocks)
        .reshape(c * d, c * d)
    )


def _newton(contacts: Contacts, r):
    """One step for all contacts at once in the states they are in, brought back into the cones."""
    laws, jacobian = _laws(contacts, r, 0.0)
    step = jnp.linalg.solve(jacobian + REGULAR * _block_diagonal(laws.of_s), laws.value.reshape(-1))
    return jax.vmap(project_on_cone)(r - step.reshape(r.shape), contacts.mu)


@jax.custom_jvp
def follow_contacts(r, solved, matrix, offset, mu):
    """r unchanged, with the derivatives of the solution whose contacts keep their states; zero
    where not `solved`.

    Where contacts are redundant, those of the least change of r.
    """
    return r


@follow_contacts.defjvp
def _follow_contacts_jvp(primals, tangents):
    r, solved, matrix, offset, mu = primals
    _, _, d_matrix, d_offset, d_mu = tangents
    out = follow_contacts(*primals)
    contacts = _contacts(
        jnp.where(solved, matrix, jnp.eye(r.shape[0])), jnp.where(solved, offset, 0.0), mu
    )
    blocks = out.reshape(contacts.velocity.shape)
    laws, jacobian = _laws(contacts, blocks, CORNER)
    moved = contacts.rho[:, None] * (d_matrix @ out + d_offset).reshape(blocks.shape)
    change = jnp.einsum("cij,cj->ci", laws.of_s, moved) + laws.of_mu * d_mu[:, None]
    change = jnp.where(solved, change.reshape(-1), 0.0)
    return out, -jnp.linalg.pinv(jacobian, rtol=REDUNDANT) @ change


class ProjectedGaussSeidel(AbstractSolver):
    """Sweeps over the contacts, each solved exactly, with Newton's method for all at once whenever
    it comes nearer.

    The solver for spatial friction, and for LCPs with positive diagonal. Converges for symmetric
    positive semidefinite matrices without friction (slowly, perhaps beyond `most_sweeps`, where
    ranks are deficient); with friction nearly always where contacts are not too redundant.
    `newton=False` leaves the plain sweeps, which close in only linearly. Derivatives keep the state
    of every contact. Between two states they are one-sided: a contact that touches without force
    stays open, one at the edge of its cone without slip sticks. Of redundant contacts they are the
    least.
    """

    over_relaxation: Scalar = quantity(
        1.0, "1", "share of the exact step that is taken", above=0, below=2
    )
    tolerance: Scalar = quantity(
        1e-12, "1", "residual relative to the data at which to stop", above=0
    )
    most_sweeps: int = eqx.field(static=True, default=1000)
    newton: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if not (isinstance(self.most_sweeps, int) and self.most_sweeps > 0):
            raise ValueError(
                f"most_sweeps of ProjectedGaussSeidel is {self.most_sweeps!r}; it must be a "
                "positive whole number."
            )

    def solve(self, problem: AbstractProblem) -> Solution:
        if isinstance(problem, FrictionContact):
            return self._solve_contacts(problem)
        return solve_exactly(problem, self._solve_lcp, singular=True)

    def _solve_lcp(self, problem: Scaled) -> PivotingResult:
        n = problem.offset.shape[0]
        r, outcome, sweeps = self._iterate(_contacts(problem.matrix, problem.offset, jnp.zeros(n)))
        z = r[:, 0]
        return PivotingResult(z, z > problem.matrix @ z + problem.offset + CORNER, outcome, sweeps)

    def _solve_contacts(self, problem: FrictionContact) -> Solution:
        matrix, offset, mu = jax.lax.stop_gradient(
            (problem.delassus, problem.free_velocity, problem.mu)
        )
        finite = (
            jnp.all(jnp.isfinite(matrix))
            & jnp.all(jnp.isfinite(offset))
            & jnp.all(mu >= 0)
            & jnp.all(jnp.isfinite(mu))
        )
        matrix, offset, mu = (jnp.where(finite, x, 0.0) for x in (matrix, offset, mu))
        w_scale, m_scale = (
            power_of_two(jnp.max(jnp.abs(offset))),
            power_of_two(jnp.max(jnp.abs(matrix))),
        )
        found, outcome, sweeps = self._iterate(_contacts(matrix / m_scale, offset / w_scale, mu))
        outcome = jnp.where(finite, outcome, NOT_FINITE)
        kept = jax.lax.stop_gradient(found.reshape(-1) * w_scale / m_scale)
        r = follow_contacts(
            kept, outcome == SOLVED, problem.delassus, problem.free_velocity, problem.mu
        )
        v = problem.delassus @ r + problem.free_velocity
        return Solution(r, v, problem.residual(r, v), outcome, sweeps)

    def _iterate(self, contacts: Contacts):
        """(r, outcome, sweeps) for scaled contacts, from rest."""

        def running(carry):
            _, error, sweeps = carry
            return (error > self.tolerance) & (sweeps < self.most_sweeps)

        def tried(r, error):
            if not self.newton:
                return r, error
            there = _newton(contacts, r)
            error_there = _error(contacts, there)
            nearer = error_there < error
            return jnp.where(nearer, there, r), jnp.where(nearer, error_there, error)

        def improve(carry):
            r, _, sweeps = carry
            swept = jax.lax.fori_loop(
                0, SWEEPS, lambda _, r: _sweep(contacts, r, self.over_relaxation), r
            )
            swept, error = tried(swept, _error(contacts, swept))
            return jnp.where(jnp.isfinite(error), swept, r), error, sweeps + SWEEPS

        start = jnp.zeros_like(contacts.velocity)
        r, error, sweeps = jax.lax.while_loop(running, improve, (start, _error(contacts, start), 0))
        r, error = tried(r, error)
        outcome = jnp.where(
            error <= self.tolerance, SOLVED, jnp.where(jnp.isfinite(error), LIMIT, NOT_FINITE)
        )
        return r, outcome, sweeps
