"""The group on which a state moves: rotations by their exponential map, all else by addition.

A state y moves by increments u, y = y0 exp(u); the state of a mechanism is a product of its joints'
groups and of numbers that add up.
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxclear.components.joint import AbstractGroupJoint
from jaxclear.formulations.model import Model
from jaxclear.ground import sparse as sp
from jaxclear.ground.quantity import AbstractQuantified


class AbstractGroup(AbstractQuantified):
    """How a state moves by increments; their number may differ from that of the state's entries."""

    @abstractmethod
    def moved(self, y: Float[Array, " n"], increment: Float[Array, " m"]) -> Float[Array, " n"]:
        """y exp(increment)."""

    @abstractmethod
    def bracket(self, a: Float[Array, " m"], b: Float[Array, " m"]) -> Float[Array, " m"] | None:
        """Lie bracket; None for a group that commutes."""

    @abstractmethod
    def tangent(self, y: Float[Array, " n"], increment: Float[Array, " m"]) -> Float[Array, " n"]:
        """Change of y to first order in the increment, in which errors are measured."""


class Span(NamedTuple):
    """A piece of the state: where its coordinates, its increments and (of a group) its speeds
    begin, and how many there are.
    """

    joint: int | None
    coordinates: int
    increments: int
    speeds: int
    size: int
    width: int


class StateGroup(AbstractGroup):
    """The group of a mechanism's state: that of each joint whose coordinates are a group, addition
    for all else.
    """

    joints: tuple[AbstractGroupJoint, ...]
    spans: tuple[Span, ...] = eqx.field(static=True)

    def moved(self, y, increment):
        return self._each(
            lambda span: _coordinates(y, span) + _increments(increment, span),
            lambda joint, span: joint.moved(_of_q(y, span), _of_v(increment, span)),
        )

    def bracket(self, a, b):
        if not self.joints:
            return None
        return self._each(
            lambda span: jnp.zeros(span.width),
            lambda joint, span: joint.bracket(_of_v(a, span), _of_v(b, span)),
        )

    def tangent(self, y, increment):
        return self._each(
            lambda span: _increments(increment, span),
            lambda joint, span: joint.rate(_of_q(y, span), _of_v(increment, span)),
        )

    def rates(self, y: Float[Array, " n"], rates: Float[Array, " n"]) -> Float[Array, " m"]:
        """Rates of the increments from the state and its own rates: a group's are its speeds."""
        return self._each(
            lambda span: _coordinates(rates, span),
            lambda _, span: _entries(y, span.speeds, span.width),
        )

    def _each(self, plain: Callable, grouped: Callable) -> Array:
        """The spans' parts in their order: arrays of the plain ones, scalars of the joints."""
        return jnp.concatenate(
            [
                plain(s) if s.joint is None else sp.stack(grouped(self.joints[s.joint], s))
                for s in self.spans
            ]
        )


def _coordinates(y, span):
    return y[span.coordinates : span.coordinates + span.size]


def _increments(u, span):
    return u[span.increments : span.increments + span.width]


def _of_q(y, span):
    return _entries(y, span.coordinates, span.size)


def _of_v(u, span):
    return _entries(u, span.increments, span.width)


def _entries(values, start, count):
    return tuple(values[start + i] for i in range(count))


def state_group(model: Model) -> StateGroup:
    """The group of a model's states."""
    topology, spans = model.system.topology, []
    joints: list[AbstractGroupJoint] = []
    done = used = 0

    def plain_until(end):
        nonlocal done, used
        if end > done:
            spans.append(Span(None, done, used, 0, end - done, end - done))
            done, used = end, used + end - done

    for branch, link in zip(topology.branches, model.system.links, strict=True):
        size, width = (part.stop - part.start for part in (branch.coordinates, branch.speeds))
        if isinstance(link.joint, AbstractGroupJoint) and size:
            plain_until(branch.coordinates.start)
            spans.append(
                Span(
                    len(joints),
                    done,
                    used,
                    topology.coordinate_count + branch.speeds.start,
                    size,
                    width,
                )
            )
            joints.append(link.joint)
            done, used = done + size, used + width
    plain_until(model.layout.size)
    return StateGroup(tuple(joints), tuple(spans))
