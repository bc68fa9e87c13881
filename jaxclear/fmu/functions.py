"""What a unit computes, as functions of lists of arrays: its start from parameters, a communication
step, and what is read at its end.

Numbers of the mechanism enter as `constants`: `original` as the user has them, from which the start
is assembled, and `run` as the steps take them (loads that follow from the inertia are settled at
the start). What is handed from step to step is the `Carry` of a run.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxclear.formulations.base import model_of
from jaxclear.formulations.impact_speed import ContactMotion
from jaxclear.formulations.model import Instant, Model
from jaxclear.integrators.base import AbstractIntegrator
from jaxclear.integrators.checks import Check
from jaxclear.multibody import kinematics
from jaxclear.multibody.assembly import assemble_arrays, is_sound, ready
from jaxclear.multibody.mechanism import Mechanism, with_redundancy
from jaxclear.multibody.state import unpack_motion
from jaxclear.native.writer import LONGEST_IN_REGISTERS
from jaxclear.results.state_history import StateHistory
from jaxclear.results.trajectory import RunStats, Trajectory
from jaxclear.simulation.invariants import (
    contact_names,
    contact_radii,
    openings,
)
from jaxclear.simulation.loop import Carry, Span, Turn, extremes_of, first_turn, through_interval

Arrays = list[Any]
# A contact that touches or parts within this time [s] does so now: searches for roots end within
# 1e-12 s or so, and no contact lasts as short.
SIMULTANEOUS = 1e-9


class Flat(NamedTuple):
    """A tree of arrays as a list: `leaves`, and the tree of other leaves."""

    leaves: Arrays
    structure: Any
    static: Any

    @classmethod
    def of(cls, tree: Any) -> "Flat":
        """The list of a tree."""
        arrays, static = eqx.partition(tree, eqx.is_array)
        return cls(*jax.tree.flatten(arrays), static)

    def tree(self, leaves: Arrays) -> Any:
        """The tree with other arrays."""
        return eqx.combine(jax.tree.unflatten(self.structure, leaves), self.static)


def is_float(leaf: Any) -> bool:
    """Whether an array has tangents."""
    return jnp.issubdtype(leaf.dtype, jnp.floating)


def is_table(leaf: Any) -> bool:
    """Whether an array of the mechanism is read from memory, where it stays as it is."""
    return leaf.size > LONGEST_IN_REGISTERS and is_float(leaf)


class Functions:
    """The functions of a unit. `original`, `run` and `carry`: numbers as the user has them, those
    of the steps, and what the first step starts from, for the mechanism as it is exported; `doubt`:
    a sentence on its start, or "".

    All but `start` take the numbers of the steps, and the state at the beginning of a communication
    step, what is handed on at its end, and both times [s].
    """

    def __init__(
        self,
        mechanism: Mechanism,
        integrator: AbstractIntegrator,
        outputs: Mapping[str, Callable],
        duration: float,
    ):
        """`outputs`: by name functions of the run over the last communication step; `duration` [s]:
        how long a run usually is."""
        nominal = ready(integrator.formulation.modelled(mechanism))
        self.outputs, self.duration, self.doubt = outputs, duration, nominal.doubt
        self.redundancy = nominal.mechanism.topology.redundancy
        # The search goes on from where the mechanism stands if its guess led elsewhere.
        place = nominal.start.coordinates, nominal.start.speeds
        self.rough = place if nominal.searched else None
        self.original = Flat.of((mechanism, integrator))
        first = self._start_run(nominal.mechanism, nominal.start, jnp.zeros(()), integrator)
        self.run, self.carry = map(Flat.of, first)
        self.packed = [i for i, x in enumerate(self.run.leaves) if not is_table(x)]

    def _start_run(self, mechanism: Mechanism, start: Any, time: Any, integrator: Any) -> tuple:
        times = jnp.stack([time, time + self.duration])
        arguments = mechanism, start.coordinates, start.speeds, times, integrator
        mechanism, _, first = first_turn(*arguments)
        return (mechanism, integrator), first

    def start(self, leaves: Arrays, numbers: Arrays) -> Arrays:
        """From the original numbers and a time [s] those of the steps, what the first step starts
        from, and whether the start is sound."""
        mechanism, integrator = self.original.tree(leaves)
        mechanism = with_redundancy(integrator.formulation.modelled(mechanism), self.redundancy)
        start = assemble_arrays(mechanism, True, numbers[0], self.rough)
        steps, first = map(Flat.of, self._start_run(mechanism, start, numbers[0], integrator))
        return [*(steps.leaves[i] for i in self.packed), *first.leaves, is_sound(mechanism, start)]

    def step(self, leaves: Arrays, numbers: Arrays) -> Arrays:
        """What is handed on at the end of a communication step, from that at its beginning."""
        _, integrator, model, now = self._unpack_numbers(leaves, numbers)
        start, stop = numbers[-2:]
        turn, span = Turn(model, integrator, False), Span(start, stop, jnp.zeros(()))
        return Flat.of(through_interval(turn)(now, span)).leaves

    def read(self, leaves: Arrays, numbers: Arrays) -> Arrays:
        """The outputs."""
        mechanism, integrator, _, now = self._unpack_numbers(leaves, numbers)
        run = run_of_step(mechanism, integrator, numbers[0], now, jnp.stack(numbers[-2:]))
        return [function(run) for function in self.outputs.values()]

    def _unpack_numbers(self, leaves: Arrays, numbers: Arrays) -> tuple[Any, Any, Model, Carry]:
        mechanism, integrator = self.run.tree(leaves)
        model = model_of(mechanism, integrator.formulation)
        return mechanism, integrator, model, self.carry.tree(numbers[1:-2])

    def check(self, leaves: Arrays, numbers: Arrays) -> Arrays:
        """The figures by which a run is judged, as many as `check_places` names."""
        _, _, model, now = self._unpack_numbers(leaves, numbers)
        figures, system = [], model.system
        if system.bearings and now.peaks is not None:
            depths = now.peaks.depths[: model.layout.joint_contacts]
            figures.append(depths / contact_radii(system))
        if system.closures:
            entries, time = model.entries(now.state), numbers[-1]
            q, v = unpack_motion(system, entries)
            motions = kinematics.link_motions(system, q, v, time)
            figures.append(openings(Instant(model, motions, q, v, time, entries, [])))
        return figures

    def rates(self, leaves: Arrays, numbers: Arrays) -> Arrays:
        """The rate of the state, and how deep every contact is."""
        _, integrator, model, now = self._unpack_numbers(leaves, numbers)
        rate, contacts = integrator.formulation.rate(model, numbers[-1], now.state)
        return [rate, contacts.depths]

    def remember(self, leaves: Arrays, numbers: Arrays) -> Arrays:
        """The state with impact speeds of contacts that touch or part within `SIMULTANEOUS`: the
        search for the instant ends on either side."""
        _, integrator, model, now = self._unpack_numbers(leaves, numbers)
        depths, speeds = integrator.formulation.contacts(model, numbers[-1], now.state)
        ahead = ContactMotion(depths + SIMULTANEOUS * speeds, speeds)
        return [integrator.formulation.remember(model, now.state, ahead, ahead, jnp.ones(()))]


def check_places(model: Model, carry: Carry) -> list[tuple[Check, str]]:
    """Which figures `check` gives, and of what."""
    names = contact_names(model)[: model.layout.joint_contacts] if carry.peaks is not None else ()
    loops = [(Check.LOOP_DRIFT, name) for name in model.system.topology.loops]
    return [(Check.INDENTATION, name) for name in names] + loops


def run_of_step(
    mechanism: Mechanism, integrator: AbstractIntegrator, before: Any, now: Carry, times: Any
) -> Trajectory:
    """The run over one communication step, from which outputs are read.

    Args:
        mechanism: with its parameters.
        integrator: that made the step.
        before: state at the beginning of the step, shape (n,).
        now: state and counters at its end.
        times: beginning and end of the step [s].
    """
    model = model_of(mechanism, integrator.formulation)
    # What adds up (impulses, worn volumes) counts from its beginning, as of any run.
    adds_up = jnp.arange(model.layout.size) >= model.layout.remembered.stop
    states = jnp.stack([before, now.state]) - jnp.where(adds_up, before, 0.0)
    states = integrator.check_derivatives(model, times, states, now.state, now.warm_start)
    history = StateHistory(mechanism, integrator.formulation, times, states, {}, False)
    stats = RunStats(*now.steps, jnp.zeros((), int))
    extremes = extremes_of(mechanism, model, now)
    return Trajectory(history, {}, now.outcome, now.ended, stats, extremes=extremes)


class Slopes(NamedTuple):
    """The functions of a unit with tangents: of its start along original numbers, of a step, and of
    what is read; `moving`: which of the numbers of the steps have tangents."""

    moving: tuple[int, ...]
    start: Callable
    step: Callable
    read: Callable


def make_slopes(functions: Functions, along: list[int]) -> Slopes:
    """Of functions those with tangents along the original numbers of these places."""
    count, handed = len(functions.packed), functions.carry.leaves
    program = jax.make_jaxpr(functions.start)(functions.original.leaves, [jnp.zeros(())]).jaxpr
    # A number of the steps that is an original one moves with that one alone; any other may.
    still = [x for i, x in enumerate(program.invars) if i not in along]
    places = [
        k
        for k, x in enumerate(program.outvars[:count])
        if is_float(functions.run.leaves[functions.packed[k]])
        and not any(x is one for one in still)
    ]
    moving = tuple(functions.packed[k] for k in places)

    def pushed(function: Callable, numbers: Arrays, tangents: Arrays) -> tuple[Arrays, Arrays]:
        """A function of a list of arrays, and tangents of those of its results that have some."""
        places = [i for i, x in enumerate(numbers) if is_float(x)]

        def of_floats(floats: Arrays) -> tuple[Arrays, Arrays]:
            values = list(numbers)
            for place, value in zip(places, floats, strict=True):
                values[place] = value
            results = function(values)
            return [x for x in results if is_float(x)], results

        floats = [numbers[i] for i in places]
        _, moved, results = jax.jvp(of_floats, (floats,), (tangents,), has_aux=True)
        return results, moved

    def start(leaves: Arrays, numbers: Arrays) -> Arrays:
        time, *weights = numbers

        def of_chosen(chosen: Arrays) -> Arrays:
            values = list(leaves)
            for place, value in zip(along, chosen, strict=True):
                values[place] = value
            results = functions.start(values, [time])
            return [*(results[k] for k in places), *results[count : count + len(handed)]]

        return pushed(of_chosen, [leaves[i] for i in along], weights)[1]

    def along_run(function: Callable, leaves: Arrays, numbers: Arrays) -> tuple[Arrays, Arrays]:
        """A function of what a row begins with, and its tangents."""
        plain, tangents = numbers[: len(handed) + 3], numbers[len(handed) + 4 :]

        def of_moving(values: Arrays) -> Arrays:
            run = list(leaves)
            for place, value in zip(moving, values, strict=False):
                run[place] = value
            return function(run, [*values[len(moving) :], *plain[-2:]])

        primals = [*(leaves[i] for i in moving), *plain[:-2]]
        return pushed(of_moving, primals, tangents)

    def step(leaves: Arrays, numbers: Arrays) -> Arrays:
        results, moved = along_run(functions.step, leaves, numbers)
        return [*results, *moved]

    def read(leaves: Arrays, numbers: Arrays) -> Arrays:
        results, moved = along_run(functions.read, leaves, numbers)
        return [*results, *moved]

    return Slopes(moving, start, step, read)
