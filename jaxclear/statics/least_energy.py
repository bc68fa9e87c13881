r"""Where a mechanism rests at one position of its drives that its loops do not determine: where its
potential energy is least, with loops closed and journals inside their bearings.

An interior point method leads the journals through their play: slacks :math:`s` of the gaps stay
above 0, :math:`s\,p = \mu` with :math:`\mu \to 0`. Each Newton step closes the loops by its part
across them, of least size, and lessens the energy along them, where directions in which the energy
bends down are taken as if it bent up (so it leaves saddles). Then Newton's method on the contacts
that carry brings what is left to rounding, and derivatives are those of the equations that it
solves (implicit function theorem). Loops may have more rows than are independent.

Source: Wächter & Biegler 2006, Math. Program. 106, 25, doi:10.1007/s10107-004-0559-y (steps to the
boundary, barrier, merit; equations by number below).
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.ground.numerics import safe_divide
from jaxclear.ground.quantity import is_traced, is_tracing, on_host
from jaxclear.multibody.assembly import nearest, ready
from jaxclear.multibody.closure_coordinates import angles_at_start
from jaxclear.multibody.start_equations import motions_at, retract, start_problem
from jaxclear.native.compiled import compiled_quickly
from jaxclear.statics import equilibrium
from jaxclear.statics.equilibrium import Carried, Case, Measures, Rounded, Terms
from jaxclear.statics.quasi_static import SEAT, Posed, Read

# Turns after which a position that is not found counts as none, and turns of the last search.
MOST_TURNS, LAST_TURNS = 300, 4
# Source, eqs. 7, 8, 15: by which the barrier falls, when it may, how much of a slack a step leaves.
# Where it begins and ends, beside the work of the largest force over the play.
BARRIER_FALLS, BARRIER_POWER, SETTLED_AT, LEAVES = 0.2, 1.5, 10.0, 0.005
FIRST_BARRIER, LAST_BARRIER = 0.1, 1e-10
# Of a step in radians or shares of the longest arm; how often it is halved until the merit falls by
# this share of what it promises (Armijo's rule).
LONGEST, HALVINGS, PROMISED = 0.3, 12, 1e-4
# Beside the largest singular value of loops, or of all equations: what counts as 0.
DEPENDENT, SINGULAR = 1e-9, 1e-11
# What is left where a position is found, without units; of gaps beside the longest arm.
TINY = 1e-9
# By how much a contact may pull beside the largest force: rounding where several share what one
# could carry.
PULLS = 1e-6
# Bending of the energy below which a direction is flat, and forces that are rounding, beside the
# work of weights and loads over a radian or the longest arm.
FLAT, ROUNDING = 1e-9, 1e-12
# Rounding of lengths and forces that follow from others, in units of the last place of the largest.
ROUNDED = 100
# Beside the play: how far from its start the search begins.
STEP = 1e-3
# How near a place from which the energy falls to both sides counts as at it, and how far it is
# left [rad, longest arms].
AT_A_SADDLE, PUSHED = 1e-6, 1e-3
# Points of Gauss and Legendre's rule along a step, for the work that is done on it.
POINTS = 3


class Rest(eqx.Module):
    """Where the mechanism rests at one position: coordinates, multipliers of the rows of loops
    [N, N m], normal forces of all contacts [N] and which of them carry, the angles near which
    coordinates outside the tree are read. `change` [1]: what is left of the equations, or nan;
    `loose`: how much each free speed takes part in motions that nothing resists [1]; `split`:
    whether the energy fell to both sides of where it was sought."""

    q: Array
    closing: Array
    pushes: Array
    carries: Array
    angles: dict[str, Array]
    change: Array
    branch: Array
    loose: Array
    split: Array


class ByEnergy(eqx.Module):
    """How positions are sought: by the least energy, with gaps rounded so; whether loads act as
    they are (1) or reversed (-1)."""

    rounded: Rounded
    side: Any

    @property
    def reversed(self) -> "ByEnergy":
        """The same under reversed loads."""
        return ByEnergy(self.rounded, -self.side)

    def alone(self, scene: Posed, start: Rest) -> Rest:
        """Where the mechanism rests at one position, sought from a start."""
        return _settled(scene, start, self)

    def each(self, scene: Posed, position: Array, starts: Rest) -> Rest:
        """Rest at several positions, each from its own start; pure.

        Args:
            scene: the mechanism.
            position: of the drives, shape (positions, drives).
            starts: with a first axis of positions.
        """
        if is_traced((scene, position, starts)) or is_tracing():
            one = lambda p, start: find_rest(scene.at(p), start, self, near=True)
            return _split_before(jax.vmap(one)(position, starts), starts)
        # One after the other, by the program that has led from one to the next.
        known = on_host(starts)
        rest = [
            self.alone(scene.at(now), jax.tree.map(lambda x, i=i: jnp.asarray(x[i]), known))
            for i, now in enumerate(np.asarray(position))
        ]
        return _split_before(stacked(rest), starts)

    def read(self, scene: Posed, position: Array, spots: Rest) -> Read:
        """Coordinates, seats and soundness of solutions at several positions.

        Args:
            scene: the mechanism.
            position: of the drives, shape (positions, drives).
            spots: solutions (`each`).
        """
        seats = _offsets(scene, jnp.asarray(position), spots, self)
        unknowns = (spots.closing, spots.pushes, spots.angles, spots.loose, spots.split)
        carried = Carried(*unknowns, self.rounded, self.side)
        moving = {name: tuple(range(SEAT)) for name in seats}
        is_solved = spots.change <= TINY
        return Read(spots.q, seats, is_solved, 1.0, moving, None, carried)

    def amiss(self, scene: Posed, spot: Rest) -> tuple[dict[str, Any], dict[str, Any]]:
        """By how much loops are open [m, 1] and journals deep in their bearings [m], by joint."""
        return equilibrium.list_residuals(_make_case(scene, spot, self), spot.q)


class Linear(NamedTuple):
    """The equations and their derivatives by the free speeds: `bends` is that of the balance with
    its sign changed, the energy's second derivative along the loops."""

    now: Terms
    bends: Float[Array, "v v"]
    rows: Float[Array, "rows v"]
    gaps: Float[Array, "contacts v"]


