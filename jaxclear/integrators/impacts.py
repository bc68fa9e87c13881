"""A diffrax solver whose steps take impact speeds: an error-controlled run neither follows the
approach speed nor stops at touches.

The step that closes a contact is short, because its error estimate sees the force begin; from its
two ends the speed at the touch follows (`formulations.impact_speed`). A touch that begins and ends
within one step, unseen at either end, rejects the step.
"""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.formulations.impact_speed import turns_beyond
from jaxclear.ground.quantity import Scalar
from jaxclear.integrators.events import noted, nothing


class TakingImpactSpeeds(diffrax.AbstractAdaptiveSolver, diffrax.AbstractWrappedSolver):
    """`solver`, and after each of its steps the impact speeds of contacts that have closed or
    parted.

    `contacts(time, state, args)`: their motion. `remember(state, before, after, length, args)`: the
    state with its impact speeds set. `unseen` [m]: how deep a touch may go between two steps. Its
    state between steps ends with the largest indentation of every contact so far [m]: the motion of
    the contacts is known at both ends of a step, so that peaks of a run cost it nothing; and with
    `events`, so many, of a saving interval (`integrators.events`).
    """

    solver: diffrax.AbstractSolver  # type: ignore[misc]
    contacts: Callable
    remember: Callable
    unseen: Scalar
    events: int = eqx.field(static=True, default=0)

    @property
    def term_structure(self):
        return self.solver.term_structure

    @property
    def interpolation_cls(self):
        return self.solver.interpolation_cls

    @property
    def scan_kind(self):
        """How an explicit solver goes through its stages; diffrax asks."""
        return self.solver.scan_kind

    @property
    def root_finder(self):
        """How an implicit solver finds its stages; diffrax asks."""
        return self.solver.root_finder

    def order(self, terms):
        return self.solver.order(terms)

    def error_order(self, terms):
        return self.solver.error_order(terms)

    def init(self, terms, t0, t1, y0, args):
        contacts = self.contacts(t0, y0, args)
        events = nothing(contacts, self.events) if self.events else None
        own = self.solver.init(terms, t0, t1, y0, args)
        return own, contacts, _deeper(contacts, 0.0), events

    def func(self, terms, t0, y0, args):
        return self.solver.func(terms, t0, y0, args)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        own, before, deepest, events = solver_state
        y1, error, dense, own, result = self.solver.step(terms, t0, t1, y0, args, own, made_jump)
        after: Any = self.contacts(t1, y1, args)
        length = t1 - t0
        missed = jnp.any(turns_beyond(before, after, length, self.unseen))
        y1 = self.remember(y1, before, after, length, args)
        error = jnp.where(missed, jnp.inf, error)
        if events is not None:
            events = noted(events, t0, length, *jax.lax.stop_gradient((before, after)))
        return y1, error, dense, (own, after, _deeper(after, deepest), events), result


def _deeper(contacts: Any, deepest: Any) -> Any:
    """The largest indentations, those of the contacts included; nothing of it is differentiated."""
    return jnp.maximum(jax.lax.stop_gradient(contacts.depths), deepest)
