"""Projected Gauss-Seidel: a sweep over the contacts, each solved exactly, then Newton's method for
all at once as long as it comes nearer; where it does not, the next sweep.

The step of Newton's method is the semismooth one, with the generalised Jacobian of Alart and
Curnier in the states in which the contacts are. It is damped by a multiple of the change of
reactions, added to the velocities of contacts that stick and to the slip of those that slide, as
Levenberg and Marquardt do: redundant contacts leave its matrix singular, and a body that is light
beside another nearly so. It is halved until it misses the laws by less. Sources: Jourdan, Alart &
Jean 1998, Comput. Methods Appl. Mech. Eng. 155, 31, doi:10.1016/S0045-7825(97)00137-0 (sweeps);
Alart & Curnier 1991, doi:10.1016/0045-7825(91)90022-X (Newton); Nocedal & Wright 2006, Numerical
Optimization, section 10.3, doi:10.1007/978-0-387-40065-5 (damping). Plain
operations on small arrays only, a row at a time, so that a time loop with these iterations stays
one kernel of machine code.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxclear.complementarity.contact_states import (
    REGULAR,
    Scaled,
    laws_missed,
    least_solution,
    linearise_laws,
    scaled_contacts,
    with_derivatives,
)
from jaxclear.complementarity.friction_cone import natural_map, one_contact, project_on_cone
from jaxclear.complementarity.friction_contact import FrictionContact
from jaxclear.complementarity.problem import AbstractSolver, Outcome, Solution, residual_size
from jaxclear.ground.factorisation import eliminate
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import Scalar, quantity
from jaxclear.ground.tangents import apply_if

# Unknowns beyond which a kernel leaves Newton's method out: there its elimination is written out.
LARGEST_ELIMINATED = 24
# How often a step of Newton's method is halved before a sweep takes its place, and the factor by
# which its damping [1], at least `REGULAR`, rises and falls with its success.
HALVINGS, STEP_OF_DAMPING = 3, 10.0


class Iterate(NamedTuple):
    """Where an iteration ended.

    Args:
        z: unknowns, an array (m,) [as the problem's z].
        residual: residual relative to the data [1].
        sweeps: number of sweeps taken, a count.
    """

    z: Float[Array, " m"]
    residual: Float[Array, ""]
    sweeps: Int[Array, ""]


class ProjectedGaussSeidel(AbstractSolver):
    """The solver of `FrictionContact`, planar or spatial.

    Converges for symmetric positive semidefinite W without friction (slowly, perhaps beyond
    `max_sweeps`, where ranks are deficient); with friction nearly always where contacts are not
    too redundant. Derivatives of `solve` keep the state of every contact. Between two states they
    are one-sided: a contact that touches without force stays open, one at the edge of its cone
    without slip sticks. Of redundant contacts they are the least.

    Args:
        tolerance: residual relative to the largest velocity at which to stop [1], > 0.
        max_sweeps: largest number of sweeps over the contacts [1], > 0.
    """

    tolerance: Scalar = quantity(1e-12, "1", above=0)
    max_sweeps: Scalar = quantity(1000.0, "1", above=0)

    def solve(self, problem: FrictionContact) -> Solution:
        check_double_precision()
        if not isinstance(problem, FrictionContact):
            raise ValueError(
                f"ProjectedGaussSeidel is given a {type(problem).__name__}; it solves a "
                "FrictionContact. For linear problems take InteriorPoint."
            )
        data = (*problem.acting(), problem.mu)
        finite = jnp.all(jnp.isfinite(jnp.concatenate([x.reshape(-1) for x in data])))
        finite = finite & jnp.all(problem.mu >= 0)
        blank = (jnp.eye(len(data[1])), jnp.zeros(()), jnp.zeros(()))

        def posed(valid):
            numbers = (jnp.where(valid, x, y) for x, y in zip(data, blank, strict=True))
            return FrictionContact(*numbers, problem.sizes)

        # A library's elimination: the written-out one takes XLA minutes to compile.
        last = self._iterate(jax.lax.stop_gradient(posed(finite)), None, in_kernel=False)
        solved = jnp.where(last.residual <= self.tolerance, Outcome.SOLVED, Outcome.LIMIT)
        outcome = jnp.where(finite & jnp.isfinite(last.residual), solved, Outcome.NOT_FINITE)
        r = jnp.where(jnp.isfinite(last.z), last.z, 0.0)
        # What is not solved is made harmless before it is differentiated.
        is_solved = outcome == Outcome.SOLVED
        known = posed(is_solved)
        r = with_derivatives(lambda r: laws_missed(known, r, 0.0), r, least_solution)
        v = jnp.stack(problem.delassus) @ r + problem.free_velocity
        return Solution(r, v, problem.residual(r, v), outcome, last.sweeps)

    def iterate(
        self, problem: FrictionContact, start: Array | None = None, sweep: bool = False
    ) -> Iterate:
        """The iteration itself, which a time step calls; for derivatives see `with_derivatives`.

        Args:
            problem: a `FrictionContact`.
            start: reactions to begin with, an array (m,) [as the problem's z]; None: zero.
            sweep: whether to take one sweep in any case: friction that moves nothing has no
                residual.

        Returns:
            the last `Iterate`.
        """
        return self._iterate(problem, start, in_kernel=True, sweep=sweep)

    def _iterate(
        self, problem: FrictionContact, start: Array | None, in_kernel: bool, sweep: bool = False
    ) -> Iterate:
        scaled = scaled_contacts(problem)
        unit = scaled.size / scaled.weight
        guess = [jnp.zeros(d) for d in problem.sizes]
        if start is not None:
            guess = [x / unit for x in problem.split(jnp.where(problem.acts, start, 0.0))]
        first = _sweep(scaled, tuple(guess)) if sweep else tuple(guess)
        settings = self.max_sweeps, self.tolerance, in_kernel
        reactions, residual, sweeps = _sweep_until(scaled, first, *settings)
        reaction = jnp.where(problem.acts, jnp.concatenate(reactions) * unit, 0.0)
        return Iterate(reaction, residual, sweeps)


def _residual(problem: Scaled, r: tuple) -> Array:
    """Largest entry of the natural map as a velocity, relative to the data (scaled to 1) or the
    size of the reactions; infinite if not finite.
    """
    flat = jnp.concatenate(r)
    sizes = []
    for i, part in enumerate(r):
        natural = natural_map(part, problem.velocity(i, flat), problem.mu[i], problem.rho[i])
        sizes.append(jnp.max(jnp.abs(natural)) / problem.rho[i])
    worst = jnp.max(jnp.stack(sizes)) / residual_size(flat)
    return jnp.where(jnp.isfinite(worst), worst, jnp.inf)


def _sweep(problem: Scaled, r: tuple) -> tuple:
    """Every contact solved in turn, with the newest reactions of the others."""
    for i, part in enumerate(r):
        free = problem.velocity(i, jnp.concatenate(r)) - problem.blocks_of_contacts[i] @ part
        r = (*r[:i], one_contact(problem.blocks_of_contacts[i], free, problem.mu[i]), *r[i + 1 :])
    return r


def _sweep_until(
    problem: Scaled, start: tuple, max_sweeps: Any, tolerance: Any, in_kernel: bool
) -> tuple[tuple, Array, Array]:
    """(reactions by contact, residual, sweeps)."""
    eliminates = not in_kernel or sum(map(len, start)) <= LARGEST_ELIMINATED

    def unfinished(carry):
        _, residual, _, _, sweeps = carry
        return (residual > tolerance) & (sweeps < max_sweeps)

    def swept(carry):
        r = _sweep(problem, carry[0])
        return r, _residual(problem, r)

    def improve(carry):
        r, residual, nearer, damping, sweeps = carry
        r, residual = apply_if(~nearer, swept, (r, residual))
        if eliminates:
            moved, left = _damped_newton_step(problem, r, residual, damping, in_kernel)
            nearer = left < residual
            worse = jnp.maximum(STEP_OF_DAMPING * damping, residual)
            damping = jnp.clip(jnp.where(nearer, damping / STEP_OF_DAMPING, worse), REGULAR, 1.0)
            r = tuple(jnp.where(nearer, a, b) for a, b in zip(moved, r, strict=True))
            residual = jnp.where(nearer, left, residual)
        return r, residual, nearer, damping, sweeps + 1

    none, first = jnp.zeros((), int), _residual(problem, start)
    if len(start) == 1:
        # A single contact is solved by one sweep.
        still = first <= tolerance
        swept_once = _sweep(problem, start)
        reactions = tuple(jnp.where(still, a, b) for a, b in zip(start, swept_once, strict=True))
        return reactions, _residual(problem, reactions), jnp.where(still, none, none + 1)
    carry = (start, first, jnp.asarray(False), jnp.asarray(REGULAR), none)
    reactions, residual, _, _, sweeps = jax.lax.while_loop(unfinished, improve, carry)
    return reactions, residual, sweeps


def _damped_newton_step(
    problem: Scaled, r: tuple, residual: Array, damping: Any, in_kernel: bool
) -> tuple[tuple, Array]:
    """(reactions, residual) behind a damped step of Newton's method for all contacts in the states
    they are in, brought back into their cones, and halved until it misses the laws by less or
    `HALVINGS` are used up.
    """
    value, lines = linearise_laws(problem, r, damping)
    if in_kernel:
        change = jnp.stack(eliminate(lines, value))
    else:
        change = jnp.linalg.solve(jnp.stack(lines), value)
    ends = np.cumsum([len(part) for part in r]).tolist()

    def shorter(carry):
        share, *_, halvings = carry
        moved = tuple(
            project_on_cone(part - share * change[e - len(part) : e], problem.mu[i])
            for i, (part, e) in enumerate(zip(r, ends, strict=True))
        )
        return 0.5 * share, moved, _residual(problem, moved), halvings + 1

    def unfinished(carry):
        return (carry[2] >= residual) & (carry[3] <= HALVINGS)

    first = (jnp.ones(()), r, residual, jnp.zeros((), int))
    _, moved, left, _ = jax.lax.while_loop(unfinished, shorter, first)
    return moved, left