class Search(NamedTuple):
    """An interior point: coordinates, slacks and normal forces of the contacts, multipliers of
    loops, the barrier (all without units), slacks and barrier where it fell last, turns taken and
    whether it was pushed off a saddle. Once the barrier has ended, which contacts carry, and turns
    taken since. The equations where they were looked at last."""

    q: Array
    slacks: Array
    pushing: Array
    closing: Array
    barrier: Array
    before: Array
    higher: Array
    turns: Array
    split: Array
    carries: Array
    last: Array
    here: Linear


def find_rest(scene: Posed, start: Rest, method: ByEnergy, near: bool = False) -> Rest:
    """Where the mechanism rests; pure, with derivatives by the scene's numbers (implicit ones).

    Args:
        scene: mechanism at one position of its drives.
        start: at which the search begins.
        method: settings of the search.
        near: whether a mechanism of nearly the same numbers rests at the start, so that the same
            contacts may carry.
    """
    arrays, rest = eqx.partition(scene, eqx.is_inexact_array)

    @jax.custom_jvp
    def solution(arrays, start):
        case = _make_case(eqx.combine(arrays, rest), start, method)
        measures = equilibrium.measures_of(case, start.q)
        first = _first_search(case, measures, start.q)
        if near:
            first = _continue_search(case, measures, first, start)
        return _rest_of_search(case, measures, _complete_search(case, measures, first), start)

    @solution.defjvp
    def tangents(primals, moved):
        out = solution(*primals)
        return out, _implicit_tangent(primals[0], moved[0], rest, out, method)

    return solution(arrays, start)


