"""Implicit steps through stiff contacts: their length follows the motion, not the stiffness."""

import functools
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxclear.formulations import contact_rows
from jaxclear.formulations.compliant import CompliantContact
from jaxclear.formulations.contact_rows import TimeStep, has_damping
from jaxclear.formulations.films_over_step import films_of
from jaxclear.formulations.loop_closing import closed
from jaxclear.formulations.midpoint_step import surplus
from jaxclear.formulations.model import Model, State
from jaxclear.ground import sparse as sp
from jaxclear.ground.grouping import packed, unpacked, unstacked
from jaxclear.ground.numerics import positive_part
from jaxclear.ground.quantity import Scalar, constant, count, quantity
from jaxclear.integrators.base import (
    AbstractIntegrator,
    arrived,
    counted,
    divide,
    march,
    with_step_times,
)
from jaxclear.integrators.events import Peaks, among, no_peaks, risen, since, watch_from, watched
from jaxclear.integrators.variational import (
    BESIDE,
    derived_steps,
    not_resolved,
    so_far,
    trusted_steps,
)
from jaxclear.multibody.state import unpack_motion
from jaxclear.multibody.system import System, prepare

# Newton iterations on the contact laws: where force and damping grow with the indentation alike,
# and where a damper beside the spring grows on its own.
ITERATIONS, DAMPED_ITERATIONS = 2, 8
# With films: one with the journal where the step before leads it.
FILM_ITERATIONS = ITERATIONS + 1


