r"""Newton's method on the loops of a mechanism, wherever its places are sought: of starts, of
positions without time, beside singular positions, where rows are redundant.

Who asks states equations as blocks (`start_equations`); a step is the least change, in radians and
longest arms, that meets them in their order (`nearer`), or, where some follow from others or
contradict them, Levenberg's (`damped_step`). Rotations never leave their group (`retract`), and no
step is longer than what keeps the search on its branch.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxclear.ground import factorisation
from jaxclear.ground import sparse as sp
from jaxclear.ground.factorisation import Change, least_change, reduce_to_rank
from jaxclear.multibody.start_equations import (
    JOURNAL,
    LOOP,
    START,
    Ask,
    Block,
    position_blocks,
    retract,
    scale,
    speed_scales,
    stacked,
)

# Largest change of a coordinate in one step [rad, longest arms]: keeps the search on the branch of
# the guess.
LONGEST_STEP = 0.3
# Of the square of what is left: little, so that steps lead to what is nearest.
DAMPING = 1e-2
# Beside the squares of rows that move a coordinate by as much as they count: far above rounding.
LEAST_DAMPING = 1e-12


class Near(NamedTuple):
    """Equations that are met as nearly as others let them: least squares of all, each divided by
    its measure and counted by its `weight` [1]."""

    blocks: list[Block]
    weight: Any


def blocks_of(problem: Ask, q: Array, time: Any, kinds: tuple[str, ...] = (LOOP,)) -> list[Block]:
    """Equations in the coordinates of the given kinds, in order of priority.

    Args:
        problem: equations of the start (`ask`).
        q: coordinates of the tree, shape (coordinates,) [rad, m; 1 for quaternions].
        time: instant [s] at which drives are evaluated.
        kinds: kinds of equations, such as `LOOP` and `START`; default: loops only.
    """
    return [block for block in position_blocks(problem, q, time) if block.kind in kinds]


def closed(
    problem: Ask,
    q: Array,
    time: Any,
    count: int,
    kinds: tuple[str, ...] = (LOOP,),
    damped: bool = False,
) -> Array:
    """Coordinates after a fixed number of Newton steps towards the equations of these kinds.

    Args:
        problem: equations of the start (`ask`).
        q: coordinates at which the steps begin, shape (coordinates,).
        time: instant [s] at which drives are evaluated.
        count: number of steps.
        kinds: kinds of equations that are met; default: loops only.
        damped: whether steps are Levenberg's, which least violate what cannot be met.
    """
    if not blocks_of(problem, q, time, kinds):
        return q
    step = damped_step if damped else nearer
    again = lambda q, _: (step(problem, q, blocks_of(problem, q, time, kinds)), None)
    return jax.lax.scan(again, q, length=count)[0]


def shorten_step(step: Array, scales: Array, longest: float = LONGEST_STEP) -> Array:
    """A step scaled down to a largest length.

    The scaling is not differentiated: steps that decide are short, and the derivative of a largest
    entry
    is 0 / 0 where XLA computes entries twice with different rounding.

    Args:
        step: of the free speeds, shape (speeds,).
        scales: what counts as much as a radian, for each speed [1, m].
        longest: largest entry of the scaled step [rad, longest arms].
    """
    size = jnp.max(jnp.abs(step / scales), initial=longest)
    return step * jax.lax.stop_gradient(longest / size)


def nearer(problem: Ask, q: Array, blocks: list[Block], near: Near | None = None) -> Array:
    """Coordinates after one Gauss-Newton step, at most `LONGEST_STEP` long.

    Args:
        problem: equations of the start (`ask`).
        q: coordinates of the tree, shape (coordinates,) [rad, m; 1 for quaternions].
        blocks: equations whose linearisation is solved exactly, by the least step.
        near: equations that the step reduces as far as the blocks leave freedom; None: none.
    """
    step = -least_step(problem, blocks, near).change
    return retract(problem.system, q, shorten_step(step, speed_scales(problem)))


def damped_step(problem: Ask, q: Array, blocks: list[Block]) -> Array:
    """Coordinates after one damped step; equations may follow from or contradict each other.

    Args:
        problem: equations of the start (`ask`).
        q: coordinates of the tree, shape (coordinates,) [rad, m; 1 for quaternions].
        blocks: equations whose residual is reduced.
    """
    scales = speed_scales(problem)
    step = scales * levenberg(*scale(problem, blocks))
    return retract(problem.system, q, shorten_step(step, scales))


def levenberg(rows: Array, rest: Array, least_damping: float = LEAST_DAMPING) -> Array:
    """The step that reduces a residual, damped by its square.

    It converges quadratically also where the rank of the rows falls.

    Args:
        rows: Jacobian, shape (equations, unknowns), scaled.
        rest: residual, shape (equations,).
        least_damping: added to the damping, in units of the squared residual.

    Source: Yamashita & Fukushima 2001, Computing Suppl. 15, 239, doi:10.1007/978-3-7091-6217-0_18.
    """
    damping = DAMPING * jnp.sum(rest * rest) + least_damping
    damped = rows @ rows.T + damping * jnp.eye(len(rest))
    factors = factorisation.factor([list(row) for row in damped])
    return -(rows.T @ sp.stack(factorisation.solve(factors, tuple(rest))))


def least_step(problem: Ask, blocks: list[Block], near: Near | None = None) -> Change:
    """The least change of the free speeds that meets the blocks, and nearly `near`.

    Args:
        problem: with the scales of the speeds and the rank of redundant loops.
        blocks: equations to be met exactly.
        near: equations to be met in the sense of weighted least squares; None: none.
    """
    scales, redundancy = speed_scales(problem), problem.system.topology.redundancy
    loops = [block for block in blocks if block.kind == LOOP]
    rest = [block for block in blocks if block.kind != LOOP]
    first = stacked(problem, loops)
    if redundancy is not None and len(first[0]) > redundancy.rank:
        first = reduce_to_rank(*first, scales, redundancy.rank)
    rows, rhs = (
        jnp.concatenate(parts) for parts in zip(first, stacked(problem, rest), strict=True)
    )
    if near is None:
        return least_change(rows, rhs, scales)
    # Each has an unknown of its own, by which it is missed: with the damping of Levenberg, the
    # least of all together is the least square of what is missed.
    close, missed = (near.weight * part for part in scale(problem, near.blocks))
    damping = jnp.sqrt(DAMPING * jnp.sum(missed * missed) + LEAST_DAMPING)
    count, free = len(missed), len(scales)
    entry = jnp.concatenate([jnp.zeros((len(rhs), count)), damping * jnp.eye(count)])
    rows = jnp.concatenate([jnp.concatenate([rows, close / scales]), entry], axis=1)
    sizes = jnp.concatenate([scales, jnp.ones(count)])
    result = least_change(rows, jnp.concatenate([rhs, missed]), sizes)
    return Change(result.change[:free], result.exact[: len(rhs)])


def which_independent(problem: Ask, q: Array) -> dict[str, Bool[Array, ""]]:
    """By name whether what `start` gives is left free by the loops, journals that are to be
    concentric, and what is given before."""
    blocks = position_blocks(problem, q, 0.0)
    start_last = [b for kinds in ((LOOP,), (JOURNAL,), (START,)) for b in blocks if b.kind in kinds]
    report = [block for block in blocks if block.kind == START]
    peaks = least_step(problem, start_last).exact
    ends = len(peaks) - sum(len(b.rest) for b in report) + np.cumsum([len(b.rest) for b in report])
    return {
        block.name: jnp.all(peaks[end - len(block.rest) : end])
        for block, end in zip(report, ends, strict=True)
    }