def initial_rest(scene: Posed) -> tuple[Rest, ByEnergy]:
    """Where the search begins, with journals in the middle of their bearings where the loops let
    them, and how it goes on."""
    try:
        start = ready(scene.mechanism).start
    except ValueError:
        # Journals that share a load need not be concentric, all at once; what does not fit at all
        # is refused, by name, where nothing is found from there.
        start = nearest(scene.mechanism, False).start
    method = ByEnergy(equilibrium.rounded(scene.mechanism), jnp.ones(()))
    angles, loops, gaps = _at_start(scene, start.coordinates, method)
    nothing = jnp.zeros(())
    rest = Rest(
        start.coordinates,
        jnp.zeros(len(loops)),
        jnp.zeros(len(gaps)),
        jnp.zeros(len(gaps), bool),
        angles,
        nothing,
        nothing,
        jnp.zeros(scene.mechanism.topology.speed_count),
        jnp.zeros((), bool),
    )
    return rest, method


def stacked(trees: list) -> Any:
    """Trees of numbers as one, with a first axis of them."""
    return jax.tree.map(lambda *parts: jnp.asarray(np.stack(parts)), *trees)


def _split_before(rest: Rest, starts: Rest) -> Rest:
    """What was found, from where a side had been taken before."""
    return eqx.tree_at(lambda r: r.split, rest, rest.split | starts.split)


_settled = compiled_quickly(find_rest)


@compiled_quickly
def _at_start(scene: Posed, q: Array, method: ByEnergy) -> tuple[dict[str, Array], Array, Array]:
    """Angles near which coordinates outside the tree are read, and what `restraints` says."""
    problem = start_problem(scene.mechanism, False)
    system, still = problem.system, jnp.zeros(problem.system.topology.speed_count)
    motions = motions_at(problem, q, still, 0.0)[2]
    names = tuple(name for name, joint in system.measured.items() if joint.followed)
    angles = angles_at_start(scene.mechanism, system, names, motions)
    case = equilibrium.case_of(scene, method.side, angles, method.rounded)
    known = {name: jnp.asarray(x, float) for name, x in angles.items()}
    return known, *equilibrium.restraints(case, q)


@compiled_quickly
def _offsets(scene: Posed, position: Array, spots: Rest, method: ByEnergy) -> dict[str, Array]:
    one = lambda place, spot: equilibrium.journal_offsets(
        _make_case(scene.at(place), spot, method), spot.q
    )
    return jax.vmap(one)(position, spots)


def _make_case(scene: Posed, start: Rest, method: ByEnergy) -> Case:
    return equilibrium.case_of(scene, method.side, start.angles, method.rounded)


def linear(case: Case, measures: Measures, q: Array, closing: Array, pushing: Array) -> Linear:
    """Residuals of the equilibrium with their derivatives by the coordinates.

    Args:
        case: mechanism and side of its loads.
        measures: scales of speeds, loops, energy and lengths.
        q: coordinates of the tree, shape (coordinates,).
        closing: multipliers of the loops, dimensionless.
        pushing: normal forces at the gaps, dimensionless.
    """

    def at_step(step):
        there = retract(case.system, q, measures.speeds * step)
        now = equilibrium.terms(case, measures, there, closing, pushing)
        return now, now

    rows, now = jax.jacfwd(at_step, has_aux=True)(jnp.zeros(len(measures.speeds)))
    return Linear(now, -0.5 * (rows.balance + rows.balance.T), rows.loops, rows.gaps)


def _first_search(case: Case, measures: Measures, q: Array) -> Search:
    """The search at its beginning."""
    # Not by `jax.eval_shape`, which hides what is zero whatever moves.
    counts = equilibrium.restraints(case, q)
    rows, contacts, free = len(counts[0]), len(counts[1]), len(measures.speeds)
    play = equilibrium.play(case, measures)
    none = lambda *shape: jnp.zeros(shape)
    now = Terms(none(free), none(rows), none(contacts))
    # Without contacts there is no barrier that had to fall.
    barrier = (FIRST_BARRIER if contacts else _final_barrier(play)) * play
    slacks = jnp.full(contacts, play)
    # A journal in its very middle does not know a direction.
    aside = STEP * play * jnp.cos(1.0 + jnp.arange(free))
    return Search(
        retract(case.system, q, measures.speeds * aside) if contacts else q,
        slacks,
        barrier / slacks,
        none(rows),
        barrier,
        slacks,
        barrier,
        jnp.zeros((), int),
        jnp.zeros((), bool),
        jnp.zeros(contacts, bool),
        jnp.zeros((), int),
        Linear(now, none(free, free), none(rows, free), none(contacts, free)),
    )


