"""Runge-Kutta methods on groups, after Munthe-Kaas: rotations stay rotations to rounding, and screw
motions are exact.

A state y moves by increments u, the exponential map of its group: y = y0 exp(u); the state of a
mechanism is a product of its joints' groups and of numbers that add up. With speeds k in body axes
the increment obeys du/dt = k + [u, k]/2 + [u, [u, k]]/12 - ..., an equation in a vector space to
which an ordinary Runge-Kutta method is applied; order p needs brackets nested p - 2 times. What is
no group (angles, speeds, memories, volumes) adds up, and the whole is then the ordinary method with
the same coefficients.

Source: Munthe-Kaas 1999, Applied Numerical Mathematics 29, 115; Iserles, Munthe-Kaas, Norsett &
Zanna 2000, Acta Numerica 9, 215, section 3 (there with increments in space axes: the signs of the
odd brackets are the opposite).
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxclear.components.joint import AbstractGroupJoint
from jaxclear.formulations.model import Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.argument_errors import refuse_misfit
from jaxclear.ground.quantity import AbstractQuantified, concrete


class AbstractGroup(AbstractQuantified):
    """How a state moves by increments; their number may differ from that of the state's entries."""

    @abstractmethod
    def moved(self, y: Float[Array, " n"], increment: Float[Array, " m"]) -> Float[Array, " n"]:
        """The state after an increment, y exp(increment).

        Args:
            y: a state, an array (n,).
            increment: increment in body axes, an array (m,).

        Returns:
            a state, an array (n,).
        """

    @abstractmethod
    def bracket(self, a: Float[Array, " m"], b: Float[Array, " m"]) -> Float[Array, " m"] | None:
        """Lie bracket of two increments.

        Args:
            a, b: increments, arrays (m,).

        Returns:
            an increment, an array (m,); None for a group that commutes.
        """

    @abstractmethod
    def tangent(self, y: Float[Array, " n"], increment: Float[Array, " m"]) -> Float[Array, " n"]:
        """Change of a state to first order in an increment, in which errors are measured.

        Args:
            y: a state, an array (n,).
            increment: increment in body axes, an array (m,).

        Returns:
            the change, an array (n,).
        """


class Part(NamedTuple):
    """A part of the state: where its coordinates, its increments and (of a group) its speeds are;
    of a group the number of its joint."""

    joint: int | None
    coordinates: range
    increments: range
    speeds: range


class StateGroup(AbstractGroup):
    """The group of a mechanism's state: that of each joint whose coordinates are a group, addition
    for all else.
    """

    joints: tuple[AbstractGroupJoint, ...]
    parts: tuple[Part, ...] = eqx.field(static=True)

    def moved(self, y, increment):
        return self._each(
            lambda part: _cut(y, part.coordinates) + _cut(increment, part.increments),
            lambda joint, part: joint.moved(
                _entries(y, part.coordinates), _entries(increment, part.increments)
            ),
        )

    def bracket(self, a, b):
        if not self.joints:
            return None
        return self._each(
            lambda part: jnp.zeros(len(part.increments)),
            lambda joint, part: joint.bracket(
                _entries(a, part.increments), _entries(b, part.increments)
            ),
        )

    def tangent(self, y, increment):
        return self._each(
            lambda part: _cut(increment, part.increments),
            lambda joint, part: joint.rate(
                _entries(y, part.coordinates), _entries(increment, part.increments)
            ),
        )

    def rates(self, y: Float[Array, " n"], rates: Float[Array, " n"]) -> Float[Array, " m"]:
        """Rates of the increments from the state and its own rates: a group's are its speeds."""
        return self._each(
            lambda part: _cut(rates, part.coordinates), lambda _, part: _entries(y, part.speeds)
        )

    def _each(self, plain: Callable, grouped: Callable) -> Array:
        """The parts in their order: arrays of the plain ones, scalars of the joints."""
        return jnp.concatenate(
            [
                plain(p) if p.joint is None else sp.stack(grouped(self.joints[p.joint], p))
                for p in self.parts
            ]
        )


def _cut(values, places):
    return values[places.start : places.stop]


def _entries(values, places):
    return tuple(values[i] for i in places)


