r"""Coulomb friction in joints that always touch, as a problem: bounds that follow the reactions.

The sliding speeds s [m/s] at the end of a step are linear in the friction T [N] of the joints, s =
W T + s_0. Joint k rubs with T_k in [-a_k N_k, b_k N_k] and holds there: s_k > 0 needs T_k at the
lower end, s_k < 0 at the upper one, between them s_k = 0. N_k, the sum of the sizes of the forces
that the joint carries, moves with T. A ball's T_k has three components, across the force that it
carries, within a disc of that radius. Where these forces have known directions (a guide) this is a
horizontal LCP; a journal's turn with T, and the problem is a quasi-variational inequality. Source:
Pfeiffer & Glocker 1996, doi:10.1002/9783527618385, chapter 5 (bounds that reactions move); sweeps
with the bounds of the last ones: Jourdan, Alart & Jean 1998, doi:10.1016/S0045-7825(97)00137-0.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.complementarity.problem import AbstractProblem, AbstractSolver, Outcome, Solution
from jaxclear.complementarity.projected_gauss_seidel import Iterate
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import safe_divide, safe_sqrt
from jaxclear.ground.precision import check_double_precision
from jaxclear.ground.quantity import Scalar, quantity

# Newton steps for one joint: its start is off by less than half of the nearer slack.
RELAXED_STEPS = 6
# A change of friction that is larger than this share of the one before does not die away.
DRIFTS = 0.9


class Interval(NamedTuple):
    """A force between two bounds [N], of which one or both may be infinite."""

    low: Any
    high: Any

    def bounds(self, friction: Array) -> "Interval":
        """The same at any friction."""
        return self


class OfReaction(NamedTuple):
    """Friction between shares -low and high [1] of what a joint carries; `carried(T, ratio)`: the
    forces [N] that it does at friction T of all, a sequence of vectors, where its own is `ratio`
    [1] times the sum of their sizes."""

    low: Any
    high: Any
    carried: Callable[[Array, Any], Sequence[sp.Vec]]

    def bounds(self, friction: Array) -> Interval:
        """The bounds at this friction of all, each with the load that friction there leaves."""
        low, high = (
            ratio * sp.total(sp.norm(force) for force in self.carried(friction, ratio))
            for ratio in (-self.low, self.high)
        )
        return Interval(low, high)


class Caught(NamedTuple):
    """A ball whose friction holds it up to this `share` [1] of the force that it carries."""

    share: Any
    carried: Callable[[Array, Any], Sequence[sp.Vec]]


class Opposed(NamedTuple):
    """A ball whose friction opposes the sliding velocity `slip` [m/s]: its `share` [1] of the force
    that it carries, by the size of the slip across that."""

    slip: tuple
    share: Callable
    carried: Callable[[Array, Any], Sequence[sp.Vec]]


class JointFriction(AbstractProblem):
    """Coulomb friction in joints that always touch: z = T, w = s = W T + s_0.

    Args:
        delassus: rows of W [m/s per N], a sequence.
        free_velocity: sliding speeds s_0 without friction [m/s], a sequence.
        blocks: the law of each joint: `OfReaction`, None without friction, `Caught` or `Opposed`
            for a ball, or `Interval` for a force whose bounds follow no reaction; a tuple.
        softest: least diagonal entries of W [m/s per N], a sequence: below them an entry is
            rounding, as where a drive moves the joint whatever friction does.
        places: place of each joint's components in z, a tuple of slices; None: one component each.
    """

    delassus: Sequence[Any]
    free_velocity: Any
    blocks: tuple[Any, ...]
    softest: Any
    places: tuple[slice, ...] | None = None

    def place(self, k: int) -> slice:
        """Where a joint's friction lies in z: one component, of a ball three.

        Args:
            k: index of the joint.

        Returns:
            a slice.
        """
        return slice(k, k + 1) if self.places is None else self.places[k]

    def components(self) -> int:
        """Number of components of z."""
        return self.place(len(self.blocks) - 1).stop if self.blocks else 0

    def slip(self, i: int, friction: Float[Array, " k"]) -> Any:
        """One component of the sliding speeds.

        Args:
            i: index of the component.
            friction: friction of all joints [N], an array.

        Returns:
            the speed [m/s].
        """
        return self.free_velocity[i] + sp.dot(self.delassus[i], friction)

    def improved(
        self, k: int, friction: Float[Array, " k"], relaxation: Any = None
    ) -> tuple[list, Any, Any]:
        """Friction of one joint that satisfies its law while that of the others stays.

        Args:
            k: index of the joint.
            friction: friction of all joints [N], an array.
            relaxation: share of the bound over which friction is rounded [1]; None: exact.

        Returns:
            components of T_k [N], the bound of their size [N], and whether they are within it.
        """
        block, i = self.blocks[k], self.place(k).start
        if isinstance(block, (Caught, Opposed)):
            return self._solve_ball(k, friction, block)
        low, high = block.bounds(friction)
        stiff = jnp.maximum(self.delassus[i][i], self.softest[i])
        target = friction[i] - self.slip(i, friction) / stiff
        within = jnp.clip(target, low, high)
        if relaxation is not None and isinstance(block, OfReaction):
            within = _relaxed(target, low, high, relaxation)
        bound = jnp.maximum(jnp.abs(low), jnp.abs(high))
        return [within], jnp.where(jnp.isfinite(bound), bound, jnp.abs(within)), within == target

    def _solve_ball(self, k: int, friction: Float[Array, " k"], rule: Any) -> tuple[list, Any, Any]:
        """A ball that would stick with friction inside the disc sticks; one that would not is moved
        against its slip onto the disc's edge."""
        (force,) = rule.carried(friction, (0.0,) * 3)
        size = sp.norm(force)
        frame = across(tuple(safe_divide(x, size) for x in force))
        if isinstance(rule, Opposed):
            slip = [sp.dot(axis, rule.slip) for axis in frame]
            speed = sp.norm(slip)
            bound = rule.share(speed) * size
            friction_there = [-bound * safe_divide(x, speed) for x in slip]
        else:
            bound = rule.share * size
            friction_there = self._solve_caught(k, friction, frame, bound)
        within = sp.norm(friction_there) < bound
        return (
            [sp.dot(friction_there, column) for column in zip(*frame, strict=True)],
            bound,
            within,
        )

    def _solve_caught(self, k: int, friction: Float[Array, " k"], frame: tuple, bound: Any) -> list:
        components = range(self.place(k).start, self.place(k).stop)
        block = [[self.delassus[i][j] for j in components] for i in components]
        pulled = [[sp.dot(row, axis) for row in block] for axis in frame]
        (a, b), (c, d) = ([sp.dot(axis, column) for column in pulled] for axis in frame)
        softest = self.softest[components[0]]
        a, d = jnp.maximum(a, softest), jnp.maximum(d, softest)
        slips = [self.slip(i, friction) for i in components]
        s = [sp.dot(axis, slips) for axis in frame]
        now = [sp.dot(axis, [friction[i] for i in components]) for axis in frame]
        det = a * d - b * c
        sticks = [now[0] - (d * s[0] - b * s[1]) / det, now[1] - (a * s[1] - c * s[0]) / det]
        slides = [x - y / (a + d) for x, y in zip(now, s, strict=True)]
        longest = sp.norm(slides)
        shrunk = jnp.where(longest > bound, safe_divide(bound, longest), 1.0)
        inside = sp.norm(sticks) <= bound
        return [jnp.where(inside, x, shrunk * y) for x, y in zip(sticks, slides, strict=True)]

    def residual(self, z, w):
        """Largest entry of the natural map of the boxes, T - proj(T - s / W_kk) [N]."""
        residuals = [jnp.zeros(())]
        for k, block in enumerate(self.blocks):
            if block is not None:
                improved, *_ = self.improved(k, z)
                residuals += [z[self.place(k).start + i] - x for i, x in enumerate(improved)]
        return jnp.max(jnp.abs(jnp.stack(residuals)))