def _continue_search(case: Case, measures: Measures, first: Search, start: Rest) -> Search:
    """The search at its end, where Newton's method on the contacts that carry at the start leads to
    a place of rest; else at its beginning."""

    def stepped(now):
        here = linear(case, measures, now.q, now.closing, now.pushing)
        return _step_on_contacts(case, measures, now._replace(here=here))

    closing = start.closing * measures.loops / measures.energy
    pushing = start.pushes * measures.arm / measures.energy
    now = first._replace(q=start.q, closing=closing, pushing=pushing, carries=start.carries)
    unfinished = lambda now: (now.last == 0) | ((_residual(now) > TINY) & (now.last <= LAST_TURNS))
    now = jax.lax.while_loop(unfinished, stepped, now)
    now = now._replace(last=jnp.full_like(now.last, LAST_TURNS + 1))
    loose, saddle = _freedom_of_speeds(now.here, now.carries)
    # Along what nothing resists the barrier says where a journal lies.
    rests = _is_sound(now) & (_residual(now) <= TINY) & ~saddle & ~jnp.any(loose > 0)
    return jax.tree.map(lambda a, b: jnp.where(rests, a, b), now, first)


def _complete_search(case: Case, measures: Measures, first: Search) -> Search:
    """Where contacts that carry are closed and the others carry nothing, to rounding; or what is
    reached in `MOST_TURNS`."""
    play = equilibrium.play(case, measures)

    def advance(now):
        then = _advance(case, measures, now, play)
        numbers = jax.tree.leaves((then.q, then.slacks, then.pushing, then.closing))
        fine = jnp.all(jnp.isfinite(jnp.concatenate(numbers)))
        stopped = now._replace(turns=jnp.full_like(now.turns, MOST_TURNS))
        return jax.tree.map(lambda a, b: jnp.where(fine, a, b), then, stopped)

    unfinished = lambda now: (now.last <= LAST_TURNS) & (now.turns < MOST_TURNS)
    return jax.lax.while_loop(unfinished, advance, first)


def _advance(case: Case, measures: Measures, now: Search, play: Array) -> Search:
    """The search after a turn: towards the least energy within the barrier, or, once this has
    ended, Newton's step on the contacts that carry."""
    here = linear(case, measures, now.q, now.closing, now.pushing)
    first = now.turns == 0
    # Slacks begin as wide as the gaps, as far as these are open.
    gaps = jnp.maximum(here.now.gaps, FIRST_BARRIER * play)
    slacks = jnp.where(first, gaps, now.slacks)
    now = now._replace(slacks=slacks, here=here, turns=now.turns + 1)
    now = _lower_barrier(now, play, first)
    inside, last = _step_within_barrier(case, measures, now), _step_on_contacts(case, measures, now)
    ended = now.last > 0
    return jax.tree.map(lambda a, b: jnp.where(ended, b, a), inside, last)


def _lower_barrier(now: Search, play: Array, first: Array) -> Search:
    """The search with a lower barrier where it has settled within this one (source, eqs. 5, 7), and
    without one where that was the last."""
    terms_now = now.here.now
    parts = (
        terms_now.balance,
        terms_now.loops / play,
        (terms_now.gaps - now.slacks) / play,
        (now.slacks * now.pushing - now.barrier) / play,
    )
    residual = jnp.max(jnp.abs(jnp.concatenate(parts)), initial=0.0)
    relative, least = now.barrier / play, _final_barrier(play)
    settled = ~first & (residual <= SETTLED_AT * jnp.maximum(relative, least))
    ends = settled & (relative <= least) & (now.last == 0)
    falls = settled & ~ends & (now.last == 0)
    lower = jnp.minimum(BARRIER_FALLS * relative, relative**BARRIER_POWER)
    lower = play * jnp.maximum(lower, BARRIER_FALLS * least)
    # Slacks of contacts that carry fall as the barrier does, others stay (El-Bakry, Tapia & Zhang
    # 1994, SIAM Rev. 36, 45, doi:10.1137/1036002).
    carries = now.slacks < jnp.sqrt(now.barrier / now.higher) * now.before
    carries = jnp.where(ends, carries, now.carries)
    return now._replace(
        barrier=jnp.where(falls, lower, now.barrier),
        before=jnp.where(falls, now.slacks, now.before),
        higher=jnp.where(falls, now.barrier, now.higher),
        carries=carries,
        pushing=jnp.where(ends & ~carries, 0.0, now.pushing),
        last=jnp.where(ends, 1, now.last),
    )