def state_group(model: Model) -> StateGroup:
    """The group of a model's states."""
    topology, parts, joints = model.system.topology, list[Part](), list[AbstractGroupJoint]()
    done = used = 0

    def add(joint, size, width, speeds=range(0)):
        nonlocal done, used
        places = range(done, done + size), range(used, used + width)
        parts.append(Part(joint, *places, speeds))
        done, used = done + size, used + width

    def add_plain_until(end):
        if end > done:
            add(None, end - done, end - done)

    for branch, link in zip(topology.branches, model.system.links, strict=True):
        places, speeds = branch.coordinates, branch.speeds
        if isinstance(link.joint, AbstractGroupJoint) and places.stop > places.start:
            add_plain_until(places.start)
            first, count = topology.coordinate_count + speeds.start, speeds.stop - speeds.start
            size = places.stop - places.start
            add(len(joints), size, count, range(first, first + count))
            joints.append(link.joint)
    add_plain_until(model.layout.size)
    return StateGroup(tuple(joints), tuple(parts))


class Tableau(NamedTuple):
    """An explicit Runge-Kutta method with an estimate of its error. The last row is the step's end,
    at which the next step begins: its slope enters the estimate alone. `error_order`: power of the
    step with which the estimate falls."""

    nodes: np.ndarray
    matrix: np.ndarray
    error: np.ndarray
    error_order: int


def _tableau(rows: tuple, compared: tuple, error_order: int) -> Tableau:
    """From the rows below the diagonal and the weights of the solution that the result is compared
    with.
    """
    matrix = np.zeros((len(rows) + 1,) * 2)
    for i, row in enumerate(rows, 1):
        matrix[i, : len(row)] = row
    return Tableau(matrix.sum(1), matrix, matrix[-1] - np.array(compared), error_order)


# Euler with the trapezoidal rule; midpoint with Simpson's rule; Bogacki & Shampine 1989, Appl.
# Math. Lett. 2, 321; Kutta's 3/8 rule with an embedded solution of order 3. Classical rk4 would
# leave its estimate blind to forces that depend on time alone: on its nodes the quadrature of order
# 3 is unique. The weights embedded in the 3/8 rule are positive ones of the one-parameter family
# that satisfies the four conditions of order 3 (tests/time/test_munthe_kaas.py).
TABLEAUS = {
    1: _tableau(((1,),), (1 / 2, 1 / 2), 2),
    2: _tableau(((1 / 2,), (0, 1)), (1 / 6, 4 / 6, 1 / 6), 3),
    3: _tableau(((1 / 2,), (0, 3 / 4), (2 / 9, 1 / 3, 4 / 9)), (7 / 24, 1 / 4, 1 / 3, 1 / 8), 3),
    4: _tableau(
        ((1 / 3,), (-1 / 3, 1), (1, -1, 1), (1 / 8, 3 / 8, 3 / 8, 1 / 8)),
        (3 / 32, 15 / 32, 9 / 32, 1 / 32, 4 / 32),
        4,
    ),
}