class BoxedGaussSeidel(AbstractSolver):
    """Sweeps over the joints, each put into its bounds with the newest friction of the others.

    Joints of a loop that stick share what holds it, in no unique way. Their slips agree as well as
    the loop is closed, and sweeps pass that difference on from joint to joint without end: where
    friction within its bounds changes as much as in the sweep before, and moves nothing, they end.
    Plain operations only, so that a time loop with these sweeps stays one kernel; derivatives
    (forward; reverse only where that loop is one kernel) are those of the sweeps.

    Args:
        tolerance: change of friction relative to its bound at which to stop [1], > 0.
        max_sweeps: largest number of sweeps over the joints [1], > 0.
        relaxation: share of the bound B over which the corners of joints of one component are
            rounded [1], > 0: that of interior points, the products of slacks and slips are
            W (relaxation B / 2)^2 in the place of 0 (start: Chen & Harker 1993, SIAM J. Matrix
            Anal. Appl. 14, 1168, doi:10.1137/0614081); None: exact.
    """

    tolerance: Scalar = quantity(1e-13, "1", above=0)
    max_sweeps: Scalar = quantity(1000.0, "1", above=0)
    relaxation: Scalar | None = quantity(None, "1", above=0)

    def solve(self, problem: JointFriction) -> Solution:
        check_double_precision()
        last = self.iterate(problem)
        slips = sp.stack([problem.slip(i, last.z) for i in range(problem.components())])
        solved = jnp.where(last.residual <= self.tolerance, Outcome.SOLVED, Outcome.LIMIT)
        outcome = jnp.where(jnp.isfinite(last.residual), solved, Outcome.NOT_FINITE)
        return Solution(last.z, slips, problem.residual(last.z, slips), outcome, last.sweeps)

    def iterate(self, problem: JointFriction) -> Iterate:
        """The sweeps themselves, which a time step calls.

        Args:
            problem: a `JointFriction`.

        Returns:
            friction, its last change relative to the largest bound, and the number of sweeps, an
            `Iterate`.
        """
        start = jnp.zeros(problem.components())
        if all(block is None for block in problem.blocks):
            return Iterate(start, jnp.zeros(()), jnp.zeros((), int))

        def unfinished(carry):
            return (carry[1] > self.tolerance) & (carry[2] < self.max_sweeps)

        def improve(carry):
            before, last, sweeps = carry
            friction, largest, within = self._sweep(problem, before)
            largest = jnp.where(largest > 0, largest, 1.0)
            change = jnp.max(jnp.abs(friction - before)) / largest
            if problem.components() > 1:
                moved = _force_for_change(problem, friction - before) / largest
                idle = within & (change > DRIFTS * last) & (moved <= self.tolerance)
                change = jnp.where(idle, moved, change)
            return friction, change, sweeps + 1

        first = (start, jnp.asarray(jnp.inf), jnp.zeros((), int))
        friction, change, sweeps = jax.lax.while_loop(unfinished, improve, first)
        return Iterate(friction, change, sweeps)

    def _sweep(self, problem: JointFriction, friction: Array):
        """(friction, the largest bound, whether all that has changed is within its bounds) after a
        sweep."""
        largest, all_within = jnp.zeros(()), jnp.asarray(True)
        for k, block in enumerate(problem.blocks):
            if block is None:
                continue
            improved, bound, within = problem.improved(k, friction, self.relaxation)
            for i, x in enumerate(improved, problem.place(k).start):
                all_within &= within | (friction[i] == x)
                friction = friction.at[i].set(x)
            largest = jnp.maximum(largest, bound)
        return friction, largest, all_within