def _final_barrier(play: Array) -> Array:
    """The last barrier, beside the play; not below what rounding of lengths is beside that."""
    return jnp.maximum(LAST_BARRIER, ROUNDED * jnp.finfo(float).eps / play)


def _step_within_barrier(case: Case, measures: Measures, now: Search) -> Search:
    """The search after a step within the barrier."""
    here, terms_now = now.here, now.here.now
    free, across = _loop_projections(here.rows)
    inside, stiff = terms_now.gaps - now.slacks, now.pushing / now.slacks
    # Contacts count with the stiffness that the barrier gives them (source, eq. 11).
    bends = here.bends + (here.gaps.T * stiff) @ here.gaps
    forces = terms_now.balance - here.rows.T @ now.closing - here.gaps.T @ now.pushing
    pull = forces + here.gaps.T @ (now.barrier / now.slacks - stiff * inside)
    closed = -across.T @ terms_now.loops
    along, split = _descent_step(free, bends, pull - bends @ closed)
    step = closed + along
    closing = across @ (bends @ step - pull)
    slack = here.gaps @ step + inside
    pushing = now.barrier / now.slacks - stiff * slack - now.pushing
    size = jnp.max(jnp.abs(step), initial=0.0)
    most = jnp.minimum(LONGEST / jnp.maximum(size, LONGEST), _longest_inside(now.slacks, slack))
    trial = _trial(case, measures, now, (forces, step, slack), (terms_now.loops, inside, closing))
    share = _halve_until(trial, most)
    return now._replace(
        q=retract(case.system, now.q, measures.speeds * share * step),
        slacks=now.slacks + share * slack,
        pushing=now.pushing + _longest_inside(now.pushing, pushing) * pushing,
        closing=closing,
        split=now.split | split,
    )


def _step_on_contacts(case: Case, measures: Measures, now: Search) -> Search:
    """The search after Newton's step on the contacts that carry."""
    missed = _residual_vector(now.here.now, now.pushing, now.carries)
    step = -_pseudo_inverse(_residual_jacobian(now.here, now.carries)) @ missed
    n, m = len(measures.speeds), len(now.closing)
    return now._replace(
        q=retract(case.system, now.q, measures.speeds * step[:n]),
        closing=now.closing + step[n : n + m],
        pushing=now.pushing + step[n + m :],
        last=now.last + 1,
    )


def _loop_projections(rows: Array) -> tuple[Array, Array]:
    """What projects steps to those that leave loops as they are (v, v), and multipliers from forces
    (rows, v): the pseudo-inverse of the rows, transposed."""
    count = rows.shape[1]
    if not len(rows):
        return jnp.eye(count), jnp.zeros((0, count))
    left_vectors, sizes, right = jnp.linalg.svd(rows, full_matrices=False)
    independent = sizes > DEPENDENT * jnp.max(sizes, initial=0.0)
    inverse = jnp.where(independent, 1 / jnp.where(independent, sizes, 1.0), 0.0)
    basis = right * independent[:, None]
    return jnp.eye(count) - basis.T @ basis, (left_vectors * inverse) @ right