def stages(order: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Nodes and weights of the stages of a method of this order."""
    table = TABLEAUS[order]
    return tuple(table.nodes[:-1]), tuple(table.matrix[-1][:-1])


class GroupTerm(diffrax.AbstractTerm):
    """The equation dy/dt = y k(t, y) on a group, for diffrax.

    Args:
        vector_field: function (t, y, args) that returns k, the rates of the increments in body
            axes.
        group: the group, an `AbstractGroup`.
    """

    vector_field: Callable[[Any, Any, Any], Array]
    group: AbstractGroup

    def vf(self, t, y, args):
        return self.vector_field(t, y, args)

    def contr(self, t0, t1, **kwargs):
        return t1 - t0

    def prod(self, vf, control):
        return control * vf


class GroupHermite(diffrax.AbstractLocalInterpolation):
    """Within a step: the increment is the cubic with the right ends and end slopes, so the state is
    on the group throughout.
    """

    t0: Any  # type: ignore[misc]
    t1: Any  # type: ignore[misc]
    group: AbstractGroup
    y0: Any
    increment: Any
    start: Any
    end: Any

    def evaluate(self, t0, t1=None, left=True):
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        s = (t0 - self.t0) / jnp.where(self.t1 != self.t0, self.t1 - self.t0, 1.0)
        bend = s * (1 - s) * ((1 - s) * self.start - s * self.end)
        return self.group.moved(self.y0, s * s * (3 - 2 * s) * self.increment + bend)


class MuntheKaas(diffrax.AbstractAdaptiveSolver):
    """Runge-Kutta-Munthe-Kaas method of order 1 (Lie-Euler), 2 (midpoint), 3 (Bogacki-Shampine) or
    4 (3/8 rule).

    Use as `integrator.Adaptive(integrator.MuntheKaas(4))` where bodies turn freely (joints
    Spherical, Free, Planar): quaternions stay unit to rounding, and a constant twist is followed
    exactly at any step. A scene without such joints gets the ordinary Runge-Kutta method;
    `diffrax.Tsit5` then needs fewer evaluations for the same accuracy. Each order estimates its
    error; the step ends with an evaluation at which the next begins. For steps of a fixed length
    see `FixedStep` ("munthe_kaas4"). For a group of your own:
    `diffrax.diffeqsolve(GroupTerm(vector_field, group), MuntheKaas(4), ...)`.

    Args:
        of_order: order of the method, an integer 1 to 4.

    Raises:
        ValueError: for another order.

    Source: Munthe-Kaas 1999, Applied Numerical Mathematics 29, 115.
    """

    term_structure: ClassVar = GroupTerm
    interpolation_cls: ClassVar = GroupHermite
    of_order: int = eqx.field(static=True, default=4)

    def __new__(cls, *args: Any, **named: Any):
        if args or named:
            refuse_misfit(cls, args, named)
        return diffrax.AbstractAdaptiveSolver.__new__(cls)

    def __check_init__(self):
        is_count = isinstance(self.of_order, int) and not isinstance(self.of_order, bool)
        if not is_count or self.of_order not in TABLEAUS:
            raise ValueError(
                f"the order of integrator.MuntheKaas is {self.of_order!r}; it must be 1, 2, 3 or 4."
            )

    def order(self, terms):
        return self.of_order

    def error_order(self, terms):
        return TABLEAUS[self.of_order].error_order

    def init(self, terms, t0, t1, y0, args):
        return terms.vf(t0, y0, args)

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        group, table, h = group_of(terms), TABLEAUS[self.of_order], terms.contr(t0, t1)

        def rate(share, y):
            return terms.vf(t0 + share * (t1 - t0), y, args)

        first = solver_state
        if concrete(made_jump) != 0:
            first = jax.lax.cond(made_jump, lambda: rate(0.0, y0), lambda: solver_state)
        slopes, y1, last = _stages(group, rate, table, range(1, len(table.nodes)), h, y0, first)
        error = group.tangent(y1, h * _combined(table.error, slopes))
        ends = {
            "increment": h * _combined(table.matrix[-1], slopes),
            "start": h * slopes[0],
            "end": h * slopes[-1],
        }
        return y1, error, dict(group=group, y0=y0, **ends), last, diffrax.RESULTS.successful


def group_of(term: Any) -> AbstractGroup:
    """The group of a term, which diffrax has wrapped to let time run backwards."""
    while not isinstance(term, GroupTerm):
        term = term.term
    return term.group


def fixed_step(
    group: StateGroup, rate_of: Callable, time: Any, h: Any, y: Float[Array, " n"]
) -> Float[Array, " n"]:
    """The state after one step of order 4, without an estimate of its error.

    Args:
        group: which parts of the state are rotations and poses.
        rate_of: function of time and state: the state's rate.
        time, h: start and length of the step [s].
        y: state at its start.
    """
    table = TABLEAUS[4]
    unknown = jnp.zeros(group.parts[-1].increments.stop)

    def rate(share, y):
        return group.rates(y, rate_of(time + share * h, y))

    slopes, _, _ = _stages(group, rate, table, range(len(table.nodes) - 1), h, y, unknown)
    return group.moved(y, h * _combined(table.matrix[-1], slopes))


def _stages(group, rate, table, which, h, y, first):
    """Slopes of the increments at the stages (those not asked for: `first` at the start, then 0),
    and the state and its rate at the last one. A loop: the equations stand in the program once."""
    nodes, matrix, rows = jnp.asarray(table.nodes), jnp.asarray(table.matrix), len(table.nodes)

    def stage(carry, i):
        slopes, _, _ = carry
        increment = h * _combined(matrix[i], slopes)
        moved = group.moved(y, increment)
        rate_here = rate(nodes[i], moved)
        slope = _pulled_back(group, rows - 1, increment, rate_here)
        return (jnp.where((jnp.arange(rows) == i)[:, None], slope, slopes), moved, rate_here), None

    slopes = jnp.concatenate([first[None], jnp.zeros((rows - 1, len(first)))])
    return jax.lax.scan(stage, (slopes, y, first), np.array(which))[0]


def _combined(weights, slopes):
    return jnp.sum(jnp.asarray(weights)[:, None] * slopes, 0)


def _pulled_back(group, order, increment, rate):
    """Rate of the increment from the rate of the state, to the terms that the order needs."""
    if order < 3:
        return rate
    bracket = group.bracket(increment, rate)
    if bracket is None:
        return rate
    out = rate + bracket / 2
    return out if order == 3 else out + group.bracket(increment, bracket) / 12