def _force_for_change(problem: JointFriction, change: Array) -> Any:
    """The largest friction [N] that would by itself move its joint as this change of all does."""
    stiff = [jnp.maximum(row[i], problem.softest[i]) for i, row in enumerate(problem.delassus)]
    moved = [sp.dot(row, change) / x for row, x in zip(problem.delassus, stiff, strict=True)]
    return jnp.max(jnp.abs(jnp.stack(moved)))


def _relaxed(target: Any, low: Any, high: Any, relaxation: Any) -> Any:
    """T with 1 / (T - low) - 1 / (high - T) in proportion to T - target: the complementarity of the
    slacks and slips relaxed to one product. From a hyperbola at each bound (Chen & Harker 1993) by
    Newton's method, which halves the way to a bound rather than to cross it.
    """
    width = relaxation * 0.5 * (high - low)
    root = lambda y: safe_sqrt(y * y + width * width)
    friction, product = 0.5 * (root(target - low) - root(target - high) + high + low), width**2 / 4
    for _ in range(RELAXED_STEPS):
        above, below = high - friction, friction - low
        left, right = safe_divide(1.0, below), safe_divide(1.0, above)
        missed = friction - target + product * (right - left)
        change = missed / (1 + product * (left * left + right * right))
        friction = friction - jnp.clip(change, -0.5 * above, 0.5 * below)
    return friction


def across(direction: tuple) -> tuple[tuple, tuple]:
    """Two axes across a unit vector, and at right angles to each other (Duff et al. 2017, J.
    Comput. Graph. Tech. 6, 1)."""
    x, y, z = direction
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (1.0 + sign * x * x * a, sign * b, -sign * x), (b, sign + y * y * a, -y)