def _descent_step(free: Array, bends: Array, pull: Array) -> tuple[Array, Array]:
    """The step along the loops on which the energy falls, and whether there is none although the
    energy falls to both sides."""
    along, largest = free @ bends @ free, jnp.max(jnp.abs(bends), initial=0.0)
    sizes, vectors = jnp.linalg.eigh(0.5 * (along + along.T))
    slopes = vectors.T @ (free @ pull)
    floor = jnp.maximum(jnp.finfo(float).eps * largest, jnp.abs(slopes) / LONGEST)
    step = safe_divide(slopes, jnp.maximum(jnp.abs(sizes), floor))
    least = FLAT + ROUNDED * jnp.finfo(float).eps * largest
    flat = (jnp.abs(sizes) <= least) & (jnp.abs(slopes) <= ROUNDING)
    step = jnp.where(flat, 0.0, step)
    saddle = (sizes < -least) & (jnp.abs(step) < AT_A_SADDLE)
    step = jnp.where(saddle, PUSHED, step)
    return free @ (vectors @ step), jnp.any(saddle)


def _longest_inside(values: Array, step: Array) -> Array:
    """The longest share of a step after which values are above 0 (source, eq. 15)."""
    shrinks = step < 0
    limit = (1 - LEAVES) * values / jnp.where(shrinks, -step, 1.0)
    return jnp.min(jnp.where(shrinks, limit, 1.0), initial=1.0)


def _trial(case: Case, measures: Measures, now: Search, moves: tuple, missed: tuple) -> Any:
    """Whether a share of a step lessens energy, barrier and what is missed together."""
    (forces, step, slack), (loops, inside, closing) = moves, missed
    dear = 2.0 * jnp.max(jnp.abs(jnp.concatenate([closing, now.pushing])), initial=0.0)
    amiss = dear * (jnp.sum(jnp.abs(loops)) + jnp.sum(jnp.abs(inside)))
    slope = -forces @ step - now.barrier * jnp.sum(slack / now.slacks) - amiss
    points, weights = np.polynomial.legendre.leggauss(POINTS)

    def is_less(share):
        moved = lambda part: retract(case.system, now.q, measures.speeds * part * step)
        at = jax.vmap(moved)(share * jnp.asarray(0.5 * (points + 1)))
        push = jax.vmap(lambda q: equilibrium.work(case, q))(at) * measures.speeds / measures.energy
        done = share * (0.5 * jnp.asarray(weights)) @ (push @ step)
        slacks = now.slacks + share * slack
        loops, gaps = equilibrium.restraints(case, moved(share))
        missed = jnp.abs(loops / measures.loops).sum() + jnp.abs(gaps / measures.arm - slacks).sum()
        change = -done - now.barrier * jnp.log(slacks / now.slacks).sum() + dear * missed - amiss
        # Below rounding of what is compared every step will do.
        rounding = 10 * jnp.finfo(float).eps * (1 + jnp.abs(amiss))
        return change <= PROMISED * share * jnp.minimum(slope, 0.0) + rounding

    return is_less


def _halve_until(is_less: Any, most: Array) -> Array:
    """The share of a step, halved until it is one that serves."""
    more = lambda now: ~now[2] & (now[1] < HALVINGS)

    def half(now):
        share = 0.5 * now[0]
        return share, now[1] + 1, is_less(share)

    first = 2.0 * most, jnp.zeros((), int), jnp.zeros((), bool)
    return jax.lax.while_loop(more, half, first)[0]


def _rest_of_search(case: Case, measures: Measures, end: Search, start: Rest) -> Rest:
    """What was found; its equations are those of the last turn but one."""
    carries = end.carries
    loose, saddle = _freedom_of_speeds(end.here, carries)
    angles = equilibrium.angles_near(case, end.q) if case.angles else start.angles
    return Rest(
        end.q,
        measures.multipliers(end.closing),
        measures.pushes(end.pushing),
        carries,
        angles,
        jnp.where(_is_sound(end), _residual(end), jnp.nan),
        jnp.zeros(()),
        loose,
        end.split | saddle,
    )


def _residual(end: Search) -> Array:
    """What is left of the equations, at the last turn but one."""
    missed = _residual_vector(end.here.now, end.pushing, end.carries)
    return jnp.max(jnp.abs(missed), initial=0.0)


def _is_sound(end: Search) -> Array:
    """Whether the search has ended with gaps open and contacts that push."""
    deep = jnp.max(-end.here.now.gaps, initial=0.0)
    pulls = jnp.max(-end.pushing, initial=0.0)
    return (end.last > LAST_TURNS) & (deep <= TINY) & (pulls <= PULLS)