class ImplicitStep(AbstractIntegrator):
    """Midpoint rule with mean contact forces: equal steps that no contact makes too long. The
    choice for statistics.

    Order 2 in free motion. Over a step a contact force does the work that its law says (discrete
    gradient) or takes more energy out, so stiff contacts do not make motion explode, as long as the
    iteration ends: at K = 1e12 N/m^1.5 and 5e-4 s few iterations gain energy,
    `newton_iterations=30` does not. One evaluation a step. Friction that would stop a slip within a
    step is taken towards the step's end, so that slip decays and does not ring; friction loss and
    wear are those of the mean slip. Impact speeds are those at the touch within a step, to order 2.

    With theta = 1 / (1 + rebound), a linear contact mode omega is damped as by the theta method,
    amplitude per step sqrt((1 + (1 - theta)^2 z^2) / (1 + theta^2 z^2)) with z = omega h; damping
    ratio about (theta - 1/2) z for small z. Speeds at saving times are those with which positions
    change; within a step they lack that damping.

    Loads that oscillate by themselves (stiff springs, dampers) are explicit: step < 2 / omega of
    them; couplings with stiffness or play and films of bearings are not. A step should move the
    parts by less than a clearance, and by less than a cell of a worn surface, or forces at the
    saved instants are far off, though the motion stays bounded.

    Without `steps_per_save` derivatives through contacts are those of the motion itself, which is
    integrated beside the steps in parts that resolve contacts (`variational`): within 1e-3 through
    six bounces of Hertzian laws, half a per cent to two with a damper beside the spring; nan where
    the run differs from that motion by 3 % of the narrowest gap, or where steps twice as long give
    another one. Numerical dissipation separates them soon: `rebound=1.0` and shorter steps go
    further.

    Args:
        step: largest step [s], > 0.
        rebound: share of its speed that an elastic impact keeps within one step that does not
            resolve it [1], >= 0 and <= 1; it sets the numerical dissipation. An impact that the
            steps resolve ends with the restitution of its law. 1 dissipates nothing; 0 is backward
            Euler in the contacts: for gradients, and where single unresolved impacts do not matter.
            Choose the restitution itself where stiff impacts decide.
        newton_iterations: number of iterations on the contact laws, a count, >= 1, in the contact
            directions alone; None: 2 (bristles may want more), 3 with films, or 8 where a law has a
            damper beside its spring (AdamsImpact, KelvinVoigt), which may be stiffer than it.
        steps_per_save: number of steps between two saving times, >= 1, in place of `step`:
            reverse-mode derivatives then go backwards through the steps, which pays off for
            hundreds of numbers, and passes where surfaces wear, but not with friction in ideal
            joints, and not where contacts open and close. None by default.

    Source: mean forces that conserve energy: Gonzalez 1996, J. Nonlinear Sci. 6, 449; for contact
    Laursen & Chawla 1997, Int. J. Numer. Methods Eng. 40, 863; with dissipation Armero & Petocz
    1998, Comput. Methods Appl. Mech. Eng. 158, 269.
    """

    pathwise: ClassVar = True
    projects: ClassVar = True
    notes_events: ClassVar = True
    opens_loops: ClassVar = True
    step: Scalar = quantity(1e-4, "s", above=0)
    rebound: Scalar = quantity(0.95, "1", at_least=0, at_most=1, kw_only=True)
    newton_iterations: int | None = count(None, kw_only=True)
    steps_per_save: int | None = count(None, kw_only=True)

    def with_finer_steps(self, share):
        if self.steps_per_save is not None:
            return None
        return with_step_times(self, share)

    @property
    def formulation(self):
        return CompliantContact()

    @property
    def _bias(self):
        """Share by which mean contact forces lean towards a step's end."""
        return (1 - self.rebound) / (1 + self.rebound)

    def requested_step(self):
        return self.step if self.steps_per_save is None else None

    @property
    def steps_between_saves(self):
        return self.steps_per_save

    def first_warm_start(self, model, start, state):
        """Warm start of the first step, and the motion beside the run.

        The second is None where no derivatives go through contacts.

        Args:
            model: of the run.
            start: of the run [s].
            state: array at the start, shape (n,).
        """
        last = self.formulation.warm_start(model, start, state)
        last = self._fixed(model, start, state, last)
        if self._derivative(model) is None:
            return last, None
        separate = not_resolved(
            model.layout.size, model.layout.joint_contacts, has_damping(model.system)
        )
        return last, separate

    def _derivative(self, model):
        """How derivatives go through contacts; None where they are those of the steps."""
        wet = {film.connection for film in films_of(model.system).values()}
        dry = not wet.issuperset(model.system.bearings)
        return BESIDE if self.through_contacts and dry and not model.discrete else None

    @property
    def through_contacts(self):
        return self.steps_per_save is None

    def _stepped(self, model):
        """A step, as a function of (its start and length [s], state, last, peaks)."""
        of_model, rest = packed(model)
        arrays_of, others = eqx.partition(self, eqx.is_array)

        def plain(arrays, clock, y, last, peaks):
            model, method = unpacked(arrays[0], rest), eqx.combine(arrays[1], others)
            how = method._bias, method._iterations(model.system)
            last, beside = last
            end, now = method.formulation.implicit_step(model, TimeStep(*clock), y, last, *how)
            end = closed(model, sum(clock), end, clock[1])
            peaks = None if peaks is None else risen(peaks, now.depths, now.forces)
            return clock[1], end, (now, beside), peaks

        step = derived_steps(self._derivative(model), self.formulation, rest, plain, None)
        return functools.partial(step, (of_model, arrays_of))

    def _fixed(self, model, start, state, last):
        """A warm start that knows what contacts hold where a run begins."""
        if not model.layout.joint_contacts:
            return last
        free, caused = map(unstacked, self.formulation.caused_by_contact(model, start, state))
        return last._replace(surplus=sp.stack(surplus(self._bias, free, caused)))

    def _sped_up(self, model, state, last, length):
        """A state whose speeds are, at saving times, those with which places change: within steps
        of this length [s] they lack what contacts have of numerical dissipation
        (`midpoint_step`)."""
        if not model.layout.joint_contacts:
            return state
        speeds = slice(model.layout.coordinates, model.layout.memory_start)
        return state.at[speeds].add(length * constant(last.surplus))

    def evaluations(self, mechanism):
        """The middle of a step, and the iterations on its contacts."""
        system = prepare(mechanism)
        acting = system.bearings or system.transmissions
        return 1 + (self._iterations(system) if acting else 0)

    def _iterations(self, system: System) -> int:
        """Iterations on the contact laws, and on couplings that give."""
        if self.newton_iterations is not None:
            return self.newton_iterations
        if any(t.coupling.play is not None for t in system.transmissions.values()):
            return DAMPED_ITERATIONS
        laws = [t.contact for bearing in system.bearings.values() for t in bearing.contact_laws]
        if any(law.restitution is None for law in laws):
            return DAMPED_ITERATIONS
        return FILM_ITERATIONS if films_of(system) else ITERATIONS

    def advance(self, model, interval, state, warm_start):
        steps, h = divide(interval, self.step, self.steps_per_save)
        step, contacts = self._stepped(model), model.layout.joint_contacts
        kind, (last, beside), peaks = self._derivative(model), warm_start, None
        state = self._sped_up(model, state, last, -h)
        before = _of_joints(model, interval.peaks)
        if contacts:
            last = last._replace(depths=_worn_deeper(model, interval.start, state, last.depths))
            first_depths = positive_part(last.depths)
            peaks = no_peaks(first_depths, has_damping(model.system))._replace(depths=first_depths)
            peaks = peaks if kind is None else since(before, peaks)

        def one(index, state, carried):
            last, peaks, watch = carried
            time = interval.start + index * h
            _, end, last, peaks = step((time, h), state, last, peaks)
            return end, (last, peaks, watched(watch, model, time, h, state, end))

        last = (last, None) if kind is None else so_far((last, beside))
        carried = last, peaks, watch_from(model, interval.start, state)
        if self.steps_per_save is None:
            end, (last, peaks, watch) = march(one, steps, state, carried)
        else:
            turn = lambda index, carry: one(index, *carry)
            end, (last, peaks, watch) = counted(turn, self.steps_per_save, (state, carried))
        if contacts and kind is None:
            peaks = among(before, peaks)
        end = self._sped_up(model, end, last[0], h)
        end, peaks, watch = trusted_steps(kind, end, peaks, watch, last)
        return arrived(end, steps, last, peaks, watch)


def _worn_deeper(model: Model, time: Any, state: State, depths: Array) -> Array:
    """The indentations that a step is handed where an interval begins: of surfaces that wear those
    that are left of what the interval before has lowered. A step knows them from the one before."""
    if not model.worn:
        return depths
    motion = unpack_motion(model.system, model.entries(state))
    depths_now = sp.stack(contact_rows.indentations(model, time, *motion))
    return jnp.where(depths > 0, depths_now, depths)


def _of_joints(model: Model, peaks: Peaks | None) -> Peaks | None:
    """Of the peaks those of joints: steps do not look at the flanks of play."""
    if peaks is None or not model.layout.plays:
        return peaks
    return jax.tree.map(lambda each: each[: model.layout.joint_contacts], peaks)
