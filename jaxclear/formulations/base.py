"""The state's rate as an integrator sees it, and what more an integrator may ask of the mechanism
at an instant.

Everything is a function of (time, state) over the worn surfaces of the current interval; an
integrator never sees a joint. Possible contacts are numbered through all clearance joints, in the
order of the state.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxclear.formulations import closing, compliant, permanent, rigid, state_rate
from jaxclear.formulations.compliant import WarmStart
from jaxclear.formulations.contact_rows import TimeStep
from jaxclear.ground import sparse as sp
from jaxclear.ground.numerics import positive_part
from jaxclear.multibody.loops import Baumgarte
from jaxclear.multibody.state import Layout, impact_speed_places, unpack_motion
from jaxclear.multibody.system import System

State = Float[Array, " n"]


class Field(eqx.Module):
    """The state's rate as a function of time and state; `worn` are the current interval's worn
    surfaces as read.

    `captured`: remembered impact speeds stand still, because the integrator sets them where
    contacts close. `projects`: loops are to be closed anew after every step.
    """

    system: System
    worn: dict
    stabilisation: Baumgarte | None
    layout: Layout = eqx.field(static=True)
    captured: bool = eqx.field(static=True, default=False)
    projects: bool = eqx.field(static=True, default=False)

    def __call__(self, time: Any, state: State) -> State:
        return self.with_contacts(time, state)[0]

    def with_contacts(
        self, time: Any, state: State
    ) -> tuple[State, Float[Array, " c"], Float[Array, " c"]]:
        """The rate, and of every possible contact the indentation [m] and its rate [m/s], from one
        evaluation.
        """
        args = (self.system, self.layout, self.stabilisation, self.worn, time, self._entries(state))
        rates, reports = state_rate.evaluate(*args)
        if self.captured:
            for place in impact_speed_places(self.layout):
                if place is not None:
                    rates[place] = 0
        return sp.stack(rates), *_depths(reports)

    def contacts(self, time: Any, state: State) -> tuple[Float[Array, " c"], Float[Array, " c"]]:
        """Indentation [m] and its rate [m/s] of every possible contact."""
        return _depths(
            state_rate.reports_at(self.system, self.layout, self.worn, time, self._entries(state))
        )

    def coordinate_rates(self, state: State) -> Float[Array, " q"]:
        """Rates of the coordinates alone: they follow from coordinates and speeds."""
        return sp.stack(
            state_rate.coordinate_rates(
                self.system, *unpack_motion(self.system, self._entries(state))
            )
        )

    def remember(
        self, state: State, wanted: Bool[Array, " c"], approach: Float[Array, " c"]
    ) -> State:
        """The state with the remembered impact speed set to max(approach, 0) [m/s] at those
        contacts that are `wanted`.
        """
        entries = self._entries(state)
        for i, place in enumerate(impact_speed_places(self.layout)):
            if place is not None:
                entries[place] = jnp.where(wanted[i], positive_part(approach[i]), entries[place])
        return sp.stack(entries)

    def closed(self, time: Any, state: State) -> State:
        """The state at the end of a step, its loops closed anew where they are to be."""
        return (
            sp.stack(closing.close(self.system, self.layout, time, self._entries(state)))
            if self.projects
            else state
        )

    def implicit_step(
        self, time_step: TimeStep, state: State, warm_start: Float[Array, " h"], iterations: int
    ) -> tuple[State, Float[Array, " h"]]:
        """The state after an implicit step, and what it hands on to the next; see
        `scene.contact_step`.
        """
        count = self.layout.speeds
        numbers = [warm_start[i] for i in range(len(warm_start))]
        last = WarmStart(numbers[:count], numbers[count : 2 * count], numbers[2 * count :])
        args = (
            self.system,
            self.layout,
            self.stabilisation,
            self.worn,
            time_step,
            self._entries(state),
            last,
        )
        after, now = compliant.step(*args, iterations, self.captured)
        return sp.stack(after), sp.stack([*now.smooth, *now.contact, *now.depths])

    def rigid_step(
        self,
        time_step: TimeStep,
        state: State,
        last: Float[Array, " h"],
        rules: rigid.MoreauJeanSettings,
    ) -> tuple[State, Float[Array, " h"]]:
        """The state after a step with rigid contacts, and what it hands on: free accelerations,
        percussions, and a residual.
        """
        numbers = [last[i] for i in range(len(last))]
        args = (
            self.system,
            self.layout,
            self.stabilisation,
            self.worn,
            time_step,
            self._entries(state),
            numbers,
            rules,
        )
        after, free = rigid.step(*args)
        return sp.stack(after), sp.stack(free)

    def permanent_step(
        self,
        time_step: TimeStep,
        state: State,
        last: Float[Array, " h"],
        rules: permanent.NonCollidingSettings,
    ) -> tuple[State, Float[Array, " h"]]:
        """The state after a step with joints that always touch, and what it hands on:
        accelerations, and a residual.
        """
        numbers = [last[i] for i in range(len(last))]
        args = (
            self.system,
            self.layout,
            self.stabilisation,
            time_step,
            self._entries(state),
            numbers,
            rules,
        )
        after, free = permanent.step(*args)
        return sp.stack(after), sp.stack(free)

    def implicit_warm_start(self, time: Any, state: State) -> Float[Array, " h"]:
        """What the first implicit step is handed: no accelerations, and the contacts as they
        are."""
        return jnp.concatenate([jnp.zeros(2 * self.layout.speeds), self.contacts(time, state)[0]])

    @property
    def remembers(self) -> bool:
        """True where some contact remembers its impact speed."""
        return any(place is not None for place in impact_speed_places(self.layout))

    def when_captured(self) -> "Field":
        """The same field, impact speeds standing still."""
        return dataclasses.replace(self, captured=True)

    def _entries(self, state):
        return [state[i] for i in range(self.layout.size)]


def _depths(reports):
    points = [point for report in reports.values() for point in report.points]
    return sp.stack([point.indentation for point in points]), sp.stack(
        [point.rate for point in points]
    )
