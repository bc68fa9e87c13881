r"""Unilateral contacts with Coulomb's friction as a problem: v = W r + b.

r are reactions [N] or, over a time step, percussions [N s]; v velocities [m/s]; W = J M^-1 J^T is
the Delassus matrix and b the velocities without contact. Unknowns are ordered contact by contact:
normal first (positive pushes apart; velocity positive opening), then its tangents. Newton's law of
impact, v_n + e v_n^- >= 0 ⟂ r_n >= 0, is the same problem with b_n + e v_n^- for b_n (Moreau 1988,
doi:10.1007/978-3-7091-2624-0_1). Source: Acary & Brogliato 2008, Numerical Methods for Nonsmooth
Dynamical Systems, doi:10.1007/978-3-540-75392-6, sections 3.9 and 13.
"""

from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxclear.complementarity.friction_cone import natural_map
from jaxclear.complementarity.problem import LCP, AbstractLinearProblem, as_floats, check_shapes


def _as_rows(matrix: Any) -> tuple[Array, ...]:
    """A matrix, or its rows, as rows: small arrays stay in the registers of a kernel."""
    return tuple(
        as_floats(row)
        for row in (matrix if isinstance(matrix, (tuple, list)) else as_floats(matrix))
    )


class FrictionContact(AbstractLinearProblem):
    """Contacts with Coulomb's law: z = r, w = v.

    Without spatial contacts the problem is an LCP.

    Args:
        delassus: matrix W [m/s per N s], an array (m, m) or its rows.
        free_velocity: velocities b without contact [m/s], an array (m,).
        mu: coefficient of friction of each contact [1], >= 0, an array (contacts,).
        directions: number of unknowns of each contact, a tuple: 1 (without friction), 2 (planar) or
            3 (spatial); left out where all have the same.
        active: array of flags (contacts,), which contacts may act at all; one that may not has r =
            0, whatever its v. By default all may.

    Raises:
        ValueError: if shapes do not fit, or a coefficient is negative.
    """

    delassus: Any = eqx.field(converter=_as_rows)
    free_velocity: Float[Array, " m"] = eqx.field(converter=as_floats)
    mu: Float[Array, " c"] = eqx.field(converter=as_floats)
    directions: tuple[int, ...] | None = eqx.field(static=True, default=None)
    active: Bool[Array, " c"] | None = None

    def __check_init__(self):
        owner, m, c = "a FrictionContact", jnp.size(self.free_velocity), jnp.size(self.mu)
        expected = {"free_velocity": (self.free_velocity, (m,)), "mu": (self.mu, (c,))}
        check_shapes(owner, expected)
        if len(self.delassus) != m:
            raise ValueError(
                f"delassus of {owner} has {len(self.delassus)} rows; it must have {m}."
            )
        check_shapes(
            owner, {f"row {i} of delassus": (r, (m,)) for i, r in enumerate(self.delassus)}
        )
        directions = self.directions
        if len(self.sizes) != c or sum(self.sizes) != m or not set(self.sizes) <= {1, 2, 3}:
            raise ValueError(
                f"{owner} with {c} coefficients mu has {c} (without friction), {2 * c} (planar) or "
                f"{3 * c} (spatial) rows, or as many as its directions {directions} say, not {m}."
            )
        if not isinstance(self.mu, jax.core.Tracer) and np.any(np.asarray(self.mu) < 0):
            raise ValueError(f"mu of {owner} is {self.mu}; no coefficient may be negative.")

    @property
    def sizes(self) -> tuple[int, ...]:
        """Unknowns of each contact."""
        if self.directions is not None:
            return self.directions
        c = self.mu.shape[0]
        return (self.free_velocity.shape[0] // c,) * c

    @property
    def starts(self) -> list[int]:
        """The first unknown of each contact, which is its normal, and after all how many there
        are."""
        return np.concatenate([[0], np.cumsum(self.sizes)]).tolist()

    def split(self, x: Float[Array, " m"]) -> list[Array]:
        """The parts of a vector that belong to each contact.

        Args:
            x: an array (m,) in the order of the unknowns.

        Returns:
            a list with one array a contact.
        """
        starts = self.starts
        return [x[a:b] for a, b in pairwise(starts)]

    @property
    def acts(self) -> Bool[Array, " m"]:
        """For each unknown whether its contact may act."""
        is_active = jnp.ones(len(self.sizes), bool) if self.active is None else self.active
        parts = [jnp.broadcast_to(is_active[i], (d,)) for i, d in enumerate(self.sizes)]
        return jnp.concatenate(parts)

    def acting(self) -> tuple[Float[Array, "m m"], Float[Array, " m"]]:
        """W and b in which contacts that may not act are open ones by themselves."""
        acts, m = self.acts, self.starts[-1]
        open_velocity = np.isin(np.arange(m), self.starts).astype(float)
        matrix = jnp.where(acts[:, None] & acts, jnp.stack(self.delassus), jnp.eye(m))
        return matrix, jnp.where(acts, self.free_velocity, open_velocity)

    def to_lcp(self):
        """Without tangents v_n = W r_n + b_n itself; with one, three rows a contact (Pfeiffer &
        Glocker 1996, doi:10.1002/9783527618385): r_n ⟂ v_n, mu r_n + r_t ⟂ v_right, v_left ⟂ mu r_n
        - r_t, v_t = v_right - v_left.
        """
        matrix, offset = self.acting()
        turn, mu = self._change_of_unknowns()
        order = np.array([*self._normals(), *self._tangents()])
        velocity, c, t = (matrix @ turn)[order], len(self.sizes), len(self._tangents())
        slack = jnp.concatenate([jnp.zeros((c, t)), jnp.eye(t)])
        return LCP(
            jnp.block([[velocity, slack], [2 * mu, -jnp.eye(t), jnp.zeros((t, t))]]),
            jnp.append(offset[order], jnp.zeros(t)),
        )

    def from_lcp(self, z):
        r = self._change_of_unknowns()[0] @ z[: len(self.free_velocity)]
        return r, jnp.stack(self.delassus) @ r + self.free_velocity

    def residual(self, z, w):
        matrix, offset = self.acting()
        natural = [
            natural_map(r, v, mu, 1.0)
            for r, v, mu in zip(
                self.split(z), self.split(matrix @ z + offset), self.mu, strict=True
            )
        ]
        mismatch = jnp.stack(self.delassus) @ z + self.free_velocity - w
        return jnp.max(jnp.abs(jnp.concatenate([*natural, mismatch])))

    def _normals(self) -> list[int]:
        return self.starts[:-1]

    def _tangents(self) -> list[int]:
        return [i for i in range(self.free_velocity.shape[0]) if i not in self._normals()]

    def _change_of_unknowns(self):
        """(turn, mu): r = turn (all r_n, then all mu r_n + r_t), and mu beside each tangent."""
        if max(self.sizes) > 2:
            raise ValueError(
                "spatial friction cones are not linear complementarity; solve them by "
                "ProjectedGaussSeidel."
            )
        c, normals, tangents = len(self.sizes), self._normals(), self._tangents()
        turn = np.zeros((self.free_velocity.shape[0],) * 2)
        turn[normals, range(c)] = 1.0
        turn[tangents, range(c, len(turn))] = 1.0
        owner = [normals.index(i - 1) for i in tangents]
        mu = (
            jnp.zeros((len(tangents), c))
            .at[np.arange(len(owner)), np.array(owner, int)]
            .set(self.mu[np.array(owner, int)])
        )
        return jnp.asarray(turn).at[np.array(tangents, int), :c].set(-mu), mu