def _residual_vector(now: Terms, pushing: Array, carries: Array) -> Array:
    return jnp.concatenate([now.balance, now.loops, jnp.where(carries, now.gaps, pushing)])


def _residual_jacobian(here: Linear, carries: Array) -> Array:
    """Derivatives of these equations by speeds, multipliers and normal forces."""
    n, m, k = here.bends.shape[0], len(here.rows), len(here.gaps)
    mask = jnp.where(carries, 1.0, 0.0)
    first = jnp.concatenate([-here.bends, here.rows.T, here.gaps.T], axis=1)
    second = jnp.concatenate([here.rows, jnp.zeros((m, m + k))], axis=1)
    third = jnp.concatenate(
        [mask[:, None] * here.gaps, jnp.zeros((k, m)), jnp.diag(1.0 - mask)], axis=1
    )
    return jnp.concatenate([first, second, third]).reshape(n + m + k, n + m + k)


def _pseudo_inverse(matrix: Array) -> Array:
    """Pseudo-inverse: the least change where equations follow from others or leave freedoms."""
    size = jnp.maximum(jnp.linalg.norm(matrix), jnp.finfo(float).tiny)
    return jnp.linalg.pinv(matrix, rtol=jnp.maximum(SINGULAR, FLAT / size))


def _freedom_of_speeds(here: Linear, carries: Array) -> tuple[Array, Array]:
    """How much each free speed takes part in motions that nothing resists, and whether the energy
    falls along one that contacts and loops allow."""
    rows = jnp.concatenate([here.rows, jnp.where(carries[:, None], here.gaps, 0.0)])
    free = _loop_projections(rows)[0]
    sizes, vectors = jnp.linalg.eigh(free @ here.bends @ free)
    least = FLAT + ROUNDED * jnp.finfo(float).eps * jnp.max(jnp.abs(here.bends), initial=0.0)
    # What is held has no part in the projected directions.
    is_free = jnp.sum((free @ vectors) ** 2, axis=0) > 0.5
    flat = is_free & (jnp.abs(sizes) <= least)
    parts = jnp.where(flat, (free @ vectors) ** 2, 0.0)
    return jnp.sqrt(jnp.sum(parts, axis=1)), jnp.any(is_free & (sizes < -least))


def _implicit_tangent(arrays: Any, moved: Any, rest: Any, out: Rest, method: ByEnergy) -> Rest:
    """How the place of rest moves with the numbers of the scene: implicit function theorem."""
    case = _make_case(eqx.combine(arrays, rest), out, method)
    measures = equilibrium.measures_of(case, out.q)
    closing = out.closing * measures.loops / measures.energy
    pushing = out.pushes * measures.arm / measures.energy

    def equations(arrays):
        case_of = _make_case(eqx.combine(arrays, rest), out, method)
        now = equilibrium.terms(case_of, measures, out.q, closing, pushing)
        return _residual_vector(now, pushing, out.carries)

    right = jax.jvp(equations, (arrays,), (moved,))[1]
    here = linear(case, measures, out.q, closing, pushing)
    inverse = _pseudo_inverse(_residual_jacobian(here, out.carries))
    change = -jnp.sum(inverse * right[None, :], axis=1)
    n, m = len(measures.speeds), len(closing)
    place = lambda step: retract(case.system, out.q, measures.speeds * step)
    q = jax.jvp(place, (jnp.zeros(n),), (change[:n],))[1]
    still = jax.tree.map(lambda x: _zero_tangent(x), out)
    return eqx.tree_at(
        lambda r: (r.q, r.closing, r.pushes),
        still,
        (q, measures.multipliers(change[n : n + m]), measures.pushes(change[n + m :])),
    )


def _zero_tangent(value: Array) -> Any:
    """The tangent of what does not move."""
    if jnp.issubdtype(value.dtype, jnp.inexact):
        return jnp.zeros_like(value)
    return np.zeros(value.shape, jax.dtypes.float0)
